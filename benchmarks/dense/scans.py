"""True depths from laser scans: the points that an image can see, at their pixels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from tiegraph.dense.plan import ImagePlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.undistort import pinhole_of
from tiegraph.geometry.align import Similarity
from tiegraph.geometry.transforms import apply

_HIDDEN_PX = 21  # the laser stands elsewhere than the camera: a point is hidden by one much nearer within this window
_HIDDEN = 1.05
_MESH = 1.2  # and where others lie this much further within the window, it may be on a mesh that images see through
_STATIC_M = 0.12  # a point further than this from the cloud of what stands still is on something that may move


def scan_depth(plan: ImagePlan, xyz: np.ndarray, counted: np.ndarray, settings: DenseSettings) -> np.ndarray:
    """(H, W) f4 depth at the pixels of the undistorted image that a counted (N,) bool point (N, 3), in the model's
    world, falls on; NaN elsewhere, where any point near by would hide it, and where the surface
    is not closed."""
    K, (width, height) = pinhole_of(plan.view.camera, settings)
    local = apply(plan.view.cam_from_world, xyz)
    counted, local = counted[local[:, 2] > 0], local[local[:, 2] > 0]
    at = local @ K.T
    column, row = (np.floor(at[:, k] / at[:, 2]).astype(int) for k in (0, 1))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    inverse, any_inverse = np.zeros((2, height, width), np.float32)
    for image, points in ((inverse, inside & counted), (any_inverse, inside)):
        np.maximum.at(image, (row[points], column[points]), (1 / local[points, 2]).astype(np.float32))
    nearest = cv2.dilate(any_inverse, np.ones((_HIDDEN_PX, _HIDDEN_PX)))
    furthest = cv2.erode(np.where(any_inverse > 0, any_inverse, np.float32(1e6)), np.ones((_HIDDEN_PX, _HIDDEN_PX)))
    seen = (inverse > 0) & (nearest < _HIDDEN * inverse) & (furthest * _MESH > inverse)
    return np.where(seen, 1 / np.where(seen, inverse, 1), np.nan).astype(np.float32)


class PandaScans:
    """PandaSet's scans, one a frame, without what moves; depths of an image by its name and the model's alignment."""

    def __init__(self, folder: Path, static: np.ndarray, world_from_model: Similarity) -> None:
        self.folder, self.static, self.fit = folder, cKDTree(static), world_from_model

    def __call__(self, plan: ImagePlan, settings: DenseSettings) -> np.ndarray | None:
        """True depth of an image, None where its frame has no scan."""
        path = self.folder / f"{Path(plan.view.name).stem}.npz"
        if not path.exists():
            return None
        with np.load(path) as file:
            xyz = file["xyz_cm"].astype(float) / 100
        still = self.static.query(xyz, distance_upper_bound=_STATIC_M)[0] < _STATIC_M
        model = (xyz - self.fit.translation) @ self.fit.rotation / self.fit.scale
        return scan_depth(plan, model, still, settings)
