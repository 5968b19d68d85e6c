"""What stays whatever a design is after: the strongest pairs across every cut, and all pairs where they cost little."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boat_world import photos
from tiegraph.design.design import Cost, cost, design, holding, predicted_keypoints
from tiegraph.design.matchprediction import verified_chance
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tuning import Tuning
from tiegraph.scene.graph import components, parts
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.pairs import Pairs

TUNING = Tuning()


def kite(seed: int, count: int = 40) -> tuple[Pairs, PreviewMatches]:
    """Photographs all over a field of which each sees a part, dark and blurred ones among them: few previews match."""
    rng = np.random.default_rng(seed)
    place, mark = rng.random((count, 2)), rng.random((400, 2))
    found = rng.choice([0.2, 0.7], count, p=[0.3, 0.7])
    seen = (np.linalg.norm(place[:, None] - mark, axis=2) < 0.28) & (rng.random((count, 400)) < found[:, None])
    i, j = np.triu_indices(count, 1)
    both = [np.flatnonzero(seen[a] & seen[b]) for a, b in zip(i, j)]
    both = [m[rng.random(len(m)) < 0.8] for m in both]
    tied = np.array([len(m) >= 4 for m in both])
    i, j, both = i[tied], j[tied], [m for m, t in zip(both, tied) if t]
    ties = PreviewMatches.make(i, j, [np.stack([m, m], axis=1) for m in both])
    return Pairs.make(i, j, "exhaustive", score=np.array([len(m) for m in both], float)), ties


def loose(pairs: Pairs, verified: np.ndarray, count: int) -> np.ndarray:
    """(N,) images that fewer than two verified pairs hold to the largest component, the least to be placed by."""
    own = pairs.where((pairs.dropped == 0) & verified)
    return (own.degree(count) < 2) | (components(own, count) > 0)


def test_no_photograph_is_lost_to_save_pairs() -> None:
    lost, kept = [], []
    for seed in range(4):
        pairs, ties = kite(seed)
        found = design(pairs, photos(40), ties, DesignSettings(), TUNING).pairs
        kept.append(len(found.kept()) / len(pairs))
        chance = verified_chance(pairs.score.astype(float), TUNING.match_prediction)
        for again in range(10):  # which pairs come through verification
            comes = np.random.default_rng(again).random(len(pairs)) < chance
            lost.append(np.sum(loose(found, comes, 40) & ~loose(pairs, comes, 40)))
    assert np.mean(lost) < 0.15, "of 40 images; chosen by the loss alone, with one forest, 3.1"
    assert 0.6 < np.mean(kept) < 0.95, "46 % by the loss alone"


@settings(max_examples=40, deadline=None)
@given(st.integers(3, 25), st.integers(0, 200), st.integers(0, 999))
def test_across_every_cut_the_strongest_pairs_stay_until_three_are_expected(count, edges, seed) -> None:
    rng = np.random.default_rng(seed)
    ends = np.unique(np.sort(rng.integers(0, count, (edges, 2)), axis=1), axis=0)
    i, j = ends[ends[:, 0] < ends[:, 1]].T.reshape(2, -1)
    strength = rng.gamma(1.0, 12.0, len(i))
    chance = verified_chance(strength, TUNING.match_prediction)
    kept = np.zeros(len(i), bool)
    kept[np.concatenate([np.zeros(0, int), *holding(i, j, strength, chance, count, TUNING.holding)])] = True
    sides = [np.arange(count) == k for k in range(count)] + [rng.random(count) < 0.5 for _ in range(20)]
    for side in sides:
        across = np.flatnonzero(side[i] != side[j])
        cut = across[~kept[across]]
        if len(cut):
            better = across[kept[across] & (strength[across] >= strength[cut].max())]
            assert len(better) >= 3 and chance[better].sum() >= TUNING.holding.wanted - 0.15, "0.95 counts as sure"


def test_sure_pairs_are_held_by_three_forests_and_no_more() -> None:
    i, j = np.triu_indices(12, 1)
    strength = 500.0 + np.random.default_rng(2).permutation(len(i))
    rounds = holding(i, j, strength, np.ones(len(i)), 12, TUNING.holding)
    assert [len(r) for r in rounds] == [11, 11, 11]
    kept = np.concatenate(rounds)
    assert len(np.unique(parts(i[kept], j[kept], 12))) == 1
    for k in range(12):
        own = np.flatnonzero((i == k) | (j == k))
        assert np.isin(own[np.argsort(strength[own])][-3:], kept).all(), "the three strongest of each image"
    halves = holding(i, j, strength, np.full(len(i), 0.5), 12, TUNING.holding)
    assert 55 < sum(len(r) for r in halves) <= 66, "twice as many, where every second fails"


def whole(images: int, candidates: int, keypoints: float = 4096.0, megapixels: float = 1.5) -> Cost:
    rng = np.random.default_rng(0)
    i, j = rng.integers(0, images, (2, candidates))
    return cost(i, j, np.full(images, keypoints), np.full(images, megapixels), TUNING.cost)


def test_what_matching_costs_is_as_it_was_measured() -> None:
    """CPU seconds of whole runs (benchmarks/results): of the matching, and to georef of the rest."""
    for images, pairs, keypoints, megapixels, matching_s, rest_s in (
        (25, 295, 4096, 1.57, 8.0, 39.4),
        (79, 733, 4096, 1.12, 17.7, 135.4),
        (102, 1268, 4096, 0.454, 26.6, 98.4),
        (120, 1264, 951, 0.173, 3.8, 97.3),
        (300, 4439, 1758, 0.307, 29.2, 349.8),
        (300, 2753, 1535, 0.518, 22.5, 220.0),
    ):
        found = whole(images, pairs, keypoints, megapixels)
        assert 0.4 < found.matching_s / matching_s < 1.6
        assert 1.0 < found.rest_s / rest_s < 3.0, "dense and cloud come after georef"


@pytest.mark.parametrize(
    "images, pairs, all_of_them",
    [(41, 241, True), (25, 300, True), (11, 55, True), (79, 2848, False), (300, 15730, False), (4000, 147418, False)],
)
def test_few_pairs_are_all_matched_and_many_are_chosen_from(images, pairs, all_of_them) -> None:
    assert whole(images, pairs).little(TUNING.cost) == all_of_them


def test_where_all_pairs_cost_little_none_is_saved_and_it_is_said() -> None:
    pairs, ties = kite(0)
    little = Cost(len(pairs), 5.0, 95.0)
    found = design(pairs, photos(40), ties, DesignSettings(), TUNING, cost=little)
    assert len(found.pairs.kept()) == len(pairs)
    assert found.notes[0].startswith(f"all {len(pairs)} pairs: to match them takes about 5 % of the run")
    bound = TUNING.cost.little
    much = Cost(len(pairs), bound * 100, (1 - bound) * 99)
    assert len(design(pairs, photos(40), ties, DesignSettings(), TUNING, cost=much).pairs.kept()) < len(pairs)
    counted = DesignSettings(budget="pairs", pairs_per_image=4)
    asked = design(pairs, photos(40), ties, counted, TUNING, cost=little).pairs
    assert len(asked.kept()) < 0.6 * len(pairs), "as asked"


def test_key_points_are_foreseen_by_the_area_that_is_used() -> None:
    found = predicted_keypoints(np.array([0.173, 0.307, 12.0]), np.array([0.48, 0.48, 1.0]), 4096, TUNING.cost)
    assert 0.8 < found[0] / 951 < 1.3 and 0.8 < found[1] / 1758 < 1.3 and found[2] == 4096
