"""The round trip of paper 000, eq. 4-6: rounding to the pixel is all that is left."""

import numpy as np
import pytest

from tiegraph.evaluate.backprojection import View, backproject, backprojection_rmse, project
from tiegraph.evaluate.tuning import Tuning
from tiegraph.geometry import transforms

K = np.array([[500.0, 0, 320], [0, 510.0, 240], [0, 0, 1]])
TRIED = Tuning().points_tried


def looking(angle_deg: float, at: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    a = np.radians(angle_deg)
    rotation = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return transforms.invert(transforms.rigid(rotation, np.array(at, float)))


def wall(depth: float, points: int = 20000) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(-20, 20, points), rng.uniform(-8, 8, points), np.full(points, depth)])


@pytest.mark.parametrize("depth", [5.0, 20.0])
def test_error_is_the_rounding_alone(depth: float) -> None:
    points = wall(depth, 100)
    assert np.allclose(backproject(project(points, K), points[:, 2], K), points)
    views = [View("a.jpg", K, looking(0), 640, 480), View("b.jpg", K, looking(8, (1, 0, 0)), 640, 480)]
    result = backprojection_rmse(wall(depth), views, TRIED)
    expected = depth * np.sqrt(2 / 12) / 505
    assert 0.95 * expected < result.rmse_m < 1.05 * expected
    assert 0.95 < result.rmse_m / result.rounding_m < 1.05
    alone = [backprojection_rmse(wall(depth), [view], TRIED) for view in views]
    assert all(0.9 * expected < one.rmse_m < 1.2 * expected for one in alone)
    assert result.points == sum(one.points for one in alone) > 1000


def test_a_wrong_pose_does_not_show_and_nothing_seen_is_nan_not_zero() -> None:
    """The reason the figure proves nothing: a view a metre off has the same error."""
    right = backprojection_rmse(wall(20.0), [View("a.jpg", K, looking(0), 640, 480)], TRIED)
    wrong = backprojection_rmse(wall(20.0), [View("a.jpg", K, looking(0, (1, 0, 0)), 640, 480)], TRIED)
    assert abs(wrong.rmse_m / right.rmse_m - 1) < 0.05
    behind = backprojection_rmse(wall(10.0, 100), [View("behind.jpg", K, looking(180), 640, 480)], TRIED)
    assert behind.points == 0 and np.isnan(behind.rmse_m)
