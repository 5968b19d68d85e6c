"""Matches against a rough model: what a surface within reach explains, and what a repeated wall does not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.verify.prior import TOLERANCE_DEG, off_course_deg


def two_views(shift_m: float = 0.0, base_m: float = 12.0) -> tuple[np.ndarray, ...]:
    """Rays of wall points 8 m to the side, seen from two places along the wall; with ``shift_m`` the second camera sees
    a copy of them so much further on."""
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(2, 10, 200), rng.uniform(-3, 3, 200), np.full(200, 8.0)], axis=1)
    turn = Rotation.from_euler("y", 5, degrees=True).as_matrix()
    b_from_a = transforms.rigid(turn, -turn @ np.array([base_m, 0.0, 0.0]))
    seen = transforms.apply(b_from_a, points + [shift_m, 0, 0])
    return tuple(p / np.linalg.norm(p, axis=1, keepdims=True) for p in (points, seen)) + (b_from_a,)


REACH = np.array([6.0, 16.0])


def test_true_matches_are_on_course() -> None:
    a, b, pose = two_views()
    assert off_course_deg(a, b, pose, REACH).max() < 0.2


def test_a_rough_pose_is_forgiven() -> None:
    a, b, pose = two_views()
    rough = transforms.rigid(Rotation.from_euler("xyz", (0.3, 0.3, 0.3), degrees=True).as_matrix(), np.full(3, 0.05))
    assert np.mean(off_course_deg(a, b, rough @ pose, REACH) <= TOLERANCE_DEG) > 0.9


@pytest.mark.parametrize("shift_m", [12.0, 15.0])
def test_a_repeated_wall_is_off_course_though_on_its_epipolar_line(shift_m: float) -> None:
    a, b, pose = two_views(shift_m)
    assert np.mean(off_course_deg(a, b, pose, REACH) <= TOLERANCE_DEG) < 0.1
    # With no limits of distance the same matches lie on their epipolar lines.
    t = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    plane = np.cross(t, a @ pose[:3, :3].T)
    sine = np.abs(np.sum(plane * b, axis=1)) / np.linalg.norm(plane, axis=1)
    assert np.degrees(np.arcsin(sine)).max() < 0.1


def test_points_behind_are_off_course() -> None:
    a, b, pose = two_views()
    assert off_course_deg(a, -b, pose, REACH).min() > 90
