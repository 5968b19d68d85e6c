"""Pixels of marks: in the user's image, in the prepared one, and in copies in which marks are made.

Copies are smaller or larger, or rotated by EXIF although the survey's images are not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.scene.rig import Sensor, Source, on_plane

EDGE_PX = 1.0  # tolerance of a mark outside its image: programs count from the pixel's centre or corner


@dataclass(frozen=True)
class Copy:
    """The images in which marks were made: ``size`` times as large as the user's, and ``turned`` if EXIF rotates the
    survey's (or not, if the survey's are left as the sensor has them)."""

    size: float = 1.0
    turned: bool = False

    def pixel(self, xy: tuple[float, float], sensor: Sensor, orientation: int) -> tuple[float, float]:
        """Pixel in the image of the sensor, upright if that is, of a mark in the copy."""
        x, y = xy[0] / self.size, xy[1] / self.size
        camera, source = file_camera(sensor), sensor.source or Source()
        if not self.turned or camera is None:
            return x, y
        size = (camera.height, camera.width) if orientation >= 5 else (camera.width, camera.height)  # of the copy
        return _turned((x, y), size, orientation if source.upright else {6: 8, 8: 6}.get(orientation, orientation))

    def like(self, other: "Copy") -> bool:
        """Whether it has nearly the same size and the same orientation."""
        return self.turned == other.turned and 0.9 < self.size / other.size < 1 / 0.9

    def __str__(self) -> str:
        return f"{self.size:.4g} times as large" + (
            ", with another EXIF orientation than the survey's" if self.turned else ""
        )


AS_IS = Copy()


def file_camera(sensor: Sensor) -> pycolmap.Camera | None:
    """The camera of the user's image; None if its size is unknown."""
    source = sensor.source or Source()
    return None if source.rendered else source.camera or sensor.camera


def in_file(xy: Sequence[float], sensor: Sensor) -> bool:
    """Whether a pixel is in the user's image of a sensor."""
    camera = file_camera(sensor)
    return camera is None or within(xy, camera)


def lies_in(xy: Sequence[float], sensor: Sensor) -> bool:
    """Whether a pixel is in the prepared image of a sensor."""
    return sensor.camera is None or within(xy, sensor.camera)


def within(xy: Sequence[float], camera: pycolmap.Camera) -> bool:
    """Whether a pixel is in the image of a camera, or at its edge."""
    return -EDGE_PX <= xy[0] <= camera.width + EDGE_PX and -EDGE_PX <= xy[1] <= camera.height + EDGE_PX


def prepared_pixel(xy: tuple[float, float], sensor: Sensor) -> tuple[float, float]:
    """Pixel in the prepared image of a mark in the user's upright image: cropped and undistorted like it."""
    return _moved(xy, sensor, 1)


def source_pixel(xy: tuple[float, float], sensor: Sensor) -> tuple[float, float]:
    """Pixel in the user's upright image of a pixel of the prepared one: the inverse of ``prepared_pixel``."""
    return _moved(xy, sensor, -1)


def _moved(xy: tuple[float, float], sensor: Sensor, way: int) -> tuple[float, float]:
    """From the user's image into the prepared one, or back (``way`` -1)."""
    source = sensor.source or Source()
    if source.view is not None:  # a mark of a view
        return xy
    user, own = source.camera, sensor.camera
    if user is not None and own is not None and not user.is_undistorted() and own.is_undistorted():
        one, other = (user, own)[::way]
        place = on_plane(one, np.array([xy]))[0]
        moved = other.img_from_cam(np.append(place, 1.0)) if np.isfinite(place).all() else None
        if moved is not None:
            return float(moved[0]), float(moved[1])
    left, top, _, _ = source.crop_px
    return xy[0] - way * left, xy[1] - way * top


def _turned(xy: tuple[float, float], size: tuple[int, int], orientation: int) -> tuple[float, float]:
    """Pixel in an image made upright by EXIF's orientation, of one in the image before, of ``size``."""
    x = size[0] - xy[0] if orientation in (2, 3, 7, 8) else xy[0]
    y = size[1] - xy[1] if orientation in (3, 4, 6, 7) else xy[1]
    return (y, x) if orientation >= 5 else (x, y)
