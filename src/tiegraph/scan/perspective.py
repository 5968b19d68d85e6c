"""Equirectangular panoramas: each becomes one frame of a rig of pinhole views that share its centre."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.assign import Report, Shot, Survey, Usable, some
from tiegraph.scan.folders import guess_layout
from tiegraph.scan.rigspec import RigSpec, SensorSpec, orient
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import PanoramaTuning, Tuning
from tiegraph.scene.images import Probe

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
    full = [p.width == 2 * p.height if said else p.panorama for p in usable.probes]
    if said and not any(full):
        sizes = some(f"{w} x {h}" for w, h in sorted({p.upright_size() for p in usable.probes}))
        raise InputError(f"--rig {PRESET}: no image is twice as wide as high ({sizes}): equirectangular panoramas are")
    if not said and (rig is not None or sum(full) <= tuning.panorama.most * len(full)):
        if any(full):
            report.notes.append(f"{sum(full)} images look like panoramas; --rig {PRESET} reads them as such")
        return None
    sizes_px = {(p.width, p.height) for p, f in zip(usable.probes, full) if f}
    full = [f or (p.width, p.height) in sizes_px for p, f in zip(usable.probes, full)]  # one with dark poles, say
    report.drop([n for n, f in zip(usable.names, full) if not f], "not a panorama, as most images here are")
    names = tuple(n for n, f in zip(usable.names, full) if f)
    probes = tuple(p for p, f in zip(usable.probes, full) if f)
    return _views(names, probes, settings, report, tuning)


def _views(
    names: tuple[str, ...], probes: tuple[Probe, ...], settings: ScanSettings, report: Report, tuning: Tuning
) -> SharedFiles:
    width = Counter(p.width for p in probes).most_common(1)[0][0]
    spec = panorama_rig(width, tuning.panorama)
    shared = share_files(names, probes, spec, settings, tuning)
    sensors = [spec.sensors[s.sensor] for s in shared.survey.shots]
    made = tuple(_as_view(p, p.width / width, s) for p, s in zip(shared.probes, sensors))
    columns, rows = spec.sensors[0].size or (0, 0)
    level = len(spec.sensors) - 1
    report.notes.append(
        f"{len(names)} equirectangular panoramas, {width} x {width // 2} pixels: each unfolded into {level} level "
        f"views and one up, of {columns} x {rows} pixels: a calibrated rig without a base; {shared.order()}"
    )
    return replace(shared, probes=made)


def share_files(
    names: tuple[str, ...], probes: tuple[Probe, ...], spec: RigSpec, settings: ScanSettings, tuning: Tuning
) -> SharedFiles:
    """The images that the sensors of a rig have of each file, named as it in a folder of the sensor's name, with the
    probes of the files."""
    kind = "sequence" if settings.layout == "auto" else settings.layout
    sizes = [p.upright_size() for p in probes]
    layout = guess_layout(names, [p.exif for p in probes], sizes, kind, tuning.folders)
    views: list[str] = []
    shots: list[Shot] = []
    for name, place in zip(names, layout.places):
        path = PurePosixPath(name)
        sequence = "" if layout.loose or place is None else place.sequence
        for k, sensor in enumerate(spec.sensors):
            shots.append(Shot(image=len(views), rig=0, sensor=k, sequence=sequence, stem=path.stem))
            views.append(str(path.parent / sensor.name / path.name))
    each = len(spec.sensors)
    return SharedFiles(
        names=tuple(views),
        probes=tuple(p for p in probes for _ in range(each)),
        files=tuple(n for n in names for _ in range(each)),
        survey=Survey((spec,), tuple(shots), layout.loose),
    )


def _as_view(probe: Probe, scale: float, sensor: SensorSpec) -> Probe:
    width, height = sensor.size or (0, 0)
    exif = replace(probe.exif, focal_px=float("nan"), orientation=1)
    return replace(probe, width=round(width * scale), height=round(height * scale), exif=exif)


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
            of_panorama=True,
        )
        for k, pose in enumerate(poses)
    )
    return RigSpec(PRESET, sensors, fixed=True, body_is_reference=True)
