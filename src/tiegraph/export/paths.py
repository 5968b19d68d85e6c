"""Trajectories: TUM and KITTI, one a pass; of the rig (its first camera), or of the camera that is asked for."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.export.survey import Survey, unique_names, write_offset
from tiegraph.geometry.transforms import invert
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.posefile import FREE_UNIT, write_tum

_LOOSE = "photographs"  # that belong to no pass


@dataclass(frozen=True)
class _Path:
    """Name of a file or folder, time_s (T,), world_from_body (T, 4, 4)."""

    name: str
    time_s: np.ndarray
    poses: np.ndarray


def tum(survey: Survey, target: Path) -> int:
    """``<pass>.tum``; the number of poses."""
    said = [] if survey.unit == "m" else [FREE_UNIT]
    paths = list(_paths(survey))
    for path in paths:
        write_tum(target / f"{path.name}.tum", path.time_s, path.poses, said)
    write_offset(survey, target)
    return sum(len(path.poses) for path in paths)


def kitti(survey: Survey, target: Path) -> int:
    """``<pass>/poses.txt``, twelve numbers a pose, and ``<pass>/times.txt``; the number of poses."""
    paths = list(_paths(survey))
    for path in paths:
        (target / path.name).mkdir()
        np.savetxt(target / path.name / "poses.txt", path.poses[:, :3].reshape(-1, 12), "%.12g")
        np.savetxt(target / path.name / "times.txt", path.time_s, "%.6f")
    write_offset(survey, target)
    return sum(len(path.poses) for path in paths)


def _paths(survey: Survey) -> Iterator[_Path]:
    """The passes that have poses. Where the time of a frame is unknown, all of a pass count from 0.

    Raises InputError for a camera that no pose is of.
    """
    scene, pose = survey.scene, np.full((survey.scene.frames, 4, 4), np.nan)
    cameras = {scene.sensor_of(survey.index(image)).name for image in survey.images()}
    if survey.camera and survey.camera not in cameras:
        raise InputError(f"--camera {survey.camera}: no pose is of it; there are {', '.join(sorted(cameras))}")
    for image in survey.images():
        index = survey.index(image)
        if not survey.camera:
            rig_from_world = survey.model.frame(image.frame_id).rig_from_world
            assert rig_from_world is not None  # it has a pose
            pose[scene.frame[index]] = invert(matrix(rig_from_world))
        elif scene.sensor_of(index).name == survey.camera:
            pose[scene.frame[index]] = invert(matrix(image.cam_from_world()))
    names = unique_names([*scene.sequences, _LOOSE], {})
    for number, name in [*enumerate(scene.sequences), (-1, _LOOSE)]:
        frames = scene.in_order((scene.sequence == number) & np.isfinite(pose[:, 0, 0]))
        if len(frames):
            times = scene.time_s[frames]
            times = times if np.isfinite(times).all() else np.arange(len(frames), dtype=float)
            yield _Path(names[name], times, pose[frames])
