"""Fisheye images: what their lens lights, and those that see far aside cut into pinhole views, a rig with one centre.

COLMAP verifies and registers in the plane before the camera, where an error of a pixel 75 degrees off the axis counts
15 times, and beyond 90 degrees there is no such plane: the outer half of a 200 degree fisheye ties hardly anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.assign import Report, Shot, Survey, some
from tiegraph.scan.rigspec import orient
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import LensViewsTuning
from tiegraph.scene.fisheye import is_fisheye, seen_half_deg
from tiegraph.scene.images import Probe
from tiegraph.scene.rig import LensView, Rig, Sensor, SensorPair, Source


@dataclass(frozen=True)
class Pictures:
    """The images of a survey: their names, what a look at the files found, and the files; parallel."""

    names: Sequence[str]
    probes: Sequence[Probe]
    files: Sequence[str]


def with_lit_circle(sensor: Sensor, probes: Sequence[Probe], tuning: LensViewsTuning) -> Sensor:
    """A sensor with the circle that its fisheye lens lights, without the blurred rim, if most of its images show one.

    The median over the images, of those circles whose middle cropping leaves.
    """
    if not is_fisheye(sensor.camera):
        return sensor
    source = sensor.source or Source(camera=sensor.camera)
    left, top, right, bottom = source.crop_px
    found = []
    for probe in probes:
        if probe.exif.orientation > 1 and source.upright:
            continue
        inside = [c for c in probe.circles if left < c[0] < probe.width - right and top < c[1] < probe.height - bottom]
        found += inside[:1]
    if len(found) <= tuning.most * len(probes):
        return sensor
    x, y, radius = (float(v) for v in np.median(found, axis=0))
    return replace(sensor, source=replace(source, circle_px=(x - left, y - top, radius * (1 - tuning.rim))))


def into_views(
    rigs: tuple[Rig, ...], survey: Survey, pictures: Pictures, settings: ScanSettings, report: Report,
    tuning: LensViewsTuning,
) -> tuple[tuple[Rig, ...], Survey, Pictures]:  # fmt: skip
    """The survey with views in place of wide fisheye images. Raises InputError if they are asked for and impossible."""
    cut = {(r, k): _why_not(s, settings, tuning) for r, rig in enumerate(rigs) for k, s in enumerate(rig.sensors)}
    _say(rigs, cut, settings, report)
    if not any(why == "" for why in cut.values()):
        return rigs, survey, pictures
    made: list[Rig] = []
    places: dict[tuple[int, int], list[int]] = {}
    for r, rig in enumerate(rigs):
        sensors: list[Sensor] = []
        for k, sensor in enumerate(rig.sensors):
            views = _views(sensor, tuning) if cut[r, k] == "" else [sensor]
            places[r, k] = list(range(len(sensors), len(sensors) + len(views)))
            sensors += views
        made.append(_rig_of_views(rig, tuple(sensors)))
    shots: list[Shot] = []
    names: list[str] = []
    probes: list[Probe] = []
    files: list[str] = []
    for shot in survey.shots:
        for place in places[shot.rig, shot.sensor]:
            sensor = made[shot.rig].sensors[place]
            path = PurePosixPath(pictures.names[shot.image])
            view = sensor.source is not None and sensor.source.view is not None
            shots.append(replace(shot, sensor=place, image=len(names)))
            names.append(str(path.parent / PurePosixPath(sensor.folder).name / path.name) if view else str(path))
            probes.append(pictures.probes[shot.image])
            files.append(pictures.files[shot.image])
    return tuple(made), replace(survey, shots=tuple(shots)), Pictures(names, probes, files)


def _rig_of_views(rig: Rig, sensors: tuple[Sensor, ...]) -> Rig:
    """A rig with views in place of lenses: those of one lens stand exactly to each other, so it is held where its
    lenses are, and where they are drawn or measured with a sigma, each view has that of its lens."""
    pairs = tuple(_between_views(p, sensors) for p in rig.pairs)
    held = len(rig.sensors) == 1 or rig.fixed or (rig.known() and not rig.nominal and not rig.soft())
    return replace(rig, sensors=sensors, pairs=pairs, fixed=held)


def _why_not(sensor: Sensor, settings: ScanSettings, tuning: LensViewsTuning) -> str | None:
    """ "" for a sensor whose images are cut into views; why not, where somebody should know; else None."""
    camera = sensor.camera
    if settings.fisheye == "whole" or camera is None or not is_fisheye(camera):
        return None
    wide = seen_half_deg(camera)
    if settings.fisheye == "auto" and wide < tuning.wider_deg / 2:
        return None
    bent = bool(np.any(np.asarray(camera.params)[camera.extra_params_idxs()]))
    known = camera.has_prior_focal_length and (bent or settings.fisheye == "views")
    return "" if known else "its lens is not calibrated"


def _say(rigs: Sequence[Rig], cut: dict[tuple[int, int], str | None], settings: ScanSettings, report: Report) -> None:
    named = {why: [rigs[r].sensors[k].name for (r, k), w in cut.items() if w == why] for why in cut.values() if why}
    for why, names in named.items():
        if settings.fisheye == "views":
            raise InputError(
                f"scan.fisheye = views: {some(names)}: {why}; give its camera in a rig file (that of a run of the "
                "whole images will do: `tiegraph rig OUT`)"
            )
        report.notes.append(
            f"{some(names)}: fisheye images are used whole and only near their axis, for {why}; with a rig file that "
            "has its distortion (`tiegraph rig OUT` of this run) they are cut into views and used up to 90 degrees"
        )
    names = [rigs[r].sensors[k].name for (r, k), why in cut.items() if why == ""]
    if names:
        report.notes.append(
            f"{some(names)}: each fisheye image is cut into {_COUNT} views up to 90 degrees off its axis"
        )


_COUNT = 5
_AXES = ("front", "right", "left", "up", "down")


def _views(sensor: Sensor, tuning: LensViewsTuning) -> list[Sensor]:
    """The views of a lens: ahead, right, left, up and down, at the resolution of its middle."""
    lens, source = sensor.camera, sensor.source or Source()
    assert lens is not None
    half = np.radians(tuning.fov_deg / 2)
    focal = lens.mean_focal_length()
    side = 2 * round(focal * np.tan(half))
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=side, height=side, params=[focal, side / 2, side / 2])
    camera.has_prior_focal_length = True
    off = tuning.off_axis_deg
    out = []
    for name, yaw, pitch in zip(_AXES, (0, off, -off, 0, 0), (0, 0, 0, off, -off)):
        view_from_lens = orient(yaw, pitch, 0).T
        view = LensView(sensor.name, lens, tuple(float(v) for v in view_from_lens.ravel()))
        pose = sensor.sensor_from_rig
        made = replace(
            sensor,
            name=f"{sensor.name}-{name}",
            folder=str(PurePosixPath(sensor.folder) / name),
            camera=camera,
            source=replace(source, camera=camera, view=view),
        )
        turned = None if pose is None else rigid(view_from_lens, np.zeros(3)) @ pose
        out.append(replace(made, camera_sigma_px=None, sensor_from_rig=turned))
    return out


def _between_views(pair: SensorPair, sensors: Sequence[Sensor]) -> SensorPair:
    """What was measured between two lenses, between their front views, which have their centres and axes."""
    there = {s.name for s in sensors}
    first, second = (n if n in there else f"{n}-{_AXES[0]}" for n in pair.sensors)
    return replace(pair, sensors=(first, second))
