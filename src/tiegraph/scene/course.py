"""Matches against the poses of a rough model: where along its ray a point may be, and where another image sees it.

A wall that repeats along the path gives false matches with the right rotation and on the right epipolar lines, but at
impossible distances or behind a camera.
"""

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.scene.tuning import CourseTuning


def off_course_deg(
    a: np.ndarray, b: np.ndarray, b_from_a: np.ndarray, reach: tuple[np.ndarray, np.ndarray], tuning: CourseTuning
) -> np.ndarray:
    """(M,) least angle in degrees between rays b (M, 3) and where the points on rays a (M, 3) would be seen at all
    distances within reach of image a, or the same from b to a: the larger. ``reach``: nearest and farthest points (2,)
    that a and that b see, to which a margin is added."""
    there = _one_way_deg(a, b, b_from_a, reach[0], tuning)
    return np.maximum(there, _one_way_deg(b, a, transforms.invert(b_from_a), reach[1], tuning))


def _one_way_deg(
    a: np.ndarray, b: np.ndarray, b_from_a: np.ndarray, reach: np.ndarray, tuning: CourseTuning
) -> np.ndarray:
    near, far = reach[0] / tuning.margin, reach[1] * tuning.margin
    distance = np.geomspace(near, far, tuning.steps)
    course = distance[:, None, None] * (a @ b_from_a[:3, :3].T) + b_from_a[:3, 3]  # (steps, M, 3)
    course /= np.maximum(np.linalg.norm(course, axis=2, keepdims=True), 1e-12)
    along = np.diff(course, axis=0)
    share = np.sum((b - course[:-1]) * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-18)
    nearest = course[:-1] + np.clip(share, 0, 1)[..., None] * along
    nearest /= np.linalg.norm(nearest, axis=2, keepdims=True)
    cosine = np.max(np.sum(nearest * b, axis=2), axis=0)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))
