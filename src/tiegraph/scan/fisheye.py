"""Fisheye images: the circle that their lens lights, and wide ones cut into pinhole views, a rig with one centre.

COLMAP verifies and registers in the plane before the camera, where an error of a pixel 75 degrees off the axis counts
15 times, and beyond 90 degrees there is no such plane: the outer half of a 200 degree fisheye has hardly any ties.

Two lenses back to back are a 360 camera: its level views point in all directions, as those of a panorama, because the
carrier is below. One lens is rotated against the other about the camera's vertical, so their relative rotation gives
the camera's position in their images. A lens without such a partner is cut into views around its axis.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePosixPath

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.assign import ImageFiles, Report, Shot, Survey
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import LensViewsTuning, PanoramaTuning
from tiegraph.scene.images import Probe
from tiegraph.scene.rig import LensView, Rig, Sensor, Source
from tiegraph.scene.wideviews import is_fisheye, seen_half_deg
from tiegraph.text import some


def with_lit_circle(sensor: Sensor, probes: Sequence[Probe], tuning: LensViewsTuning) -> Sensor:
    """A sensor with the circle that its fisheye lens lights, without the blurred rim, if most of its images have one.

    The median over the images of those circles whose centre remains after cropping.
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
    if 2 * len(found) <= len(probes):
        return sensor
    x, y, radius = (float(v) for v in np.median(found, axis=0))
    return replace(sensor, source=replace(source, circle_px=(x - left, y - top, radius * (1 - tuning.rim))))


def into_views(
    rigs: tuple[Rig, ...], survey: Survey, pictures: ImageFiles, settings: ScanSettings, report: Report,
    tuning: LensViewsTuning, level: PanoramaTuning,
) -> tuple[tuple[Rig, ...], Survey, ImageFiles]:  # fmt: skip
    """The survey with views instead of wide fisheye images. Raises InputError if they are requested and impossible."""
    cut = {(r, k): _why_not(s, settings, tuning) for r, rig in enumerate(rigs) for k, s in enumerate(rig.sensors)}
    _say(rigs, cut, settings, report, tuning)
    if not any(why == "" for why in cut.values()):
        return rigs, survey, pictures
    made: list[Rig] = []
    places: dict[tuple[int, int], list[int]] = {}
    for r, rig in enumerate(rigs):
        sensors: list[Sensor] = []
        for k, sensor in enumerate(rig.sensors):
            views = _views(sensor, *_turns(rig, k, tuning, level)) if cut[r, k] == "" else [sensor]
            places[r, k] = list(range(len(sensors), len(sensors) + len(views)))
            sensors += views
        # A measurement between two lenses also holds between their front views, which have their centres and axes.
        front = {s.name: s.name if s in sensors else f"{s.name}-{_FRONT}" for s in rig.sensors}
        pairs = tuple(replace(p, sensors=(front[p.sensors[0]], front[p.sensors[1]])) for p in rig.pairs)
        # The views of one lens have exact relative poses, so the rig is held if its lenses are; if these are nominal
        # or measured with a sigma, each view has that of its lens.
        held = len(rig.sensors) == 1 or rig.fixed or (rig.known() and not rig.nominal and not rig.soft())
        made.append(replace(rig, sensors=tuple(sensors), pairs=pairs, fixed=held))
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
    return tuple(made), replace(survey, shots=tuple(shots)), ImageFiles(names, probes, files)


def _why_not(sensor: Sensor, settings: ScanSettings, tuning: LensViewsTuning) -> str | None:
    """ "" for a sensor whose images are cut into views; a reason against it that users should know; else None."""
    camera = sensor.camera
    if settings.fisheye == "whole" or camera is None or not is_fisheye(camera):
        return None
    wide = seen_half_deg(camera)
    if settings.fisheye == "auto" and wide < tuning.wider_deg / 2:
        return None
    bent = bool(np.any(np.asarray(camera.params)[camera.extra_params_idxs()]))
    known = camera.has_prior_focal_length and (bent or settings.fisheye == "views")
    if not known:
        return "its lens is not calibrated"
    rough = (sensor.camera_sigma_px or 0.0) > tuning.most_sigma * camera.mean_focal_length()
    start = f"its calibration is an initial value (sigma of the focal length above {100 * tuning.most_sigma:g} %)"
    return start if rough and settings.fisheye == "auto" else ""


