"""Ties: sorted, unique, found by either order of the ends, and written and read unchanged."""

import numpy as np
import pytest

from tiegraph.scene.matches import PreviewMatches


def some() -> PreviewMatches:
    return PreviewMatches.make([3, 0, 0], [5, 2, 1], [np.array([[1, 2], [3, 4]]), np.zeros((0, 2)), np.array([[7, 8]])])


def test_sorted_with_their_matches() -> None:
    ties = some()
    assert list(zip(ties.i, ties.j)) == [(0, 1), (0, 2), (3, 5)]
    assert ties.counts().tolist() == [1, 0, 2]
    assert ties.of(2).tolist() == [[1, 2], [3, 4]]


def test_found_in_either_order() -> None:
    assert some().find(np.array([5, 1, 4]), np.array([3, 0, 5])).tolist() == [2, 0, -1]
    assert PreviewMatches.empty().find(np.array([1]), np.array([2])).tolist() == [-1]


def test_subset_and_round_trip() -> None:
    kept = some().where(np.array([True, False, True]))
    assert kept.counts().tolist() == [1, 2]
    again = PreviewMatches.from_npz(kept.to_npz())
    assert np.array_equal(again.matches, kept.matches) and np.array_equal(again.start, kept.start)


def test_union_keeps_the_first_of_a_pair_in_both() -> None:
    both = some() | PreviewMatches.make([0, 1], [1, 2], [np.array([[1, 1], [2, 2]]), np.array([[5, 6]])])
    assert list(zip(both.i, both.j)) == [(0, 1), (0, 2), (1, 2), (3, 5)]
    assert both.of(0).tolist() == [[7, 8]] and both.of(2).tolist() == [[5, 6]]


def test_wrong_order_is_refused() -> None:
    with pytest.raises(ValueError, match="PreviewMatches.make"):
        PreviewMatches(np.array([2]), np.array([1]), np.array([0, 0]), np.zeros((0, 2)))
