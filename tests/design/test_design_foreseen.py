"""Expected matches of pairs that were never previewed, from the points both images see."""

import numpy as np

from tiegraph.design.foreseen import foreseen_ties
from tiegraph.scene.ties import Sights


def sights() -> Sights:
    points = [np.arange(0, 400), np.arange(200, 600), np.arange(1000, 1100)]
    return Sights(np.cumsum([0] + [len(p) for p in points]), np.concatenate(points))


def test_as_many_matches_as_expected_among_the_common_points() -> None:
    ties = foreseen_ties(np.array([0, 0, 1]), np.array([1, 2, 2]), np.array([50.0, 10.0, 10.0]), sights())
    assert ties.i.tolist() == [0] and ties.j.tolist() == [1]  # the others share nothing
    assert 30 <= ties.counts()[0] <= 70
    left, right = ties.of(0).T
    assert np.array_equal(sights().of(0)[left], sights().of(1)[right])
    assert left.min() >= 200


def test_never_more_than_there_are_and_always_the_same() -> None:
    pair = np.array([0]), np.array([1]), np.array([9999.0])
    assert foreseen_ties(*pair, sights()).counts().tolist() == [200]
    few = np.array([0]), np.array([1]), np.array([20.0])
    assert np.array_equal(foreseen_ties(*few, sights()).matches, foreseen_ties(*few, sights()).matches)
