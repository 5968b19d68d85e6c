"""Pairs and their ties: sorted, unique, joined, found by either order of the ends, written and read unchanged."""

import numpy as np
import pytest

from tiegraph.scene.pairs import REASON_LOOKS, REASONS, Pairs, PreviewMatches

DRAW = np.random.default_rng(0)
LISTS = [list(map(tuple, DRAW.integers(0, 13, (k, 2)).tolist())) for k in range(41)]


def table(pairs, source="sequence"):
    array = np.array(pairs, dtype=int).reshape(-1, 2)
    return Pairs.make(array[:, 0], array[:, 1], source)


@pytest.mark.parametrize("pairs", LISTS, ids=len)
def test_always_sorted_unique_and_without_self_pairs(pairs):
    made = table(pairs)
    want = sorted({(min(p), max(p)) for p in pairs if p[0] != p[1]})
    assert list(zip(made.i.tolist(), made.j.tolist())) == want


@pytest.mark.parametrize(("a", "b"), list(zip(LISTS, LISTS[::-1])), ids=len)
def test_union_keeps_every_pair_and_both_sources(a, b):
    both = table(a) | table(b, "offsets")
    names = {tuple(p): k for k, p in enumerate(zip(both.i.tolist(), both.j.tolist()))}
    for pairs, source in ((a, "sequence"), (b, "offsets")):
        for p in pairs:
            if p[0] != p[1]:
                assert both.from_source(source)[names[tuple(sorted(p))]]
    assert len(names) == len({tuple(sorted(p)) for p in a + b if p[0] != p[1]})


@pytest.mark.parametrize("pairs", LISTS, ids=len)
def test_filters_only_drop_and_the_first_reason_stays(pairs):
    made = table(pairs)
    mask = np.random.default_rng(len(pairs)).random(len(made)) < 0.5
    dropped = made.drop(mask, "weak").drop(np.ones(len(made), bool), "cut")
    assert len(dropped) == len(made) and len(dropped.kept()) == 0
    assert (dropped.dropped[mask] == REASONS.index("weak")).all()
    funnel = made.drop(mask, "weak").funnel()
    assert funnel["candidates"] - funnel.get("weak", 0) == funnel["used"]


def test_a_pair_kept_by_one_source_is_kept_and_known_numbers_win():
    a = Pairs.make([0, 1], [1, 2], "offsets", score=np.array([3.0, 7.0])).drop(np.array([True, False]), "weak")
    both = a | Pairs.make([1], [0], "sequence")
    assert both.dropped.tolist() == [0, 0] and both.score.tolist() == [3.0, 7.0]


def test_best_score_of_duplicates_and_round_trips():
    made = Pairs.make([1, 0, 0], [0, 1, 2], "file", score=np.array([2.0, 9.0, np.nan]))
    assert made.score[0] == 9
    again = Pairs.from_npz(made.to_npz())
    assert again.to_csv(("a", "b", "c")) == made.to_csv(("a", "b", "c"))
    assert made.to_text(("a", "b", "c")) == "a b\na c\n"
    assert made.matrix(3).tolist() == [[0, 1, 1], [1, 0, 0], [1, 0, 0]]


def test_unsorted_columns_are_refused():
    good = Pairs.make([0, 0], [1, 2], "file")
    with pytest.raises(ValueError, match="sorted and unique"):
        good.where(np.array([1, 0]))
    with pytest.raises(ValueError, match="read-only"):
        good.i[0] = 5


def test_every_reason_has_a_look() -> None:
    assert all(words and colour for words, colour in REASON_LOOKS.values())
    assert len({colour for _, colour in REASON_LOOKS.values()}) == len(REASONS)


def ties() -> PreviewMatches:
    return PreviewMatches.make([3, 0, 0], [5, 2, 1], [np.array([[1, 2], [3, 4]]), np.zeros((0, 2)), np.array([[7, 8]])])


def test_ties_are_sorted_with_their_matches_and_found_in_either_order() -> None:
    made = ties()
    assert list(zip(made.i, made.j)) == [(0, 1), (0, 2), (3, 5)]
    assert made.counts().tolist() == [1, 0, 2] and made.of(2).tolist() == [[1, 2], [3, 4]]
    assert made.find(np.array([5, 1, 4]), np.array([3, 0, 5])).tolist() == [2, 0, -1]
    assert PreviewMatches.empty().find(np.array([1]), np.array([2])).tolist() == [-1]
    with pytest.raises(ValueError, match="PreviewMatches.make"):
        PreviewMatches(np.array([2]), np.array([1]), np.array([0, 0]), np.zeros((0, 2)))


def test_subset_and_round_trip() -> None:
    kept = ties().where(np.array([True, False, True]))
    assert kept.counts().tolist() == [1, 2]
    again = PreviewMatches.from_npz(kept.to_npz())
    assert np.array_equal(again.matches, kept.matches) and np.array_equal(again.start, kept.start)


def test_union_keeps_the_first_of_a_pair_in_both() -> None:
    both = ties() | PreviewMatches.make([0, 1], [1, 2], [np.array([[1, 1], [2, 2]]), np.array([[5, 6]])])
    assert list(zip(both.i, both.j)) == [(0, 1), (0, 2), (1, 2), (3, 5)]
    assert both.of(0).tolist() == [[7, 8]] and both.of(2).tolist() == [[5, 6]]
