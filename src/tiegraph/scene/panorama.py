"""Equirectangular panoramas: their recognition, their part of the sphere, and their pinhole views.

The tags are those of Google's photo sphere XMP metadata (namespace GPano).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import pycolmap
from PIL import Image

from tiegraph.scene.table import number
from tiegraph.scene.tuning import PanoramaTuning
from tiegraph.scene.xmp import xmp_text, xmp_value

_EQUIRECTANGULAR = "equirectangular"
_TAGS = ("FullPanoWidthPixels", "FullPanoHeightPixels", "CroppedAreaImageWidthPixels", "CroppedAreaImageHeightPixels",
         "CroppedAreaLeftPixels", "CroppedAreaTopPixels")  # fmt: skip
_ROUNDED_PX = 2  # tolerance between sizes in tags
# Software fills missing parts with black, with JPEG's noise, in all pixels of a row but this share.
_BLACK_GREY, _LIT = 24, 0.01
_LOOK_PX, _BESIDE = 512, 9  # width at which poles and seam are looked at, columns beside the seam that tell its steps


Box = tuple[int, int, int, int]
"""Of a file's pixels: left, top, right, bottom."""


@dataclass(frozen=True)
class Sphere:
    """The part of a sphere in a file: the sphere is ``width`` pixels around and half as high; the first column and
    row of the file there, and the part of the file that is a picture. ``sure``: by the file's
    tags; else it is only twice as wide as high."""

    width: int
    left: int
    top: int
    sure: bool
    lit: Box = (0, 0, 0, 0)

    def holds(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether places on the whole sphere, from the centre of its first pixel, are in the picture."""
        left, top, right, bottom = self.lit
        column, row = (np.floor(x + 0.5) - self.left) % self.width, np.floor(y + 0.5) - self.top
        return (column >= left) & (column < right) & (row >= top) & (row < bottom)

    @property
    def part(self) -> bool:
        """Whether part of the sphere is not in the picture."""
        left, top, right, bottom = self.lit
        return right - left < self.width or bottom - top < self.width // 2

    def unfolded(self, pixels: np.ndarray) -> np.ndarray:
        """The whole sphere (width / 2, width[, 3 | 4]) u1 of a file's pixels; of a partial one RGBA, the missing part
        with the nearest pixels and alpha 0."""
        if not self.part:
            return pixels
        if pixels.ndim == 2:
            pixels = np.stack([pixels] * 3, axis=2)
        left, top, right, bottom = self.lit
        rows = np.arange(self.width // 2)
        across = (np.arange(self.width) - self.left) % self.width
        nearest = np.where(across > (left + right + self.width) / 2, left, np.clip(across, left, right - 1))
        filled = pixels[np.clip(rows - self.top, top, bottom - 1)][:, nearest]
        alpha = np.where(self.holds(np.arange(self.width), rows[:, None]), 255, 0).astype(np.uint8)
        return np.dstack([filled[..., :3], np.minimum(alpha, filled[..., 3]) if filled.shape[2] == 4 else alpha])


def sphere_of(image: Image.Image | None, size: tuple[int, int], pixels: Callable[[], np.ndarray]) -> Sphere | None:
    """The part of the sphere of a file, its header, its width and height and its pixels (H, W[, C]) u1: by its tags,
    else all around if it is twice as wide as high; None if neither. Black from a pole or the seam on is no picture."""
    width, height = size
    text = "" if image is None else xmp_text(image)
    found = _by_tags(text, width, height)
    if found is None and width == 2 * height:
        found = Sphere(width=width, left=0, top=0, sure=_EQUIRECTANGULAR in text and not has_crop(text))
    return found and replace(found, lit=_lit(pixels()))


def has_crop(xmp: str) -> bool:
    """Whether tags give the part of a sphere."""
    return _TAGS[0] in xmp


def _by_tags(text: str, width: int, height: int) -> Sphere | None:
    """None without tags, or if they contradict each other or the size of the file."""
    if xmp_value(text, "ProjectionType", "GPano") != _EQUIRECTANGULAR:
        return None
    full_width, full_height, wide, high, left, top = (number(xmp_value(text, tag, "GPano")) for tag in _TAGS)
    scale = width / wide if wide > 0 else float("nan")  # of a file that was made smaller since
    fits = abs(full_width - 2 * full_height) <= _ROUNDED_PX and abs(scale * high - height) <= _ROUNDED_PX
    inside = wide <= full_width + _ROUNDED_PX and 0 <= top <= full_height - high + _ROUNDED_PX
    if not (fits and inside and np.isfinite(left)):
        return None
    around = 2 * round(scale * full_width / 2)
    return Sphere(width=around, left=round(scale * left) % around, top=round(scale * top), sure=True)


def _lit(pixels: np.ndarray) -> Box:
    bright = (pixels[..., :3].max(axis=2) if pixels.ndim == 3 else pixels) > _BLACK_GREY
    columns, rows = (np.flatnonzero(bright.mean(axis=axis) > _LIT) for axis in (0, 1))
    if not (len(columns) and len(rows)):
        return 0, 0, pixels.shape[1], pixels.shape[0]
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def is_equirectangular(image: Image.Image, tuning: PanoramaTuning) -> bool:
    """Whether a decoded image of 8 bits is a full panorama, by its poles and its seam.

    The first and the last row of an equirectangular panorama are one point each, and its left border continues at the
    right one.
    """
    if image.width != 2 * image.height or image.width < tuning.min_width_px:
        return False
    size = _LOOK_PX, _LOOK_PX // 2
    grey = np.asarray(image.convert("L").resize(size, Image.Resampling.BOX), float)
    poles = max(grey[0].std(), grey[-1].std())
    borders = grey[:, :_BESIDE], grey[:, -_BESIDE:]
    beside = np.abs(np.diff(borders[0], axis=1)).mean() + np.abs(np.diff(borders[1], axis=1)).mean()
    seam = np.abs(grey[:, 0] - grey[:, -1]).mean()
    step = max(beside / 2, tuning.least_step_grey)
    return bool(poles < tuning.pole_grey and grey.std() > tuning.pole_grey and seam < tuning.seam * step)


def render_view(panorama: np.ndarray, camera: pycolmap.Camera, view_from_panorama: np.ndarray) -> np.ndarray:
    """Pixels (H, W[, 3 | 4]) of a pinhole view of a panorama (h, 2 h[, 3 | 4]), rotated by (3, 3). Alpha is 0
    wherever a transparent pixel contributes.

    The middle of the panorama is straight ahead (z), its upper border the zenith (-y).
    """
    x, y = _map(_key(camera, view_from_panorama), panorama.shape[1], panorama.shape[0])
    out = cv2.remap(panorama, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)
    if out.shape[2:] == (4,):
        out[..., 3] = np.where(out[..., 3] == 255, 255, 0)
    return out


def seen(sphere: Sphere, camera: pycolmap.Camera, view_from_panorama: np.ndarray) -> float:
    """Share of a view within a picture, by 65 x 65 of its pixels."""
    small = pycolmap.Camera(camera.todict())
    small.rescale(_LOOK, _LOOK)
    return float(sphere.holds(*_map(_key(small, view_from_panorama), sphere.width, sphere.width // 2)).mean())


_LOOK = 65  # a degree and a half


def _key(camera: pycolmap.Camera, view_from_panorama: np.ndarray) -> tuple:
    intrinsics = tuple(camera.calibration_matrix()[[0, 1, 0, 1], [0, 1, 2, 2]])
    return tuple(np.ravel(view_from_panorama)), intrinsics, (camera.width, camera.height)


@lru_cache(maxsize=6)  # the views of one panorama are made one after another
def _map(key: tuple, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    rotation, (fx, fy, cx, cy), (columns, rows) = key
    u = (np.arange(columns) + 0.5 - cx) / fx
    v = (np.arange(rows) + 0.5 - cy) / fy
    rays = np.stack([*np.meshgrid(u, v), np.ones((rows, columns))], axis=-1) @ np.reshape(rotation, (3, 3))
    longitude = np.arctan2(rays[..., 0], rays[..., 2])
    latitude = np.arctan2(-rays[..., 1], np.hypot(rays[..., 0], rays[..., 2]))
    x = (longitude / (2 * np.pi) + 0.5) * width - 0.5  # OpenCV counts from the centre of the first pixel
    y = (0.5 - latitude / np.pi) * height - 0.5
    return x.astype(np.float32), y.astype(np.float32)