def _say(
    rigs: Sequence[Rig],
    cut: dict[tuple[int, int], str | None],
    settings: ScanSettings,
    report: Report,
    tuning: LensViewsTuning,
) -> None:
    named = {why: [rigs[r].sensors[k].name for (r, k), w in cut.items() if w == why] for why in cut.values() if why}
    for why, names in named.items():
        if settings.fisheye == "views":
            raise InputError(
                f"scan.fisheye = views: {some(names)}: {why}; give its camera in a rig file (that of a run of the "
                "whole images is enough: `tiegraph rig OUT`)"
            )
        report.notes.append(
            f"{some(names)}: fisheye images are used whole, with few ties far off their axis, because {why}; with its "
            "distortion in a rig file (`tiegraph rig OUT` of this run) they are cut into views and used nearly up to 90"
        )
    names = [rigs[r].sensors[k].name for (r, k), why in cut.items() if why == ""]
    if names:
        report.notes.append(
            f"{some(names)}: each fisheye image is cut into views up to {tuning.reach_deg:g} degrees off its axis"
        )


_FRONT = "front"


def _turns(
    rig: Rig, sensor: int, tuning: LensViewsTuning, level: PanoramaTuning
) -> tuple[dict[str, np.ndarray], tuple[float, float]]:
    """The views that a lens is cut into: view_from_lens (3, 3) by name, and their fields of view, degrees."""
    upright = _upright(rig, sensor, tuning)
    if upright is None:
        off = tuning.reach_deg - tuning.fov_deg / 2
        ways = {_FRONT: (0.0, 0.0), "right": (off, 0.0), "left": (-off, 0.0), "up": (0.0, off), "down": (0.0, -off)}
        return {n: orient(*way, 0).T for n, way in ways.items()}, (tuning.fov_deg, tuning.fov_deg)
    off = tuning.reach_deg - level.hfov_deg / 2
    turns = {n: orient(yaw, 0, 0).T @ upright for n, yaw in ((_FRONT, 0.0), ("right", off), ("left", -off))}
    return turns, (level.hfov_deg, level.vfov_deg)


def _upright(rig: Rig, sensor: int, tuning: LensViewsTuning) -> np.ndarray | None:
    """The rotation (3, 3) about its axis that makes a lens' image upright, none or a quarter, by the lens in the
    opposite direction; None if there is none. The sense of a quarter is unknown."""
    mine = rig.sensors[sensor].sensor_from_rig
    for other in rig.sensors:
        if mine is None or other.sensor_from_rig is None or not is_fisheye(other.camera):
            continue
        turn = Rotation.from_matrix(mine[:3, :3] @ other.sensor_from_rig[:3, :3].T).as_rotvec()
        if mine[2, :3] @ other.sensor_from_rig[2, :3] <= np.cos(np.radians(tuning.back_to_back_deg)):
            return orient(0, 0, 90.0 if abs(turn[0]) > abs(turn[1]) else 0.0)
    return None


def _views(sensor: Sensor, turns: dict[str, np.ndarray], fov_deg: tuple[float, float]) -> list[Sensor]:
    """The views of a lens at the resolution of its middle."""
    lens, source = sensor.camera, sensor.source or Source()
    assert lens is not None
    focal = lens.mean_focal_length()
    width, height = (2 * round(focal * np.tan(np.radians(v / 2))) for v in fov_deg)
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=width, height=height, params=[focal, width / 2, height / 2])
    camera.has_prior_focal_length = True
    pose = sensor.sensor_from_rig
    return [
        replace(
            sensor,
            name=f"{sensor.name}-{name}",
            folder=str(PurePosixPath(sensor.folder) / name),
            camera=camera,
            camera_sigma_px=None,
            source=replace(source, camera=camera, view=LensView(sensor.name, lens, tuple(turn.ravel().tolist()))),
            sensor_from_rig=None if pose is None else rigid(turn, np.zeros(3)) @ pose,
        )
        for name, turn in turns.items()
    ]
