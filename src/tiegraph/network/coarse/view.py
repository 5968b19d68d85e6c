"""A camera as visibility needs it: projection in shares of the image and a cone round the field of view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry.rays import unit_rays
from tiegraph.scene.rays import on_plane


@dataclass(frozen=True)
class View:
    """A camera: projection to image shares 0..1 and the half angle of a cone round it."""

    camera: pycolmap.Camera | None
    half: float  # radians, to the corners
    slope: float  # tangent of half the field of view across and down that is taken where there is no camera

    @staticmethod
    def of(camera: pycolmap.Camera | None, guessed_view_deg: float) -> View:
        slope = float(np.tan(np.radians(guessed_view_deg / 2)))
        if camera is None:
            return View(None, float(np.arctan(np.sqrt(2) * slope)), slope)
        rim = np.array([(x, y) for x in (0, 0.5, 1) for y in (0, 0.5, 1)])
        rays = View(camera, 0.0, slope).rays(rim)
        half = np.nanmax(np.arccos(np.clip(rays[:, 2], -1, 1)), initial=0.0)
        return View(camera, float(half) if half > 0 else np.radians(89), slope)

    def rays(self, shares: np.ndarray) -> np.ndarray:
        """(K, 3) unit rays of places given in shares of the image (K, 2); NaN where the model has no inverse."""
        if self.camera is None:
            xy = (2 * shares - 1) * self.slope
        else:
            xy = on_plane(self.camera, shares * (self.camera.width, self.camera.height))
        return unit_rays(xy)

    def project(self, local: np.ndarray, slack: float = 0.0) -> np.ndarray:
        """(K, 2) shares of the image 0..1, NaN = not in it, of points (K, 3) in the camera frame with z > 0.

        Points up to ``slack`` radians outside count as on the rim.
        """
        if self.camera is None:
            shares = (local[:, :2] / local[:, 2:] / self.slope + 1) / 2
        else:
            shares = np.asarray(self.camera.img_from_cam(local), float) / (self.camera.width, self.camera.height)
        with np.errstate(invalid="ignore"):
            rim = slack / max(self.half, 1e-3)
            inside = ((shares >= -rim) & (shares < 1 + rim)).all(axis=1)
        return np.where(inside[:, None], np.clip(shares, 0, 1 - 1e-9), np.nan)
