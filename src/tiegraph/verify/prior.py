"""Matches against a model of the survey that is known to be roughly right: that of the previews.

A rough model says more than loops of rotations: a wall that repeats along the way of travel gives false matches with
the right rotation and on the right epipolar lines, but at impossible distances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.verify.bearings import Calibration, load

STEPS = 24  # distances between the nearest and the farthest at which a ray is followed
MARGIN = 2.0  # distances outside those of the image's model points by this factor are still possible
TOLERANCE_DEG = 1.0  # preview key points are good to 0.2 deg, their model's rotations to 0.15 deg (canal)
# Share of a pair's matches that must agree with the model. On ``canal`` (chosen there) it keeps 99.1 % of the pairs
# most of whose matches are true and 4 of 217 of which hardly any is; on ``canal_demo`` 98.6 % and 0 of 4.
MIN_SHARE = 0.25
MAX_REFUSED = 0.2  # of the judged pairs: a model that contradicts more of them is wrong itself


@dataclass(frozen=True)
class Prior:
    """A rough model: cam_from_world (N, 4, 4), NaN = not there or not trusted; reach (N, 2): nearest and farthest
    points each image sees, same units."""

    cam_from_world: np.ndarray
    reach: np.ndarray

    def known(self) -> np.ndarray:
        """(N,) bool: images it can judge."""
        return np.isfinite(self.cam_from_world).all(axis=(1, 2)) & np.isfinite(self.reach).all(axis=1)


def agreement(item: tuple[int, int], database: str, calibration: Calibration, prior: Prior) -> float:
    """Share of the verified matches of an image pair (i, j) that a surface within reach explains; NaN without any.

    ``calibration`` with units that are images (rays in the sensor's own frame).
    """
    i, j = item
    rays = load((i, j, ((i, j),)), database, calibration)
    if not len(rays.pair):
        return float("nan")
    j_from_i = prior.cam_from_world[j] @ transforms.invert(prior.cam_from_world[i])
    off = off_course_deg(rays.ray_m, rays.ray_n, j_from_i, prior.reach[i])
    back = off_course_deg(rays.ray_n, rays.ray_m, transforms.invert(j_from_i), prior.reach[j])
    return float(np.mean(np.maximum(off, back) <= TOLERANCE_DEG))


def off_course_deg(a: np.ndarray, b: np.ndarray, b_from_a: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """(M,) least angle in degrees between rays b (M, 3) and where the points on rays a (M, 3), at all distances within
    ``reach`` (2,) times MARGIN, would be seen."""
    near, far = reach[0] / MARGIN, reach[1] * MARGIN
    distance = np.geomspace(near, far, STEPS)
    course = distance[:, None, None] * (a @ b_from_a[:3, :3].T) + b_from_a[:3, 3]  # (STEPS, M, 3)
    course /= np.maximum(np.linalg.norm(course, axis=2, keepdims=True), 1e-12)
    along = np.diff(course, axis=0)
    share = np.sum((b - course[:-1]) * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-18)
    nearest = course[:-1] + np.clip(share, 0, 1)[..., None] * along
    nearest /= np.linalg.norm(nearest, axis=2, keepdims=True)
    cosine = np.max(np.sum(nearest * b, axis=2), axis=0)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))
