"""Choosing pairs for matching: methods, budgets, connectivity, tracks, and what an unseen pair is expected to bring."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boat_world import boat, photos
from network_steps import network_of
from tiegraph import papers
from tiegraph.design.coverage import coverage
from tiegraph.design.design import METHODS as PLUGGED
from tiegraph.design.design import DesignResult, design, with_coverage
from tiegraph.design.matchprediction import expected_matches
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tracks import Candidates, Predictor, Tracks
from tiegraph.design.tuning import NetTuning, Tuning
from tiegraph.scene.graph import component_notes, components, cuts, groups, two_links
from tiegraph.scene.pairs import REASONS, Pairs, PreviewMatches
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

TUNING, NET = Tuning(few_pairs=0), NetTuning()
papers.plug_in(papers.DESIGNS, "fuse2014_safe", PLUGGED)
METHODS = ("hybrid", "top", "fuse2014_safe")


def designed(pairs: Pairs, scene: Scene, ties: PreviewMatches | None = None, **wanted: object) -> DesignResult:
    return design(pairs, scene, ties, DesignSettings(**wanted), TUNING)


def graph(count: int, edges: int, seed: int) -> Pairs:
    rng = np.random.default_rng(seed)
    i, j = rng.integers(0, count, edges), rng.integers(0, count, edges)
    score = np.where(rng.random(edges) < 0.2, np.nan, rng.integers(0, 200, edges).astype(float))
    return Pairs.make(i, j, "offsets", score=score, dropped=np.where(rng.random(edges) < 0.2, 8, 0))


def corridor(frames: int = 10, seed: int = 0) -> tuple[Scene, Pairs, PreviewMatches]:
    """Two cameras there and back along a wall; every image sees 40 of its landmarks, 3 a frame; a third is matched."""
    rng = np.random.default_rng(seed)
    frame, sensor = np.repeat(np.arange(2 * frames), 2), np.tile([0, 1], 2 * frames)
    place = np.where(frame < frames, frame, 2 * frames - 1 - frame)
    first = 3 * place + 8 * sensor
    names = [f"{a:02d}_{c}.jpg" for a, c in zip(frame, sensor)]
    rig = Rig("two", (Sensor("left"), Sensor("right")))
    track, step = np.repeat([0, 1], frames), np.tile(np.arange(frames), 2)
    scene = simple_scene(rig, names, frame, sensor, track, step, sequences=("up", "down"))
    i, j, matches = [], [], []
    for a in range(len(names)):
        for b in range(a + 1, len(names)):
            common = np.arange(max(first[a], first[b]), min(first[a], first[b]) + 40)
            common = common[rng.random(len(common)) < 0.5]
            if len(common) >= 4:
                i.append(a)
                j.append(b)
                matches.append(np.stack([common - first[a], common - first[b]], axis=1))
    ties = PreviewMatches.make(i, j, matches)
    return scene, Pairs.make(i, j, "file", score=np.array([len(m) for m in matches], float)), ties


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(st.integers(2, 30), st.integers(0, 200), st.integers(0, 99), st.integers(1, 6), st.sampled_from(METHODS))
def test_every_method_only_drops_and_keeps_the_components(count, edges, seed, most, method) -> None:
    pairs = graph(count, edges, seed)
    budget = "pairs" if seed % 2 else "loss"
    chosen = designed(pairs, photos(count), method=method, pairs_per_image=most, budget=budget).pairs
    assert len(chosen) == len(pairs) and np.all((chosen.dropped == 0) <= (pairs.dropped == 0))
    assert np.array_equal(components(pairs, count), components(chosen, count))
    if method == "top":
        assert np.all(chosen.degree(count) >= np.minimum(pairs.degree(count), most))
        assert len(chosen.kept()) <= count * most + 2 * count


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(st.integers(3, 25), st.integers(0, 120), st.integers(0, 99))
def test_a_single_link_stays_single_only_where_there_is_no_second(count, edges, seed) -> None:
    pairs = graph(count, edges, seed).kept()
    chosen = designed(pairs, photos(count), budget="pairs", pairs_per_image=1).pairs.kept()
    before, after = cuts(pairs.i, pairs.j, count), cuts(chosen.i, chosen.j, count)
    single = {(int(i), int(j)) for i, j in zip(chosen.i[after.bridge], chosen.j[after.bridge])}
    assert single == {(int(i), int(j)) for i, j in zip(pairs.i[before.bridge], pairs.j[before.bridge])}


@pytest.mark.slow
def test_top_keeps_every_pass_and_camera_in_an_images_list() -> None:
    world = boat((16, 16), (1.0, 1.0))
    pairs = network_of(world.scene, world.match).pairs
    chosen = designed(pairs, world.scene, method="top", pairs_per_image=8).pairs
    assert len(chosen.kept()) < 0.5 * len(pairs.kept())
    track = world.scene.sequence[world.scene.frame]

    def across(p: Pairs) -> float:
        kept = p.kept()
        return float(np.mean(track[kept.i] != track[kept.j]))

    assert across(chosen) > 0.8 * across(pairs)


def test_strongest_pairs_win() -> None:
    score = np.array([50.0, 40.0, 30.0, 5.0])
    pairs = Pairs.make([0, 0, 0, 1], [1, 2, 3, 2], "offsets", score=score)
    chosen = designed(pairs, photos(4), method="top", pairs_per_image=1).pairs
    # the weak pair closes the only ring and so gives two images their second link
    assert chosen.dropped.tolist() == [0, 0, 0, 0]
    chosen = designed(pairs.where(score > 5), photos(4), method="top", pairs_per_image=1).pairs
    assert chosen.dropped.tolist() == [0, 0, 0]


def test_components_and_lonely_images_are_named() -> None:
    pairs = Pairs.make([0, 1, 4], [1, 2, 5], "file")
    assert components(pairs, 7).tolist() == [0, 0, 0, 2, 1, 1, 3]
    notes = component_notes(pairs, photos(7))
    assert "2 images have no pair: 003.jpg, 006.jpg" in notes[0]
    assert "2 components: 3 images with 000.jpg, 2 images with 004.jpg" in notes[1]
    assert component_notes(Pairs.make([0], [1], "file"), photos(2)) == ()


@pytest.mark.slow
def test_a_stricter_budget_of_loss_costs_pairs() -> None:
    scene, pairs, ties = corridor()
    kept = []
    for loss in (0.5, 1.0, 60.0):
        found = designed(pairs, scene, ties, loss_percent=loss)
        assert 0 <= found.counts["preview_loss_percent"] <= loss
        assert f"asked: {loss:g} %" in found.notes[0]
        kept.append(len(found.pairs.kept()))
    assert len(pairs) > kept[0] > kept[1] > kept[2] >= len(scene) - 1


@pytest.mark.slow
def test_hybrid_predicts_less_loss_than_top_at_the_same_number_of_pairs() -> None:
    scene, pairs, ties = corridor()
    expected = expected_matches(pairs, ties)
    predictor = Predictor(Candidates.make(pairs.i, pairs.j, expected, ties, len(scene)), NET)

    def variance(chosen: Pairs) -> float:
        return predictor.variance(chosen.dropped == 0)

    top = designed(pairs, scene, ties, method="top", pairs_per_image=2).pairs
    degree = round(2 * len(top.kept()) / len(scene))
    own = designed(pairs, scene, ties, budget="pairs", pairs_per_image=degree).pairs
    assert abs(len(own.kept()) - len(top.kept())) <= len(scene) // 4 + 2
    assert variance(pairs) < variance(own) < 0.95 * variance(top)


def test_an_image_that_hangs_by_little_does_not_rule_the_loss_of_a_known_rig() -> None:
    i, j = np.array([0, 2, 0, 1]), np.array([2, 4, 4, 3])  # images 0, 2, 4 see much; 1 and 3 of the same frames little
    strong = np.stack([np.arange(40)] * 2, axis=1)
    ties = PreviewMatches.make(i, j, [strong, strong, strong + 100, strong[:1]])
    candidates = Candidates.make(i, j, ties.counts().astype(float), ties, 5)
    chosen = np.array([True, True, False, True])

    def loss(predictor: Predictor) -> float:
        return float(np.sqrt(predictor.variance(chosen) / predictor.variance(np.ones(4, bool)))) - 1

    alone, held = loss(Predictor(candidates, NET)), loss(Predictor(candidates, NET, unit=np.array([0, 0, 1, 1, 2])))
    assert 0 <= alone < 0.02, "the loose image is nearly all of the variance, with and without the third pair"
    assert 0.1 < held < 0.6


@pytest.mark.slow
def test_a_budget_of_pairs_is_kept_to() -> None:
    scene, pairs, ties = corridor()
    by_pairs = designed(pairs, scene, ties, budget="pairs", pairs_per_image=6)
    assert 3 * len(scene) <= len(by_pairs.pairs.kept()) <= 3 * len(scene) + by_pairs.counts["second_links"]
    too_few = designed(pairs, scene, ties, budget="pairs", pairs_per_image=1)
    assert f"the budget of {len(scene) // 2} pairs is not enough" in too_few.notes[0]
    assert len(np.unique(components(too_few.pairs, len(scene)))) == 1


@pytest.mark.slow
def test_groups_keep_two_links_without_a_common_image() -> None:
    scene, pairs, ties = corridor()
    weak = pairs.with_(score=np.where(scene.frame[pairs.i] // 10 == scene.frame[pairs.j] // 10, 100.0, 1.0))
    chosen = designed(weak, scene, budget="pairs", pairs_per_image=1).pairs.kept()
    for group in groups(scene):
        assert len(two_links(chosen.i, chosen.j, group.member, np.ones(len(chosen)))) == 2


def test_two_links_find_a_way_around_the_strongest_pair() -> None:
    member = np.array([True, True, False, False])
    strength = np.array([9.0, 5.0, 4.0])
    places = two_links(np.array([0, 0, 1]), np.array([2, 3, 2]), member, strength)
    assert sorted(places.tolist()) == [1, 2]  # (0, 3) and (1, 2) have no image in common; (0, 2) meets both
    assert two_links(np.array([0, 0]), np.array([2, 3]), member, strength[:2]).tolist() == [0]
    assert len(two_links(np.array([0]), np.array([1]), member, strength[:1])) == 0


def test_joined_tracks_bring_nothing_new() -> None:
    same = np.stack([np.arange(10)] * 2, axis=1)
    ties = PreviewMatches.make([0, 0, 1], [1, 2, 2], [same, same[:6], same[:8]])
    candidates = Candidates.make(np.array([0, 0, 1]), np.array([1, 2, 2]), np.array([10.0, 6, 8]), ties, 3)
    tracks = Tracks(candidates, NET)
    assert tracks.new().tolist() == [10, 6, 8]
    tracks.choose(np.array([0, 1]), tracks.new())
    assert tracks.new().tolist() == [0, 0, 2]  # six of the eight are joined through image 0
    assert tracks.joint().toarray()[0].tolist() == [10, 10, 6]


def test_unseen_pairs_are_expected_to_join_what_is_not_joined() -> None:
    same = np.stack([np.arange(10)] * 2, axis=1)
    ties = PreviewMatches.make([0, 1], [1, 2], [same, same])
    i, j = np.array([0, 0, 0, 1, 1, 2]), np.array([1, 2, 3, 2, 3, 3])
    candidates = Candidates.make(i, j, np.array([10.0, 8, 6, 10, 6, 6]), ties, 4)
    tracks = Tracks(candidates, NET)
    assert tracks.new().tolist() == [10, 8, 6, 10, 6, 6]
    tracks.choose(np.array([0, 3]), tracks.new())
    assert tracks.new().tolist() == [0, 0, 6, 0, 6, 6]  # images 0 and 2 share ten tracks: nothing of eight is left
    tracks.choose(np.array([2]), tracks.new())
    assert tracks.new().tolist() == [0, 0, 0, 0, 0, 0]  # all of image 0's features are image 1's and 2's


def test_half_shared_features_carry_half_of_an_unseen_pair() -> None:
    same = np.stack([np.arange(10)] * 2, axis=1)
    ties = PreviewMatches.make([0], [1], [same[:5]])
    candidates = Candidates.make(np.array([0, 0, 1]), np.array([1, 2, 2]), np.array([5.0, 10, 10]), ties, 3)
    tracks = Tracks(candidates, NET)
    tracks.choose(np.array([0]), tracks.new())
    tracks.choose(np.array([1]), tracks.new())
    assert tracks.new().tolist() == [0, 0, 5]  # of the ten joined between 0 and 2, half are expected to be in 1 too


def test_expected_matches_follow_the_overlap() -> None:
    rng = np.random.default_rng(0)
    overlap = rng.random(400)
    pairs = Pairs.make(np.arange(400), np.arange(1, 401), "model", overlap=overlap)
    shown = np.arange(0, 400, 2)
    count = rng.poisson(80 * overlap[shown] ** 1.2)  # not quite in proportion
    ties = PreviewMatches.make(shown, shown + 1, [np.zeros((n, 2)) for n in count])
    expected = expected_matches(pairs, ties)
    hidden = np.arange(1, 400, 2)
    error = expected[hidden] - 80 * overlap[hidden] ** 1.2
    assert 0.5 < np.sqrt(np.mean(error**2)) < 6 and np.all(expected >= 1)
    assert np.corrcoef(expected[shown], count)[0, 1] > 0.99
    assert expected_matches(Pairs.make([0], [1], "file"), None).tolist() == [1.0]


@pytest.mark.slow
def test_fewer_previews_still_give_a_good_design() -> None:
    scene, pairs, ties = corridor()
    truth = Predictor(Candidates.make(pairs.i, pairs.j, pairs.score.astype(float), ties, len(scene)), NET)
    sigma = []
    for share in (1.0, 1 / 3):
        seen = np.random.default_rng(1).random(len(ties)) < share
        chosen = design(pairs, scene, ties.where(seen), DesignSettings(budget="pairs", pairs_per_image=4), TUNING).pairs
        sigma.append(truth.variance(chosen.dropped == 0) ** 0.5)
    everything = truth.variance(np.ones(len(pairs), bool)) ** 0.5
    assert everything <= sigma[0] <= sigma[1] < 1.15 * sigma[0]


def test_the_weak_links_come_as_a_table() -> None:
    scene, pairs, ties = corridor()
    made = designed(pairs, scene, ties)
    found = with_coverage(made, coverage(made.pairs, scene))
    assert found.counts["candidates"] == len(pairs) and found.counts["pairs"] == len(found.pairs.kept())
    assert set(np.unique(found.pairs.dropped)) <= {0, REASONS.index("cut")}
    assert found.tables["weak links"]["rows"] == []
    assert designed(pairs, scene, ties, method="all").pairs is pairs


def test_nothing_to_choose_from_is_no_error() -> None:
    made = design(Pairs.empty(), photos(3), None, DesignSettings(), TUNING)
    found = with_coverage(made, coverage(made.pairs, photos(3)))
    assert len(found.pairs) == 0 and "3 images have no pair" in found.notes[0]


FEATURES = 6


def chained(images: int) -> Tracks:
    """Every image ties with the next by all its features, and one wrong match a pair makes one track of two."""
    i, j = np.arange(images - 1), np.arange(1, images)
    right = np.stack([np.arange(FEATURES)] * 2, axis=1)
    matches = np.tile(np.concatenate([right[1:], [[0, 1]]]), (images - 1, 1))
    start = FEATURES * np.arange(images)
    candidates = Candidates.make(i, j, np.full(len(i), 9.0), PreviewMatches(i, j, start, matches), images)
    tracks = Tracks(candidates, NET)
    tracks.join(np.arange(len(i)))
    return tracks


def test_one_wrong_track_does_not_link_all_images() -> None:
    images = 4 * NET.wide_images
    tracks = chained(images)
    assert np.bincount(tracks.parent).max() > 1.9 * images  # two features of every image in one
    joint = tracks.joint()
    assert 2 * images < joint.nnz <= images * NET.wide_images  # and not the square of the images
    apart = np.abs(np.subtract(*joint.nonzero()))
    assert apart.max() < NET.wide_images


def test_small_surveys_keep_every_link() -> None:
    images = NET.wide_images - 10
    tracks = chained(images)
    seen = tracks.incidence()
    count = np.zeros((images, len(tracks.parent)))
    image = np.repeat(np.arange(images), np.diff(tracks.candidates.first))
    np.add.at(count, (image, tracks.parent), 1.0)
    count = count[:, count.sum(axis=0) >= 2]
    assert seen.shape == count.shape and seen.nnz == np.count_nonzero(count)
    np.testing.assert_array_equal(tracks.joint().toarray(), count @ count.T)
