"""Which images can be used, and the sensor and pass of each: by the rig file, a preset, or a guess."""

import difflib
import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scan.bands import band_layout, with_rig_tags
from tiegraph.scan.folders import (
    UP_WORDS,
    Layout,
    Order,
    Place,
    guess_layout,
    is_pattern,
    natural,
    order_of,
    place_by_folders,
    shot_stem,
    words,
)
from tiegraph.scan.rigfiles.rigfaults import contradictions
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import RigSpec, SensorSpec, preset, preset_sizes
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import Tuning
from tiegraph.scene.exif import Exif
from tiegraph.scene.images import OF_CAMERAS, SUFFIXES, Probe
from tiegraph.scene.scene import Dropped
from tiegraph.text import some


@dataclass(frozen=True)
class Shot:
    """A usable image before it is in the scene."""

    image: int
    rig: int
    sensor: int
    sequence: str  # "" = loose
    stem: str
    key: str = ""


@dataclass(frozen=True)
class Survey:
    """The images assigned to rigs, before cameras are known."""

    specs: tuple[RigSpec, ...]
    shots: tuple[Shot, ...]
    loose: bool
    guessed: bool = False  # the order of a sequence: the images must confirm it


class Report:
    """Notes and dropped images of scan, collected over its steps."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.dropped: list[Dropped] = []

    def drop(self, names: Iterable[str], reason: str) -> None:
        self.dropped += [Dropped(n, reason) for n in names]


@dataclass(frozen=True)
class ImageFiles:
    """Images, or the views that files are cut into: their names, probes, and the files;
    parallel."""

    names: Sequence[str]
    probes: Sequence[Probe]
    files: Sequence[str]


@dataclass(frozen=True)
class Usable:
    """The usable images: their numbers, names and probes; parallel."""

    images: tuple[int, ...]
    names: tuple[str, ...]
    probes: tuple[Probe, ...]
    video: bool = False  # pictures of videos, each a sequence however short

    def layout(self, settings: ScanSettings) -> str:
        """The layout of the settings; for videos ``video``, if the settings give none."""
        return "video" if self.video and settings.layout == "auto" else settings.layout

    def facts(self) -> tuple[list[Exif], list[tuple[int, int]]]:
        """EXIF and upright sizes."""
        return [p.exif for p in self.probes], [p.upright_size() for p in self.probes]


def assign(
    rig: str | None, usable: Usable, settings: ScanSettings, report: Report, tuning: Tuning, text: str | None = None
) -> Survey:
    """Rig, sensor and pass of each usable image; ``text``: of a rig.toml that comes from ``rig``, a run folder.

    Raises InputError for a wrong or unsuitable rig.
    """
    cameras = preset_sizes(rig, tuning.rig) if rig and text is None else ()
    if rig is not None and not cameras:
        return _assign_by_file(Path(rig), read_rig_file(rig, tuning.rig, text), usable, settings, report, tuning)
    exif, sizes = usable.facts()
    kind = usable.layout(settings)
    layout = band_layout(usable.names, exif, kind, tuning.frames) or guess_layout(
        usable.names, exif, sizes, kind, tuning.folders, cameras
    )
    # Several lenses or focal lengths are several cameras, also in one body.
    lenses = {(p.exif.lens, _millimetres(p.exif)) for p in usable.probes} - {("", "")}
    if layout.folders == ("",) and not layout.order.loose and kind == "auto" and len(lenses) > 1:
        layout = replace(layout, order=Order(True, "loose photographs: taken with different lenses"))
    if rig is None:
        report.notes.append(f"layout guessed: {layout.order.why}")
        spec = with_rig_tags(_guessed_rig(layout), layout, exif, report.notes)
        if len(layout.folders) > 1 and not spec.nominal:
            report.notes.append(
                f"no rig given: the relative poses of the {len(layout.folders)} cameras are unknown and have to come "
                "from the images; --rig takes a file or ladybug5, ring:N, stereo"
            )
    else:
        spec = preset(rig, layout.folders, tuning.rig)
        report.notes.append(f"layout guessed: {layout.order.why}; rig preset {rig}: nominal axes and centres")
    index = {s.folder: k for k, s in enumerate(spec.sensors)}
    shots = tuple(
        _shot(image, name, (0, index[place.folder]), place, layout.order.loose)
        for image, name, place in zip(usable.images, usable.names, layout.places)
        if place is not None
    )
    strays = [name for name, place in zip(usable.names, layout.places) if place is None]
    report.drop(strays, f"outside the camera folders ({some(layout.folders)})")
    if layout.order.loose or (kind == "video" and layout.folders == ("",)):
        return _by_camera(spec, shots, usable, report, loose=layout.order.loose)
    return Survey(specs=(spec,), shots=shots, loose=False, guessed=layout.order.guessed)


def _shot(image: int, name: str, owner: tuple[int, int], place: Place, loose: bool) -> Shot:
    rig, sensor = owner
    sequence = "" if loose else place.sequence
    return Shot(image=image, rig=rig, sensor=sensor, sequence=sequence, stem=shot_stem(name, place.folder))


def _guessed_rig(layout: Layout) -> RigSpec:
    if layout.folders == ("",):
        return RigSpec("camera", (SensorSpec("camera", "", body_from_sensor=np.eye(4)),), body_is_reference=True)
    roles = ["up" if words(f) & UP_WORDS else "side" for f in layout.folders]
    sensors = [SensorSpec(name=f, folder=f, role=role) for f, role in zip(layout.folders, roles)]
    first = replace(sensors[0], body_from_sensor=np.eye(4))
    return RigSpec("rig", (first, *sensors[1:]), body_is_reference=True)


def _assign_by_file(
    file: Path, read: Sequence[RigSpec], usable: Usable, settings: ScanSettings, report: Report, tuning: Tuning
) -> Survey:
    specs = tuple(_bound(_checked(s), usable.names) for s in read)
    owner = {(s.folder or ""): (r, k) for r, spec in enumerate(specs) for k, s in enumerate(spec.sensors)}
    if len(owner) < sum(len(spec.sensors) for spec in specs):
        raise InputError(f"{file}: two sensors have the same folder ({', '.join(owner)}): give each its own")
    places = place_by_folders(usable.names, list(owner))
    _all_found(file, specs, places, usable.names)
    stray = [name for name, place in zip(usable.names, places) if place is None]
    report.drop(stray, f"below no sensor folder of {file.name} ({', '.join(owner)})")
    order = Order(False, "")
    if len(owner) == 1:
        order = order_of(usable.names, places, *usable.facts(), usable.layout(settings), tuning.folders)
    report.notes.append(f"rig file {file.name}: {len(owner)} sensor(s)" + (f"; {order.why}" if order.why else ""))
    report.notes += [f"{file.name}: {text}" for spec in specs for text in contradictions(spec, tuning.rig)]
    shots = [
        _shot(image, name, owner[place.folder], place, order.loose)
        for image, name, place in zip(usable.images, usable.names, places)
        if place is not None
    ]
    return Survey(specs=specs, shots=tuple(shots), loose=order.loose, guessed=order.guessed)


def _checked(spec: RigSpec) -> RigSpec:
    poses = [s.body_from_sensor is not None for s in spec.sensors]
    first = spec.sensors[0]
    if not poses[0] and (any(poses) or spec.axes != "camera"):
        raise InputError(
            f"{spec.file}: the first sensor, {first.name!r}, is the reference and needs an orientation, because "
            + ("other sensors have one" if any(poses) else f"axes = {spec.axes} is not the sensor's own frame")
        )
    if not poses[0]:
        sensors = (replace(first, body_from_sensor=np.eye(4)), *spec.sensors[1:])
        return replace(spec, sensors=sensors, body_is_reference=True)
    return spec


def _bound(spec: RigSpec, names: Sequence[str]) -> RigSpec:
    """The rig with each sensor's folder written out; a lone sensor without a folder of its name takes every image."""
    parts = {p for n in names for p in PurePosixPath(n).parts[:-1]}
    lone = len(spec.sensors) == 1

    def written(sensor: SensorSpec) -> str:
        if sensor.folder is None:
            return "" if lone and sensor.name not in parts else sensor.name
        begin = sensor.folder.removesuffix("*")
        return begin if any(place_by_folders(names, [begin])) else sensor.folder

    return replace(spec, sensors=tuple(replace(s, folder=written(s)) for s in spec.sensors))


