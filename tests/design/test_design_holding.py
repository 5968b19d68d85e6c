"""What stays whatever a design is after: the strongest pairs across every cut; what pairs are expected to bring."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boat_world import photos
from tiegraph.design.design import design, holding, takes_all
from tiegraph.design.matchprediction import predict_matches, verified_chance
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tuning import MatchPredictionTuning, Tuning
from tiegraph.scene.graph import components, parts
from tiegraph.scene.matches import PreviewMatches, Visibility
from tiegraph.scene.pairs import Pairs

TUNING = Tuning(few_pairs=0)  # or of few photographs all pairs are matched


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
    kept[np.concatenate([np.zeros(0, int), *holding(i, j, strength, chance, count, TUNING)])] = True
    sides = [np.arange(count) == k for k in range(count)] + [rng.random(count) < 0.5 for _ in range(20)]
    for side in sides:
        across = np.flatnonzero(side[i] != side[j])
        cut = across[~kept[across]]
        if len(cut):
            better = across[kept[across] & (strength[across] >= strength[cut].max())]
            assert len(better) >= 3 and chance[better].sum() >= TUNING.wanted - 0.15, "0.95 counts as sure"


def test_sure_pairs_are_held_by_three_forests_and_no_more() -> None:
    i, j = np.triu_indices(12, 1)
    strength = 500.0 + np.random.default_rng(2).permutation(len(i))
    rounds = holding(i, j, strength, np.ones(len(i)), 12, TUNING)
    assert [len(r) for r in rounds] == [11, 11, 11]
    kept = np.concatenate(rounds)
    assert len(np.unique(parts(i[kept], j[kept], 12))) == 1
    for k in range(12):
        own = np.flatnonzero((i == k) | (j == k))
        assert np.isin(own[np.argsort(strength[own])][-3:], kept).all(), "the three strongest of each image"
    halves = holding(i, j, strength, np.full(len(i), 0.5), 12, TUNING)
    assert 55 < sum(len(r) for r in halves) <= 66, "twice as many, where every second fails"


@pytest.mark.parametrize(
    "images, count, all_of_them",
    [(41, 241, True), (25, 300, True), (11, 55, True), (79, 2848, False), (300, 15730, False)],
)
def test_few_pairs_are_all_matched_and_many_are_chosen_from(images, count, all_of_them) -> None:
    i, j = (ends[:count] for ends in np.triu_indices(images, 1))
    assert takes_all(Pairs.make(i, j, "exhaustive"), photos(images), DesignSettings(), Tuning()) == all_of_them


def test_where_few_pairs_are_all_matched_it_is_said() -> None:
    pairs, ties = kite(0)
    few = TUNING.model_copy(update={"few_pairs": len(pairs) / 40})
    found = design(pairs, photos(40), ties, DesignSettings(), few)
    assert len(found.pairs.kept()) == len(pairs)
    assert found.notes[0].startswith(f"all {len(pairs)} pairs")
    many = TUNING.model_copy(update={"few_pairs": (len(pairs) - 1) / 40})
    assert len(design(pairs, photos(40), ties, DesignSettings(), many).pairs.kept()) < len(pairs)
    counted = DesignSettings(budget="pairs", pairs_per_image=4)
    assert len(design(pairs, photos(40), ties, counted, few).pairs.kept()) < 0.6 * len(pairs), "as asked"


PREDICTION = MatchPredictionTuning()


def visibility(x: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Visibility:
    """Three images on a line before a wall 10 away; the first two share 200 points, the third sees others."""
    points = [np.arange(0, 400), np.arange(200, 600), np.arange(1000, 1100)]
    xyz = np.random.default_rng(0).uniform((-3, -3, 10), (3, 3, 10), (1100, 3))
    centre = np.array([[v, 0.0, 0.0] for v in x])
    return Visibility(np.cumsum([0] + [len(p) for p in points]), np.concatenate(points), xyz, centre)


def test_matches_are_among_the_common_points_and_always_the_same() -> None:
    asked = np.array([0, 0, 1]), np.array([1, 2, 2]), np.full(3, np.nan), visibility(), PREDICTION
    expected, found = predict_matches(*asked)
    assert found.i.tolist() == [0] and found.j.tolist() == [1]  # the others share nothing
    assert np.isnan(expected).tolist() == [False, True, True]
    assert 70 <= found.counts()[0] <= 130  # half of 200
    left, right = found.of(0).T
    assert np.array_equal(visibility().of(0)[left], visibility().of(1)[right]) and left.min() >= 200
    assert np.array_equal(found.matches, predict_matches(*asked)[1].matches)


def test_fewer_where_the_rays_meet_at_a_larger_angle() -> None:
    pair = np.array([0]), np.array([1]), np.array([np.nan])
    counts = [predict_matches(*pair, visibility((0.0, base, 0.0)), PREDICTION)[0][0] for base in (0.0, 2.0, 6.0)]
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
        found = predict_matches(i, j, known, seen, PREDICTION)[0]
        hidden = np.isnan(known) & (count > 20)
        assert np.corrcoef(found[hidden], count[hidden] - 8)[0, 1] > 0.98
        assert np.median(found[hidden] / (count[hidden] - 8)) == pytest.approx(1.0, abs=0.15)


def test_chance_of_verification_rises_with_the_matches() -> None:
    chance = verified_chance(np.array([1.0, 7.5, 15.0, 100.0]), PREDICTION)
    assert chance[0] < 0.03 and chance[1] == 0.5 and 0.7 < chance[2] < 0.9 and 0.99 < chance[3] <= 1.0
