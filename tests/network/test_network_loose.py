"""Loose photographs: look-alikes, neighbours of neighbours, and what is kept."""

import numpy as np
import pytest
from place_world import Places, found, photos, shuffled_ring, video, words_of

from boat_world import Result
from tiegraph.network.passes import MatchCache
from tiegraph.network.retrieval.loose import scored_pairs, supported
from tiegraph.network.retrieval.vocabulary import bags_of_words
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.graph import components
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

SETTINGS, TUNING = CandidatesSettings(), Tuning()
LOOSE = TUNING.retrieval.loose


def tied(world: Places, with_words: bool = True, scene: Scene | None = None, images=None) -> Pairs:
    count = len(world)
    words = words_of(world) if with_words else None
    chosen = np.arange(count) if images is None else images
    return scored_pairs(scene or photos(count), chosen, MatchCache(world.match, count), SETTINGS, TUNING, words)


def test_few_photographs_are_all_previewed() -> None:
    world = shuffled_ring(LOOSE.all_limit)
    recall, precision = found(tied(world), world.useful())
    assert world.asked == LOOSE.all_limit * (LOOSE.all_limit - 1) // 2
    assert recall > 0.98 and precision > 0.8


@pytest.mark.slow
@pytest.mark.parametrize("ghosts, least", [(0.0, 0.8), (0.2, 0.5)])
def test_a_ring_of_300_photographs_needs_few_previews(ghosts, least) -> None:
    world = shuffled_ring(300)
    world.ghosts = ghosts
    pairs = tied(world)
    recall, precision = found(pairs, world.useful())
    assert recall > 0.97 and precision > least
    assert world.asked <= TUNING.previews_an_image * 300
    assert components(pairs, 300).max() == 0
    assert pairs.from_source("retrieval").all()


@pytest.mark.slow
def test_previews_grow_with_the_images_and_not_with_their_square() -> None:
    small, large = shuffled_ring(120), shuffled_ring(300)
    assert found(tied(small), small.useful())[0] > 0.97 and found(tied(large), large.useful())[0] > 0.97
    assert large.asked < 3.0 * small.asked


def test_two_unrelated_groups_stay_two() -> None:
    order = np.random.default_rng(2).permutation(150)
    world = Places(np.where(order < 75, order * 12.0, 50_000 + order * 12.0))
    pairs = tied(world)
    assert found(pairs, world.useful())[0] > 0.97
    sure = pairs.where(pairs.score >= SETTINGS.min_matches)
    parts = components(sure, 150)
    assert parts.max() == 1
    assert len({(a, b) for a, b in zip(parts.tolist(), (order < 75).tolist())}) == 2


@pytest.mark.slow
def test_photographs_are_tied_to_the_frames_of_a_pass() -> None:
    world = Places(np.r_[np.arange(200) * 12.0, np.arange(40) * 60.0 + 6])
    clip = video(200)
    names = [*clip.names, *(f"img_{k:03d}.jpg" for k in range(40))]
    more = {n: np.concatenate([getattr(clip, n), getattr(clip, n)[:40]]) for n in ("rig", "time_s", "world_from_rig")}
    scene = Scene(
        rigs=clip.rigs,
        names=tuple(names),
        frame=np.arange(240),
        sensor=np.zeros(240),
        sequence=np.r_[np.zeros(200), np.full(40, -1)],
        sequence_index=np.r_[np.arange(200), np.zeros(40)],
        section=np.full(240, -1),
        position_sigma_m=np.full((240, 3), np.nan),
        sequences=clip.sequences,
        **more,
    )
    pairs = tied(world, scene=scene, images=np.arange(200, 240))
    assert (pairs.j >= 200).all()
    i, j, useful = world.useful()
    every_fourth = (i % 4 == 0) | (i >= 200)
    assert found(pairs, (i, j, useful & (j >= 200) & every_fourth))[0] > 0.95


def test_without_words_names_and_chance_must_do() -> None:
    world = shuffled_ring(300)
    recall, precision = found(tied(world, with_words=False), world.useful())
    assert recall > 0.95 and precision > 0.8
    assert world.asked > TUNING.previews_an_image * 300


def test_nothing_to_tie() -> None:
    world = shuffled_ring(12)
    assert len(tied(world, images=np.zeros(0, int))) == 0
    cache = MatchCache(lambda pairs: [Result(0) for _ in pairs], 150)
    words = bags_of_words([np.zeros((0, 128), np.uint8)] * 150, TUNING.retrieval.vocabulary)
    pairs = scored_pairs(photos(150), np.arange(150), cache, SETTINGS, TUNING, words)
    assert len(pairs.kept()) == 0 and len(pairs) < 150 * 10


def test_common_ties_decide_about_faint_pairs() -> None:
    a, b = np.triu_indices(6, 1)
    clique = (a < 5) & (b < 5)
    score = np.where(clique, 40, 0)
    score[(a == 0) & (b == 1)] = 10  # faint between images that tie to the same others
    score[(a == 4) & (b == 5)] = 10  # faint and alone
    kept = supported((a, b), score, 6, 12, TUNING)
    assert kept[clique].all()
    assert not kept[~clique].any()
    assert supported((np.array([0]), np.array([1])), np.array([24]), 2, 12, TUNING)[0]  # two photographs alone


def test_same_result_every_time() -> None:
    one, two = tied(shuffled_ring(130)), tied(shuffled_ring(130))
    assert np.array_equal(one.i, two.i) and np.array_equal(one.j, two.j) and np.array_equal(one.dropped, two.dropped)
