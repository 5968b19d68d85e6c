"""The sensor, pass and frame of each image: by the rig file, a preset, or a guess; and which were taken together."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scan.folders import (
    UP_WORDS,
    Layout,
    Order,
    Place,
    guess_layout,
    is_pattern,
    layout_by_marks,
    natural,
    order_of,
    place_by_folders,
    shot_stem,
    with_rig_tags,
    words,
)
from tiegraph.scan.prepare import Report, Usable
from tiegraph.scan.priors.times import time_in_name
from tiegraph.scan.rigfiles.rigfaults import contradictions
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import RigSpec, SensorSpec, preset, preset_sizes
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import FoldersTuning, Tuning
from tiegraph.scene.exif import Exif
from tiegraph.scene.images import Probe
from tiegraph.text import meant, some


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


@dataclass(frozen=True)
class ImageFiles:
    """Images, or the views that files are cut into: their names, probes, and the files;
    parallel."""

    names: Sequence[str]
    probes: Sequence[Probe]
    files: Sequence[str]


def assign(
    rig: str | None, usable: Usable, settings: ScanSettings, report: Report, tuning: Tuning, text: str | None = None
) -> Survey:
    """Rig, sensor and pass of each usable image; ``text``: of a rig.toml that comes from ``rig``, a run folder.

    Raises InputError for a wrong or unsuitable rig.
    """
    cameras = preset_sizes(rig, tuning.rig) if rig and text is None else ()
    if rig is not None and not cameras:
        return _assign_by_file(
            Path(rig), read_rig_file(rig, tuning.rig, text), usable, settings, report, tuning.folders
        )
    exif, sizes = usable.facts()
    kind = usable.layout(settings)
    layout = layout_by_marks(usable.names, exif, kind) or guess_layout(
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
    owner = {s.folder or "": (0, k) for k, s in enumerate(spec.sensors)}
    shots = _shots(usable, layout.places, owner, layout.order.loose)
    strays = [name for name, place in zip(usable.names, layout.places) if place is None]
    report.drop(strays, f"outside the camera folders ({some(layout.folders)})")
    if layout.order.loose or (kind == "video" and layout.folders == ("",)):
        return _by_camera(spec, shots, usable, report, loose=layout.order.loose)
    return Survey(specs=(spec,), shots=shots, loose=False, guessed=layout.order.guessed)


def _shots(
    usable: Usable, places: Sequence[Place | None], owner: Mapping[str, tuple[int, int]], loose: bool
) -> tuple[Shot, ...]:
    """The images with a place; ``owner``: rig and sensor of each folder."""
    shots = []
    for image, name, place in zip(usable.images, usable.names, places):
        if place is not None:
            (rig, sensor), sequence = owner[place.folder], "" if loose else place.sequence
            stem = shot_stem(name, place.folder)
            shots.append(Shot(image=image, rig=rig, sensor=sensor, sequence=sequence, stem=stem))
    return tuple(shots)


def _guessed_rig(layout: Layout) -> RigSpec:
    if layout.folders == ("",):
        return RigSpec("camera", (SensorSpec("camera", "", body_from_sensor=np.eye(4)),), body_is_reference=True)
    roles = ["up" if words(f) & UP_WORDS else "side" for f in layout.folders]
    sensors = [SensorSpec(name=f.strip("*_-"), folder=f, role=role) for f, role in zip(layout.folders, roles)]
    first = replace(sensors[0], body_from_sensor=np.eye(4))
    return RigSpec("rig", (first, *sensors[1:]), body_is_reference=True)


def _assign_by_file(
    file: Path, read: Sequence[RigSpec], usable: Usable, settings: ScanSettings, report: Report, tuning: FoldersTuning
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
        order = order_of(usable.names, places, *usable.facts(), usable.layout(settings), tuning)
    report.notes.append(f"rig file {file.name}: {len(owner)} sensor(s)" + (f"; {order.why}" if order.why else ""))
    report.notes += [f"{file.name}: {text}" for spec in specs for text in contradictions(spec)]
    shots = _shots(usable, places, owner, order.loose)
    return Survey(specs=specs, shots=shots, loose=order.loose, guessed=order.guessed)


def _checked(spec: RigSpec) -> RigSpec:
    """The rig with a pose of its first sensor. Raises InputError if that needs one in the file."""
    first, *others = spec.sensors
    if first.body_from_sensor is not None:
        return spec
    posed = any(s.body_from_sensor is not None for s in others)
    if posed or spec.axes != "camera":
        raise InputError(
            f"{spec.file}: the first sensor, {first.name!r}, is the reference and needs an orientation, because "
            + ("other sensors have one" if posed else f"axes = {spec.axes} is not the sensor's own frame")
        )
    return replace(spec, sensors=(replace(first, body_from_sensor=np.eye(4)), *others), body_is_reference=True)


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
    for sensor in (s for spec in specs for s in spec.sensors if s.folder not in found):
        if is_pattern(sensor.folder or ""):
            raise InputError(
                f"{file}: sensor {sensor.name!r}: folder = {sensor.folder!r}, but no usable image has such a "
                f"name; names here are like {names[0]}. Correct folder, or remove the sensor from the file"
            )
        raise InputError(
            f"{file}: sensor {sensor.name!r}: no usable image below a folder {sensor.folder!r}; folders here: "
            f"{', '.join(there) or 'none'}{meant(sensor.folder or '', there)} (correct folder, or remove the sensor "
            "from the file)"
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


def _millimetres(exif: Exif) -> str:
    zoom = f" zoom {exif.zoom:g}" if exif.zoom > 1 else ""
    return f"{exif.focal_mm:.1f}mm{zoom}" if np.isfinite(exif.focal_mm) else ""


def into_frames(survey: Survey, files: Sequence[str], how: str, report: Report) -> Survey:
    """The survey with the frame of each image; second images of a frame are dropped in the report."""
    groups: dict[tuple[int, str], list[Shot]] = {}
    for shot in survey.shots:
        groups.setdefault((shot.rig, shot.sequence), []).append(shot)
    out: list[Shot] = []
    for (_, sequence), shots in groups.items():
        if survey.loose:
            out += [replace(s, key=files[s.image]) for s in shots]
            continue
        sensors = sorted({s.sensor for s in shots})
        stems = {k: [s.stem for s in shots if s.sensor == k] for k in sensors}
        keys, by = match_frames(stems, how)
        _say_frames(sequence, by, stems, how, report)
        for sensor in sensors:
            mine = [s for s in shots if s.sensor == sensor]
            out += _without_twins([replace(s, key=key) for s, key in zip(mine, keys[sensor])], files, report)
    return replace(survey, shots=tuple(sorted(out, key=lambda s: s.image)))


def _say_frames(sequence: str, how: str, stems: dict[int, list[str]], asked: str, report: Report) -> None:
    found = {"number": "last number" if asked == "auto" else "", "time": "times"}.get(how)
    if found and len(stems) > 1:
        report.notes.append(f"pass {sequence}: images of one frame found by the {found} in their names")
    if how == "order" and len(stems) > 1:
        counts = sorted({len(s) for s in stems.values()})
        text = f"pass {sequence}: file names do not show which images belong together; taken in the order of names"
        if len(counts) > 1:
            text += f", although the cameras have {counts[0]} to {counts[-1]} images: check, or rename them"
        report.notes.append(text)


def _without_twins(shots: list[Shot], names: Sequence[str], report: Report) -> list[Shot]:
    first: dict[str, Shot] = {}
    for shot in shots:
        used = first.setdefault(shot.key, shot)
        if used is not shot:
            report.drop([names[shot.image]], f"a second image of frame {shot.key}; {names[used.image]} is used")
    return list(first.values())


def match_frames(stems: Mapping[int, Sequence[str]], how: str) -> tuple[dict[int, list[str]], str]:
    """Frame label of each image of one pass, by sensor, from the file stems, and how: name, number, time or order.

    Auto: equal names if half of them agree; else equal last numbers in the names, which are frame numbers in the
    papers' data (paper 000 figure 8: image0up_168035.jpg); else names that are nearly equal times; else the place in
    the natural order of names.
    """
    if how in ("auto", "name"):
        by_name = {sensor: list(s) for sensor, s in stems.items()}
        if how == "name" or _shared(by_name) >= 0.5:
            return by_name, "name"
    if how in ("auto", "number"):
        by_number = {}
        for sensor, names in stems.items():
            numbers = [re.findall(r"\d+", s) for s in names]
            by_number[sensor] = [str(int(n[-1])) if n else s for n, s in zip(numbers, names)]
        once = [[c == 1 for c in Counter(k).values()] for k in by_number.values()]
        # Numbers that number frames mostly occur once in a camera's names
        if how == "number" or (_shared(by_number) >= 0.5 and all(sum(c) >= 0.9 * len(c) for c in once)):
            return by_number, "number"
    if how == "auto" and (by_time := _by_time(stems)) and _shared(by_time) >= 0.5:
        return by_time, "time"
    by_order = {}
    for sensor, names in stems.items():
        rank = {s: k for k, s in enumerate(sorted(set(names), key=natural))}
        by_order[sensor] = [f"{rank[s]:06d}" for s in names]
    return by_order, "order"


def _by_time(stems: Mapping[int, Sequence[str]]) -> dict[int, list[str]]:
    """By sensor the nearest name in time in the fullest sensor, or the image's own name if none is near."""
    seconds = {k: np.array([time_in_name(s) for s in names]) for k, names in stems.items()}
    fullest = max(stems, key=lambda k: len(stems[k]))
    order = np.argsort(seconds[fullest])
    ordered = seconds[fullest][order]
    if any(np.isnan(t).any() for t in seconds.values()) or len(ordered) < 2:
        return {}
    near, out = 0.25 * float(np.median(np.diff(ordered))), {}
    for sensor, own in seconds.items():
        nearest = np.array([int(np.argmin(np.abs(ordered - t))) for t in own])
        close = np.abs(ordered[nearest] - own) <= near
        labels = [stems[fullest][order[n]] for n in nearest]
        out[sensor] = [label if c else stem for label, c, stem in zip(labels, close, stems[sensor])]
    return out


def _shared(keys: dict[int, list[str]]) -> float:
    """Share of the images of the sensor with fewest partners that have a partner in the fullest one."""
    sets = [set(k) for k in keys.values()]
    fullest = max(sets, key=len)
    return min(len(s & fullest) / len(s) for s in sets)
