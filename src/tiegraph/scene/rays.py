"""What a pixel of a camera looks at: the only place where COLMAP's cameras are asked for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tiegraph.geometry.rays import unit_rays

if TYPE_CHECKING:
    import pycolmap


def on_plane(camera: pycolmap.Camera, xy: np.ndarray) -> np.ndarray:
    """(K, 2) places on the plane z = 1 of the camera's frame of pixels (K, 2); NaN where its lens has no inverse.

    Of pixels 90 degrees off the axis of a fisheye lens and more, which have none, COLMAP gives places far inside.
    """
    xy = np.asarray(xy, float)
    plane = np.asarray(camera.cam_from_img(xy), float)
    if "FISHEYE" in camera.model.name and len(plane):
        back = np.asarray(camera.img_from_cam(np.column_stack([plane, np.ones(len(plane))])), float)
        plane[~(np.abs(back - xy).max(axis=1) < _SAME_PX)] = np.nan
    return plane


_SAME_PX = 0.5  # between a pixel and the way there and back


def pixel_rays(camera: pycolmap.Camera, xy: np.ndarray) -> np.ndarray:
    """(K, 3) unit rays of pixels (K, 2) in the camera's frame; NaN where its lens has no inverse."""
    return unit_rays(on_plane(camera, xy))


def rays_or_axis(camera: pycolmap.Camera, xy: np.ndarray) -> np.ndarray:
    """As ``pixel_rays``, with the optical axis where the lens has no inverse."""
    return unit_rays(np.nan_to_num(on_plane(camera, xy)))
