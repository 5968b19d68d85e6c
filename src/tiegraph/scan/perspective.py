"""Equirectangular panoramas: each becomes one frame of a rig of pinhole views that share its centre."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.assign import Report, Shot, Survey, Usable
from tiegraph.scan.folders import guess_layout
from tiegraph.scan.rigfiles.rigspec import RigSpec, SensorSpec, orient
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import PanoramaTuning, Tuning
from tiegraph.scene.images import Probe
from tiegraph.scene.panorama import seen
from tiegraph.text import some

PRESET = "panorama"


@dataclass(frozen=True)
class SharedFiles:
    """The images of a survey whose files hold a whole shot each: names, probes, files and owners, parallel."""

    names: tuple[str, ...]
    probes: tuple[Probe, ...]
    files: tuple[str, ...]
    survey: Survey

    def order(self) -> str:
        """How they are ordered, for people."""
        passes = len({s.sequence for s in self.survey.shots})
        return "in no order" if self.survey.loose else f"in the order of their names, {passes} pass(es)"


def perspective_views(
    usable: Usable, rig: str | None, settings: ScanSettings, report: Report, tuning: Tuning
) -> SharedFiles | None:
    """Views of a survey of panoramas; None if it is none.

    Panoramas are noticed where no rig is given and most images are some; ``panorama`` as rig says so. Raises InputError
    if none of the images is twice as wide as high although the user says they are panoramas.
    """
    said = (rig or "").strip().lower() == PRESET
    full = [p.sphere is not None and (said or p.sphere.sure) for p in usable.probes]
    if said and not any(full):
        sizes = some(f"{w} x {h}" for w, h in sorted({p.upright_size() for p in usable.probes}))
        raise InputError(
            f"--rig {PRESET}: no image is twice as wide as high ({sizes}), as equirectangular panoramas are, or "
            "has tags that say which part of one it is (GPano)"
        )
    if not said and (rig is not None or sum(full) <= tuning.panorama.most * len(full)):
        if any(full):
            report.notes.append(f"{sum(full)} images look like panoramas; --rig {PRESET} reads them as such")
        return None
    could = [p.sphere is not None for p in usable.probes]
    kept = of_one_kind(usable, full, could, "not a panorama, as most images here are", report)
    return _views(kept, settings, report, tuning)


def of_one_kind(
    usable: Usable, surely: Sequence[bool], could: Sequence[bool], otherwise: str, report: Report
) -> Usable:
    """The images that are ``surely`` of a kind, and those of their sizes that ``could`` be: it does not show in one
    taken in the dark. The report gets the others, with the reason ``otherwise``."""
    sizes_px = {(p.width, p.height) for p, sure in zip(usable.probes, surely) if sure}
    kept = [k for k, p in enumerate(usable.probes) if could[k] and (p.width, p.height) in sizes_px]
    report.drop([n for k, n in enumerate(usable.names) if k not in set(kept)], otherwise)
    names, probes = tuple(usable.names[k] for k in kept), tuple(usable.probes[k] for k in kept)
    return replace(usable, images=tuple(usable.images[k] for k in kept), names=names, probes=probes)


def _views(usable: Usable, settings: ScanSettings, report: Report, tuning: Tuning) -> SharedFiles:
    spheres = [p.sphere for p in usable.probes if p.sphere is not None]
    width = sorted(s.width for s in spheres)[len(spheres) // 2]
    spec = panorama_rig(width, tuning.panorama)
    shared = share_files(usable, spec, settings, tuning)
    columns, rows = spec.sensors[0].size or (0, 0)
    cameras = [pycolmap.Camera(model=s.model, width=columns, height=rows, params=s.params) for s in spec.sensors]
    turns = [np.reshape(s.view_of_panorama, (3, 3)) for s in spec.sensors]
    of = {s.image: (shared.probes[s.image].sphere, s.sensor) for s in shared.survey.shots}
    share = {k: seen(sphere, cameras[view], turns[view]) for k, (sphere, view) in of.items() if sphere is not None}
    shots = tuple(s for s in shared.survey.shots if share[s.image] > 0)
    level, parts = len(spec.sensors) - 1, sum(s.part for s in spheres)
    report.notes.append(
        f"{len(usable.names)} equirectangular panoramas, {width} x {width // 2} pixels: each unfolded into {level} "
        f"level views and one up, of {columns} x {rows} pixels: a calibrated rig without a base; {shared.order()}"
    )
    if parts:
        report.notes.append(
            f"{parts} of the panoramas are parts of a sphere, by their tags (GPano) or for the rest is black: what is "
            f"not in them is masked, and {len(shared.survey.shots) - len(shots)} views that see nothing are left out"
        )
    # What is masked of a view is the transparency of its file.
    names = [n if share[k] == 1 else str(PurePosixPath(n).with_suffix(".png")) for k, n in enumerate(shared.names)]
    probes = tuple(_as_view(p, columns, rows) for p in shared.probes)
    return replace(shared, names=tuple(names), probes=probes, survey=replace(shared.survey, shots=shots))


def share_files(usable: Usable, spec: RigSpec, settings: ScanSettings, tuning: Tuning) -> SharedFiles:
    """The images that the sensors of a rig have of each file, named as it in a folder of the sensor's name, with the
    probes of the files."""
    kind = "sequence" if settings.layout == "auto" else settings.layout
    exif, sizes = usable.facts()
    layout = guess_layout(usable.names, exif, sizes, kind, tuning.folders)
    views: list[str] = []
    shots: list[Shot] = []
    for name, place in zip(usable.names, layout.places):
        path = PurePosixPath(name)
        sequence = "" if layout.loose or place is None else place.sequence
        for k, sensor in enumerate(spec.sensors):
            shots.append(Shot(image=len(views), rig=0, sensor=k, sequence=sequence, stem=path.stem))
            views.append(str(path.parent / sensor.name / path.name))
    each = len(spec.sensors)
    return SharedFiles(
        names=tuple(views),
        probes=tuple(p for p in usable.probes for _ in range(each)),
        files=tuple(n for n in usable.names for _ in range(each)),
        survey=Survey((spec,), tuple(shots), layout.loose),
    )


def _as_view(probe: Probe, width: int, height: int) -> Probe:
    return replace(probe, width=width, height=height, exif=replace(probe.exif, focal_px=float("nan"), orientation=1))


def panorama_rig(width_px: int, tuning: PanoramaTuning) -> RigSpec:
    """The rig of pinhole views into which a panorama of a width is unfolded, at the resolution of its horizon."""
    focal = width_px / (2 * np.pi)
    width, height = (2 * round(focal * np.tan(np.radians(v) / 2)) for v in (tuning.hfov_deg, tuning.vfov_deg))
    around = tuning.around
    poses = [orient(360.0 / around * k, 0, 0) for k in range(around)] + [orient(0, 90, 0)]
    sensors = tuple(
        SensorSpec(
            name=f"view{k}",
            folder=f"view{k}",
            role="up" if k == around else "side",
            body_from_sensor=rigid(pose, np.zeros(3)),
            model="SIMPLE_PINHOLE",
            size=(width, height),
            params=(focal, width / 2, height / 2),
            view_of_panorama=tuple(pose.T.ravel().tolist()),
        )
        for k, pose in enumerate(poses)
    )
    return RigSpec(PRESET, sensors, fixed=True, body_is_reference=True)
