"""Equirectangular panoramas as pixels: how one is told from a photograph, and the pinhole views of it."""

from functools import lru_cache

import cv2
import numpy as np
import pycolmap
from PIL import Image

from tiegraph.scene.tuning import PanoramaTuning


def is_equirectangular(image: Image.Image, tuning: PanoramaTuning) -> bool:
    """Whether a decoded image is a full panorama: by its XMP (GPano), else by its poles and its seam.

    The first and the last row of an equirectangular panorama are one point each, and its left border goes on at the
    right one.
    """
    if image.width != 2 * image.height or image.width < tuning.min_width_px:
        return False
    xmp = image.info.get("xmp", b"")
    if b"equirectangular" in (xmp if isinstance(xmp, bytes) else str(xmp).encode()):
        return True
    size = tuning.look_px, tuning.look_px // 2
    grey = np.asarray(image.convert("L").resize(size, Image.Resampling.BOX), float)
    poles = max(grey[0].std(), grey[-1].std())
    borders = grey[:, : tuning.beside], grey[:, -tuning.beside :]
    beside = np.abs(np.diff(borders[0], axis=1)).mean() + np.abs(np.diff(borders[1], axis=1)).mean()
    seam = np.abs(grey[:, 0] - grey[:, -1]).mean()
    step = max(beside / 2, tuning.least_step_grey)
    return bool(poles < tuning.pole_grey and grey.std() > tuning.pole_grey and seam < tuning.seam * step)


def render_view(panorama: np.ndarray, camera: pycolmap.Camera, view_from_panorama: np.ndarray) -> np.ndarray:
    """Pixels (H, W[, 3]) of a pinhole view of a panorama (h, 2 h[, 3]), turned by a rotation (3, 3).

    The middle of the panorama is straight ahead (z), its upper border the zenith (-y).
    """
    fx, fy, cx, cy = camera.calibration_matrix()[[0, 1, 0, 1], [0, 1, 2, 2]]
    key = (tuple(np.ravel(view_from_panorama)), (fx, fy, cx, cy), (camera.width, camera.height))
    x, y = _map(key, panorama.shape[1], panorama.shape[0])
    return cv2.remap(panorama, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)


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
