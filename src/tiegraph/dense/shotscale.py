"""The unit of a model by the depth maps of shots (paper 004, section 4): a calibrated rig gives a scaled cloud of each
station, so that one camera will do for the poses; its model has no scale, but its points lie on the surface of the
clouds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.dense.tuning import ShotScaleTuning
from tiegraph.geometry import transforms
from tiegraph.scene.results import DepthMap


@dataclass(frozen=True)
class ShotScale:
    """Metres in a unit of the model; its relative sigma by how the shots scatter; points and shots that tell."""

    metres_per_unit: float
    sigma: float
    points: int
    shots: int


def points_scale(
    rays: np.ndarray, rig_from_camera: np.ndarray, depth: DepthMap, start: float, tuning: ShotScaleTuning
) -> np.ndarray:
    """Metres per unit (P,) by which each point seen by a camera of the rig falls onto a depth map, NaN = by none.

    ``rays`` (P, 3): points in that camera's frame, model units; ``depth.cam_from_world``: from the rig's frame, metres.
    A point runs along its ray with the scale: in steps, its scale is the one that gives it the depth read where it
    falls. On a surface without jumps each step shrinks the error by the parallax times the slope.
    """
    camera = depth.cam_from_world @ rig_from_camera
    along, origin = rays @ camera[:3, :3].T, camera[:3, 3]
    scale, step = np.full(len(rays), start), np.full(len(rays), np.inf)
    height, width = depth.depth_m.shape
    for _ in range(tuning.rounds):
        at = scale[:, None] * along + origin
        with np.errstate(divide="ignore", invalid="ignore"):
            place = at[:, :2] / at[:, 2:] * depth.K[[0, 1], [0, 1]] + depth.K[:2, 2]
            inside = (at[:, 2] > 0) & (place >= 0).all(axis=1) & (place < (width, height)).all(axis=1)
            column, row = np.where(inside[:, None], place, 0).astype(int).T
            read = np.where(inside, depth.depth_m[row, column], np.nan)
            found = (read - origin[2]) / along[:, 2]
        step = np.abs(found / scale - 1)
        scale = np.where(np.isfinite(found) & (found > 0), found, np.nan)
    return np.where(step < tuning.settled, scale, np.nan)


def shot_scale(by_shot: Sequence[np.ndarray], tuning: ShotScaleTuning) -> ShotScale | None:
    """The median over shots of the median of their points (P,); None where too few tell."""
    good = [s[np.isfinite(s)] for s in by_shot]
    medians = np.array([np.median(s) for s in good if len(s) >= tuning.least_points])
    if not len(medians):
        return None
    scale = float(np.median(medians))
    scatter = 1.4826 * float(np.median(np.abs(medians / scale - 1)))
    return ShotScale(scale, scatter / np.sqrt(len(medians)), sum(map(len, good)), len(medians))


def first_guess(depth: DepthMap, rays: np.ndarray) -> float:
    """Metres per unit to begin with: depths of the map over those of the points, medians; NaN without either."""
    known = depth.depth_m[np.isfinite(depth.depth_m)]
    return float(np.median(known) / np.median(rays[:, 2])) if len(known) and len(rays) else float("nan")


def in_camera(cam_from_world: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (P, 3) of the model in the frame of a camera, those before it."""
    local = transforms.apply(cam_from_world, points)
    return local[local[:, 2] > 0]