def _all_found(file: Path, specs: Sequence[RigSpec], places: Sequence[Place | None], names: Sequence[str]) -> None:
    found = {p.folder for p in places if p is not None}
    there = sorted({p for n in names for p in PurePosixPath(n).parts[:-1]}, key=natural)
    for spec in specs:
        for sensor in spec.sensors:
            if sensor.folder in found:
                continue
            if is_pattern(sensor.folder or ""):
                raise InputError(
                    f"{file}: sensor {sensor.name!r}: folder = {sensor.folder!r}, but no usable image has such a "
                    f"name; names here are like {names[0]}. Correct folder, or remove the sensor from the file"
                )
            near = difflib.get_close_matches(sensor.folder or "", there, n=1)
            hint = f" Perhaps you meant {near[0]!r}?" if near else ""
            raise InputError(
                f"{file}: sensor {sensor.name!r}: no usable image below a folder {sensor.folder!r}; folders here: "
                f"{', '.join(there) or 'none'}.{hint} Correct folder, or remove the sensor from the file"
            )


def _by_camera(spec: RigSpec, shots: tuple[Shot, ...], usable: Usable, report: Report, *, loose: bool) -> Survey:
    """Loose photographs, or videos, of several cameras (or sizes, or focal lengths) as rigs of one sensor each."""
    probe_of = dict(zip(usable.images, usable.probes))

    def camera(shot: Shot) -> tuple:
        p = probe_of[shot.image]
        focal = f"f{round(p.exif.focal_px)}" if np.isfinite(p.exif.focal_px) else _millimetres(p.exif)
        return p.upright_size(), p.exif.make, p.exif.model, p.exif.lens, focal

    kinds = Counter(camera(s) for s in shots)
    order = [kind for kind, _ in kinds.most_common()]
    if len(order) == 1:
        return Survey((spec,), shots, loose)
    specs: list[RigSpec] = []
    several = len({kind[3] for kind in order}) > 1
    for k, ((width, height), make, model, lens, focal) in enumerate(order):
        label = " ".join(filter(None, (make, model, lens if several else ""))) or "camera"
        name = " ".join(filter(None, (label, f"{width}x{height}", focal)))
        specs.append(RigSpec(f"{k}: {name}", (replace(spec.sensors[0], name=f"{k}: {name}"),), body_is_reference=True))
    report.notes.append(
        f"{len(order)} cameras by make, model, lens, image size and EXIF focal length: "
        + some(f"{s.name} ({kinds[o]})" for s, o in zip(specs, order))
    )
    return Survey(tuple(specs), tuple(replace(s, rig=order.index(camera(s))) for s in shots), loose)


