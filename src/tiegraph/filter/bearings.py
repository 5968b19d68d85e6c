"""Matches as bearing vectors, read from COLMAP's database pair by pair, in whichever process needs them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.scene.atomic import cached_by_file
from tiegraph.scene.colmapdatabase import Rows
from tiegraph.scene.rig import camera_from_dict, camera_to_dict, pixel_rays
from tiegraph.scene.scene import Scene

_CACHED_IMAGES = 512  # of about 100 kB each, in every worker

Camera = tuple[tuple[str, object], ...]  # items of ``camera_to_dict``, so that rays can be cached by it


@dataclass(frozen=True)
class Matches:
    """The verified matches of a database, in a form that can be sent to other processes: the camera of each sensor, and
    the sensor (N,) of each image; of a pair at most ``most`` matches are read, spread evenly."""

    database: str
    cameras: tuple[Camera, ...]
    sensor: np.ndarray
    most: int

    @staticmethod
    def of(database: Path, scene: Scene, most: int) -> Matches:
        """Those of a scene. Raises InputError for a sensor without a camera."""
        cameras = []
        for k, sensor in enumerate(scene.all_sensors):
            if sensor.camera is None:
                raise InputError(f"sensor {k} has no camera: no image of it was found, remove it from the rig")
            said = camera_to_dict(sensor.camera) or {}
            cameras.append(tuple(sorted((n, tuple(v) if isinstance(v, list) else v) for n, v in said.items())))
        sensor = np.asarray(scene.sensor_key)
        return Matches(database=str(database), cameras=tuple(cameras), sensor=sensor, most=most)

    def rays(self, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Unit rays (K, 3), (K, 3) of the matches of images i and j in the frames of their sensors."""
        matches = _connection(self.database).verified_of(i + 1, j + 1)
        if len(matches) > self.most:
            matches = matches[np.linspace(0, len(matches) - 1, self.most).astype(int)]
        rays = (_rays(self.database, k, self.cameras[self.sensor[k]]) for k in (i, j))
        first, second = (own[matches[:, side]] for side, own in enumerate(rays))
        return first, second

    def focal_px(self) -> float:
        """Mean focal length."""
        return float(np.mean([_camera(c).mean_focal_length() for c in self.cameras]))


def _camera(camera: Camera) -> pycolmap.Camera:
    made = camera_from_dict(dict(camera))
    assert made is not None
    return made


@cached_by_file(maxsize=2)
def _connection(database: str) -> Rows:
    return Rows(Path(database), any_thread=True)


@cached_by_file(maxsize=_CACHED_IMAGES)
def _rays(database: str, image: int, camera: Camera) -> np.ndarray:
    """(K, 3) unit rays of an image's key points in the sensor frame."""
    points = _connection(database).keypoints_of(image + 1)
    return np.nan_to_num(pixel_rays(_camera(camera), points)) if len(points) else np.zeros((0, 3))


def forget() -> None:
    """Close the database and drop cached rays of this process."""
    _connection.cache_clear()
    _rays.cache_clear()
