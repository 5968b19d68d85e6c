"""Accuracy, completeness and ghosts of clouds made for it."""

import numpy as np
import pytest

from tiegraph.evaluate import cloud as comparison
from tiegraph.evaluate.cloud import cloud_to_cloud
from tiegraph.evaluate.tuning import CloudTuning
from tiegraph.geometry.align import Similarity

TUNING = CloudTuning()


def quay(points: int = 20000, seed: int = 0, length: float = 10.0) -> np.ndarray:
    """A floor and a wall, 10 m x 4 m each."""
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0, length, points), rng.uniform(0, 4, points)
    floor = np.column_stack([a, b, np.zeros(points)])
    return np.vstack([floor[::2], np.column_stack([a, np.full(points, 4.0), b])[1::2]])


def test_the_same_cloud_is_perfect() -> None:
    result = cloud_to_cloud(quay(), quay(), TUNING)
    assert result.accuracy == result.completeness == result.fscore == (1, 1, 1, 1)
    assert result.median_m < 0.01 and result.ghosts == 0 and result.judged.outside == 0


@pytest.mark.slow
def test_a_shift_shows_at_its_size() -> None:
    result = cloud_to_cloud(quay(200_000) + [0, 0.07, 0.07], quay(200_000, 1), TUNING, (0.05, 0.1, 0.2))
    assert 0.06 < result.median_m < 0.08
    assert result.accuracy[0] < 0.1 and result.accuracy[1] > 0.95
    align = Similarity(1.0, np.eye(3), np.array([0, -0.07, -0.07]))
    assert cloud_to_cloud(quay(200_000) + [0, 0.07, 0.07], quay(200_000, 1), TUNING, (0.05,), align).accuracy[0] > 0.95


def test_half_a_cloud_is_accurate_and_half_complete() -> None:
    whole = quay(100_000)
    result = cloud_to_cloud(whole[whole[:, 0] < 5], whole, TUNING, (0.05,))
    assert result.accuracy[0] == 1.0 and 0.49 < result.completeness[0] < 0.53
    assert 0.65 < result.fscore[0] < 0.70


def test_only_the_reference_near_the_cameras_counts() -> None:
    whole = quay(100_000)
    cameras = np.array([[0.0, 2.0, 1.5]])
    near = cloud_to_cloud(whole[whole[:, 0] < 5], whole, TUNING, (0.05,), None, cameras, 4.0)
    assert near.completeness[0] > 0.99 and near.judged.reference_points < 50_000 and near.criteria.range_m == 4.0
    assert "within 4 m of a registered camera" in near.criteria.meaning
    with pytest.raises(ValueError, match="do both share a frame"):
        cloud_to_cloud(whole, whole, TUNING, (0.05,), None, cameras + 1000, 4.0)


def test_ghosts_are_inside_the_outline_only() -> None:
    rng = np.random.default_rng(3)
    inside = rng.uniform([1, 1, 1.5], [9, 3, 3], (1000, 3))  # in the air above the floor
    beyond = rng.uniform([50, 1, 1], [60, 3, 3], (3000, 3))  # where the reference says nothing
    body = quay(4000)
    result = cloud_to_cloud(np.vstack([body, inside, beyond]), quay(50_000, 2), TUNING, (0.1,))
    assert 0.15 < result.ghosts < 0.25
    assert result.judged.outside == pytest.approx(3 / 8, abs=0.05)


def test_thinning_keeps_to_its_limit() -> None:
    thinned, voxel = comparison.thin(quay(50_000), 0.01, CloudTuning(max_points=5000))
    assert len(thinned) <= 5000 and voxel > 0.01
    assert {*map(tuple, thinned)} <= {*map(tuple, quay(50_000))}


def test_empty_clouds_are_refused() -> None:
    with pytest.raises(ValueError, match="cloud has no points"):
        cloud_to_cloud(np.zeros((0, 3)), quay(), TUNING)
    with pytest.raises(ValueError, match="reference has no points"):
        cloud_to_cloud(quay(), np.full((3, 3), np.nan), TUNING)
