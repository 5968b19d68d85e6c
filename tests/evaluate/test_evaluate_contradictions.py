"""References that differ from the model by more than predicted: said, and what would explain it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clouds_world import tiled
from tiegraph.evaluate.accuracy import Predicted, cloud_figure, pose_figures
from tiegraph.evaluate.clouds.nearest import cloud_to_cloud, criteria_of
from tiegraph.evaluate.survey import against_cloud, against_poses
from tiegraph.evaluate.trajectory import PoseMatch, evaluate_trajectory
from tiegraph.evaluate.tuning import Tuning
from tiegraph.geometry import transforms
from tiegraph.scene.results import Figure

SIGMA = Predicted(inside_m=0.002, scale=0.0005, spread_m=12.2, placed_m=0.05, point_m=0.01)
TUNING = Tuning()


def way(seed: int = 0) -> np.ndarray:
    """(60, 3) a bent way with hills."""
    s = np.linspace(0, 40, 60)
    return np.stack([s, 5 * np.sin(s / 6), 2 * np.cos(s / 4)], axis=1)


def judged(
    reference: np.ndarray, estimate: np.ndarray | None = None, predicted: Predicted = SIGMA, same=False, registered=1.0
) -> list:
    """What is said of reference positions of the way; the model stands turned and moved elsewhere."""
    est = way() if estimate is None else estimate
    est = est + 0.002 / np.sqrt(3) * np.random.default_rng(1).standard_normal(est.shape)
    if not same:
        est = est @ Rotation.from_rotvec([0.3, 0.2, 1.0]).as_matrix().T + [5, -3, 2]
    turn = np.tile(np.eye(3), (60, 1, 1))
    match = PoseMatch(transforms.rigid(turn, est), transforms.rigid(turn, reference), np.zeros(60, int), np.arange(60))
    found = evaluate_trajectory(match, (10.0,), TUNING.trajectory, same_frame=same)
    figures = pose_figures(match, found, predicted, TUNING.trajectory)
    return against_poses(match, figures, predicted.metric, TUNING.judge, 0.5, registered)


def test_a_reference_that_agrees_is_no_contradiction() -> None:
    assert judged(way()) == []
    assert judged(way() + 0.002 * np.random.default_rng(2).standard_normal((60, 3))) == []
    assert judged(way() * [1, 0.001, 1], predicted=Predicted()) == []  # nothing predicted, nothing said


@pytest.mark.parametrize(
    ("reference", "why"),
    [
        (way() * [1, 0.001, 1], "y axis differs in scale, it is 0.001 times"),
        (way() * [1, 1, 3.0], "z axis differs in scale, it is 3 times"),
        (way()[:, [1, 0, 2]], "mirror image"),
        (way() * [1, 1, -1], "mirror image"),
        (way() * 1.2, "1.2 times as large"),
    ],
)
def test_what_is_wrong_with_a_reference_is_named(reference: np.ndarray, why: str) -> None:
    (text,) = judged(reference)
    assert why in text
    assert "predicted" in text and "mm" in text.split("predicted")[1] and "chance does once in 1000" in text


def test_a_torn_model_makes_no_mirror_image_of_the_reference() -> None:
    """Nor is anything named that hardly explains the error."""
    (text,) = judged(way() * [1, 1, -1], registered=0.6)
    assert "mirror" not in text and "one of the two is wrong" in text
    (text,) = judged(way() * [1, 1, -1] + 0.6 * np.random.default_rng(4).standard_normal((60, 3)))
    assert "mirror" not in text and "one of the two is wrong" in text


def test_a_lag_is_named_with_its_time() -> None:
    s = np.linspace(0, 60, 60) ** 1.0 * 2 / 3
    speed = 1 + 0.6 * np.sin(np.arange(60) / 7)
    s = np.cumsum(speed)
    there = lambda v: np.stack([v, 5 * np.sin(v / 6), 2 * np.cos(v / 4)], axis=1)  # noqa: E731
    (text,) = judged(there(np.interp(np.arange(60) - 0.4, np.arange(-1, 60), np.insert(s, 0, s[0] - 1))), there(s))
    assert "times are off by" in text and "frames (" in text


def test_a_shift_on_the_earth_is_said_apart() -> None:
    assert judged(way() + [0.03, 0.0, 0.0], same=True) == []
    (text,) = judged(way() + [0.0, 1.5, 0.0], same=True)
    assert "on the Earth" in text and "-1.50 m north" in text


def test_a_cloud_farther_than_predicted(tmp_path) -> None:
    def said(cloud: np.ndarray) -> Figure:
        clouds = tiled(cloud, wall, tmp_path)
        found = cloud_to_cloud(clouds, criteria_of(clouds, TUNING.cloud, (0.02, 0.2)), tmp_path)
        return cloud_figure(found, 3.0, SIGMA, True)

    rng = np.random.default_rng(0)
    wall = np.column_stack([rng.uniform(0, 10, 20000), np.zeros(20000), rng.uniform(0, 4, 20000)])
    near = wall[:8000] + [0.0, 0.01, 0.0] * rng.standard_normal((8000, 1))
    fits = said(near)
    assert against_cloud(fits, TUNING.judge) == [] and 0.3 < fits.ratio < 1.5
    (text,) = against_cloud(said(near + [0, 0.18, 0]), TUNING.judge)
    assert "differ by 0.18" in text or "differ by 0.17" in text