def zoomed(probes: Sequence[Probe]) -> Sequence[Probe]:
    """Probes without EXIF focal lengths that include a digital zoom: where images that differ only in the zoom have one
    focal length, EXIF ignores it."""
    keys = [str((e.make, e.model, e.lens, e.focal_mm, e.focal_px)) for e in (p.exif for p in probes)]
    kinds: dict[str, set[float]] = {}
    for key, probe in zip(keys, probes):
        kinds.setdefault(key, set()).add(probe.exif.zoom)
    return [
        p if len(kinds[key]) == 1 else replace(p, exif=replace(p.exif, focal_px=p.exif.focal_px * p.exif.zoom))
        for key, p in zip(keys, probes)
    ]


def _millimetres(exif: Exif) -> str:
    zoom = f" zoom {exif.zoom:g}" if exif.zoom > 1 else ""
    return f"{exif.focal_mm:.1f}mm{zoom}" if np.isfinite(exif.focal_mm) else ""


def usable_images(names: Sequence[str], probes: Sequence[Probe], report: Report) -> Usable:
    """The images that can be read, each photograph once; the report gets the others. InputError with fewer than two."""
    first: dict[str, str] = {}
    usable, repeated, masks = [], [], masks_among(names)
    if masks:
        report.notes.append(
            f"{len(masks)} files are masks of other images by their names, such as {min(masks)}: not used as images "
            "(--masks.folder with this folder uses them)"
        )
    twins = _twins(names, probes)
    for k, (name, probe) in enumerate(zip(names, probes)):
        if name in masks:
            report.drop([name], f"a mask of {masks[name]} by its name")
        elif k in twins:
            report.drop([name], f"the same photograph as {names[twins[k]]} in another format")
        elif probe.reason:
            report.drop([name], probe.reason)
        elif (same := f"{probe.digest} {probe.exif.time_s}") in first:  # black frames of two instants are two
            report.drop([name], f"the same photograph as {first[same]}")
            repeated.append((name, first[same]))
        else:
            first[same] = name
            usable.append(k)
    for copy, kept in list(twins.items())[:1]:
        both = f"of {names[kept]} and {names[copy]} the first is used"
        report.notes.append(f"{len(twins)} photographs are here in two formats: {both}")
    report.notes += _say_repeated(repeated, names)
    told = Counter(d.reason for d in report.dropped if "pip install" in d.reason)
    told.update(probes[k].said for k in usable if probes[k].said)
    report.notes += [f"{count} images: {text}" for text, count in told.items()]
    need_two(len(usable), report)
    return Usable(tuple(usable), tuple(names[k] for k in usable), tuple(probes[k] for k in usable))


