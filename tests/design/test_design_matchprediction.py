"""Expected matches of pairs that were never previewed, from the points both images see."""

import numpy as np
import pytest

from tiegraph.design.matchprediction import predict_matches, verified_chance
from tiegraph.design.tuning import MatchPredictionTuning
from tiegraph.scene.matches import Visibility

TUNING = MatchPredictionTuning()
NOT_PREVIEWED = np.full(3, np.nan)


def visibility(x: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Visibility:
    """Three images on a line before a wall 10 away; the first two share 200 points, the third sees others."""
    points = [np.arange(0, 400), np.arange(200, 600), np.arange(1000, 1100)]
    xyz = np.random.default_rng(0).uniform((-3, -3, 10), (3, 3, 10), (1100, 3))
    centre = np.array([[v, 0.0, 0.0] for v in x])
    return Visibility(np.cumsum([0] + [len(p) for p in points]), np.concatenate(points), xyz, centre)


def test_matches_are_among_the_common_points_and_always_the_same() -> None:
    expected, found = predict_matches(np.array([0, 0, 1]), np.array([1, 2, 2]), NOT_PREVIEWED, visibility(), TUNING)
    assert found.i.tolist() == [0] and found.j.tolist() == [1]  # the others share nothing
    assert np.isnan(expected).tolist() == [False, True, True]
    assert 70 <= found.counts()[0] <= 130  # half of 200
    left, right = found.of(0).T
    assert np.array_equal(visibility().of(0)[left], visibility().of(1)[right])
    assert left.min() >= 200
    _, again = predict_matches(np.array([0, 0, 1]), np.array([1, 2, 2]), NOT_PREVIEWED, visibility(), TUNING)
    assert np.array_equal(found.matches, again.matches)


def test_fewer_where_the_rays_meet_at_a_larger_angle() -> None:
    pair = np.array([0]), np.array([1]), np.array([np.nan])
    counts = [predict_matches(*pair, visibility((0.0, base, 0.0)), TUNING)[0][0] for base in (0.0, 2.0, 6.0)]
    assert counts[0] == pytest.approx(100) and 0.4 * counts[0] < counts[1] < 0.9 * counts[0]
    assert counts[2] < 0.2 * counts[0]


@pytest.mark.slow
def test_the_previewed_pairs_tell_how_fast_chances_fall() -> None:
    n, rng = 60, np.random.default_rng(1)
    xyz = rng.uniform((-10, -3, 10), (70, 3, 10), (4000, 3))
    centre = np.stack([np.arange(n, dtype=float), np.zeros(n), np.zeros(n)], axis=1)
    own = [np.flatnonzero(np.abs(xyz[:, 0] - c) < 10) for c in centre[:, 0]]
    seen = Visibility(np.cumsum([0] + [len(p) for p in own]), np.concatenate(own), xyz, centre)
    i, j = np.triu_indices(n, 1)
    near = j - i < 15
    i, j = i[near], j[near]

    def true(width_deg: float) -> np.ndarray:
        out = []
        for a, b in zip(i, j):
            p = np.intersect1d(own[a], own[b])
            rays = [xyz[p] - centre[k] for k in (a, b)]
            far = [np.linalg.norm(r, axis=1) for r in rays]
            angle = np.degrees(np.arccos(np.sum(rays[0] * rays[1], axis=1) / far[0] / far[1]))
            octaves = np.log2(far[0] / far[1])
            out.append(8 + 0.2 * np.sum(np.exp(-((angle / width_deg) ** 2) - (octaves / 0.7) ** 2)))
        return np.array(out)

    for width in (10.0, 28.0):
        count = true(width)
        known = np.where(rng.random(len(i)) < 0.3, rng.poisson(count), np.nan)
        found = predict_matches(i, j, known, seen, TUNING)[0]
        hidden = np.isnan(known) & (count > 20)
        assert np.corrcoef(found[hidden], count[hidden] - 8)[0, 1] > 0.98
        assert np.median(found[hidden] / (count[hidden] - 8)) == pytest.approx(1.0, abs=0.15)


def test_chance_of_verification_rises_with_the_matches() -> None:
    chance = verified_chance(np.array([1.0, 7.5, 15.0, 100.0]), TUNING)
    assert chance[0] < 0.03 and chance[1] == 0.5 and 0.7 < chance[2] < 0.9 and 0.99 < chance[3] <= 1.0
