"""What a pixel of a camera looks at: the only place where COLMAP's cameras are asked for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tiegraph.geometry.rays import unit_rays

if TYPE_CHECKING:
    import pycolmap


def on_plane(camera: pycolmap.Camera, xy: np.ndarray) -> np.ndarray:
    """(K, 2) places on the plane z = 1 of the camera's frame of pixels (K, 2); NaN where its lens has no inverse."""
    return np.asarray(camera.cam_from_img(np.asarray(xy, float)), float)


def pixel_rays(camera: pycolmap.Camera, xy: np.ndarray) -> np.ndarray:
    """(K, 3) unit rays of pixels (K, 2) in the camera's frame; NaN where its lens has no inverse."""
    return unit_rays(on_plane(camera, xy))


def rays_or_axis(camera: pycolmap.Camera, xy: np.ndarray) -> np.ndarray:
    """As ``pixel_rays``, with the optical axis where the lens has no inverse."""
    return unit_rays(np.nan_to_num(on_plane(camera, xy)))