def masks_among(names: Sequence[str]) -> dict[str, str]:
    """The image of each mask that lies beside it: a.jpg.png (COLMAP), a_mask.png (OpenDroneMap, Metashape, openMVG),
    a.mask.png (openMVS), dynamic_mask_a.png (instant-ngp)."""
    images = {str(PurePosixPath(n).with_suffix("")): n for n in names} | {n: n for n in names}
    found: dict[str, str] = {}
    for path in map(PurePosixPath, names):
        of = re.fullmatch(r"(?:dynamic_mask_(.+)|(.+?)[_.]mask|(.+\.\w+))", path.stem, re.IGNORECASE)
        image = images.get(str(path.with_name(of[1] or of[2] or of[3])), "") if of else ""
        if image not in ("", str(path)):
            found[str(path)] = image
    return found


def _twins(names: Sequence[str], probes: Sequence[Probe]) -> dict[int, int]:
    """Files that are a photograph in another format (raw and JPEG, HEIC and its copy), and the file that is used."""
    found: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        found.setdefault(PurePosixPath(name).stem.lower(), []).append(k)
    out: dict[int, int] = {}
    for same in (same for same in found.values() if len({_suffix(names[k]) for k in same}) > 1):
        same.sort(key=lambda k: (bool(probes[k].reason), SUFFIXES.index(_suffix(names[k]))))
        for n, k in enumerate(same):
            kept = next((j for j in same[:n] if j not in out and _one_photograph(names, probes, j, k)), None)
            if kept is not None:
                out[k] = kept
    return out


def _suffix(name: str) -> str:
    return PurePosixPath(name).suffix.lower()


def _one_photograph(names: Sequence[str], probes: Sequence[Probe], one: int, other: int) -> bool:
    formats, exif = {_suffix(names[one]), _suffix(names[other])}, (probes[one].exif, probes[other].exif)
    if len(formats) == 1 or probes[one].reason:
        return False
    if PurePosixPath(names[one]).parent == PurePosixPath(names[other]).parent:
        return bool(formats & set(OF_CAMERAS)) or probes[one].upright_size() == probes[other].upright_size()
    return len({(e.time_s, e.make, e.model) for e in exif}) == 1 and bool(exif[0].make)


def _say_repeated(repeated: Sequence[tuple[str, str]], names: Sequence[str]) -> list[str]:
    """One note for every two folders of which one repeats files of the other: a copied pass."""
    heads = Counter(_heads(name, original) for name, original in repeated)
    out = []
    for (copy, original), count in heads.items():
        total = sum(name.startswith(f"{copy}/") for name in names) if copy else len(names)
        said = f"{count} of {total} images"
        if copy == original:
            out.append(f"folder {copy or '.'}: {said} repeat others of it (identical files): left out")
        else:
            kind = "folder" if "/" in copy + original else "pass"
            text = f"{kind} {copy or '.'} repeats {kind} {original or '.'}: {said} are identical files"
            out.append(f"{text}; pairs between them have no base, so they are left out")
    return out


def _heads(name: str, other: str) -> tuple[str, str]:
    """The folders of two files without their common end: (B, A) for B/cam0/1.jpg and A/cam0/1.jpg."""
    mine, its = (PurePosixPath(n).parent.parts for n in (name, other))
    alike = 0 if mine == its else len(os.path.commonprefix([mine[::-1], its[::-1]]))
    return "/".join(mine[: len(mine) - alike]), "/".join(its[: len(its) - alike])


def need_two(count: int, report: Report) -> None:
    """Raise InputError, with what was left out, for fewer than two images."""
    if count < 2:
        reasons = dict.fromkeys(d.reason for d in report.dropped)
        named = [f"{some(d.name for d in report.dropped if d.reason == why)}: {why}" for why in reasons]
        why = "; ".join(named[:3])
        raise InputError(
            f"{count} usable image(s): at least 2 are needed, and about 10 for a model. "
            + (f"Left out {len(report.dropped)}: {why}" if why else "Give a folder with more images")
        )
