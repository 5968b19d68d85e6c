"""Matches as bearing vectors, read from COLMAP's database frame pair by frame pair, in whichever process needs them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.filter.motion import Rays
from tiegraph.geometry import transforms
from tiegraph.scene.colmapdatabase import Rows
from tiegraph.scene.regular import cached_by_file
from tiegraph.scene.rig import camera_from_dict, camera_to_dict, pixel_rays
from tiegraph.scene.scene import Scene

_CACHED_IMAGES = 512  # of about 100 kB each, in every worker

Task = tuple[int, int, tuple[tuple[int, int], ...]]


@dataclass(frozen=True)
class Calibration:
    """Cameras and extrinsics by sensor key, and which sensor and unit (frame, or image for itself) an image belongs to.

    Picklable. ``rig_from_sensor`` (S, 4, 4) is the identity for units that are images.
    """

    cameras: tuple[dict, ...]
    rig_from_sensor: np.ndarray
    sensor: np.ndarray  # (N,) sensor key
    unit: np.ndarray  # (N,)

    @staticmethod
    def of(scene: Scene, by_frame: bool) -> Calibration:
        """Units are frames of the rig, or images."""
        sensors = scene.all_sensors
        cameras = tuple(camera_to_dict(s.camera) or {} for s in sensors)
        poses = [np.eye(4) if not by_frame or s.sensor_from_rig is None else s.sensor_from_rig for s in sensors]
        unit = scene.frame if by_frame else np.arange(len(scene))
        inverse = transforms.invert(np.stack(poses))
        return Calibration(
            cameras=cameras, rig_from_sensor=inverse, sensor=np.asarray(scene.sensor_key), unit=np.asarray(unit)
        )

    def turned(self, turns: np.ndarray) -> Calibration:
        """The same with each sensor's rays turned in the rig frame by a rotation (S, 3, 3)."""
        pose = self.rig_from_sensor.copy()
        pose[:, :3, :3] = turns @ pose[:, :3, :3]
        return replace(self, rig_from_sensor=pose)

    def focal_px(self) -> float:
        """Mean focal length."""
        return float(np.mean([_camera(i, self.cameras).mean_focal_length() for i in range(len(self.cameras))]))

    def size(self) -> float:
        """Largest distance of a centre from the rig's origin."""
        return float(np.linalg.norm(self.rig_from_sensor[:, :3, 3], axis=1).max())


def _camera(key: int, cameras: Sequence[dict]) -> pycolmap.Camera:
    camera = camera_from_dict(cameras[key])
    if camera is None or not cameras[key]:
        raise InputError(f"sensor {key} has no camera: no image of it was found, take it off the rig")
    return camera


def load(task: Task, database: str, calibration: Calibration, most: int) -> Rays:
    """The matches of all image pairs (i, j) of two units, i in the first: at most ``most`` of each, spread evenly."""
    parts: list[list[np.ndarray]] = [[] for _ in range(5)]
    for number, (i, j) in enumerate(task[2]):
        matches = _connection(database).verified_of(i + 1, j + 1)
        if len(matches) > most:
            matches = matches[np.linspace(0, len(matches) - 1, most).astype(int)]
        for side, (image, column) in enumerate(((i, 0), (j, 1))):
            key = int(calibration.sensor[image])
            pose = calibration.rig_from_sensor[key]
            camera = tuple(sorted((k, _frozen(v)) for k, v in calibration.cameras[key].items()))
            rays = _rays(database, image, camera)[matches[:, column]]
            parts[side].append(rays @ pose[:3, :3].T)
            parts[2 + side].append(np.broadcast_to(pose[:3, 3], rays.shape))
        parts[4].append(np.full(len(matches), number))
    return Rays(*(np.concatenate(p) for p in parts))


def _frozen(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value


@cached_by_file(maxsize=2)
def _connection(database: str) -> Rows:
    return Rows(Path(database), any_thread=True)


def forget() -> None:
    """Close the database and drop cached rays of this process."""
    _connection.cache_clear()
    _rays.cache_clear()


@cached_by_file(maxsize=_CACHED_IMAGES)
def _rays(database: str, image: int, camera: tuple) -> np.ndarray:
    """(K, 3) unit rays of an image's key points in the sensor frame."""
    points = _connection(database).keypoints_of(image + 1)
    if not len(points):
        return np.zeros((0, 3))
    return np.nan_to_num(pixel_rays(_camera(0, [dict(camera)]), points))
