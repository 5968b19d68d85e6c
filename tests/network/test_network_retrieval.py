"""Retrieval: look-alikes by visual words, loops nobody expects, and what ties loose photographs."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from place_world import Places, shuffled_ring, video, words_of

from boat_world import Result, boat, found, photos
from network_steps import context_of
from tiegraph.network.loose import BagsOfWords, bags_of_words, nearest_images, scored_pairs, supported
from tiegraph.network.passes import MatchCache
from tiegraph.network.retrieval import loop_candidates, retrieve
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import LoopSearchTuning, Tuning
from tiegraph.scene.graph import components
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

SETTINGS, TUNING = CandidatesSettings(), Tuning()
WORDS = TUNING.retrieval.vocabulary


def loops(world: Places, known: Pairs | None = None, cache: MatchCache | None = None, tuning: Tuning = TUNING):
    return loop_candidates(context_of(video(len(world)), cache or world.match, tuning=tuning), words_of(world), known)


def far(world: Places, frames: int) -> tuple:
    """Useful pairs that many frames apart."""
    i, j, useful = world.useful()
    return i, j, useful & (j - i >= frames)


def test_look_alikes_share_what_they_see() -> None:
    world = shuffled_ring(120)
    index, cosine = nearest_images(world.descriptors(), 10, WORDS)
    assert index.shape == cosine.shape == (120, 10)
    overlap = world.overlap(np.repeat(np.arange(120), 10), index.ravel())
    assert (overlap >= 0.15).mean() > 0.98
    assert (np.diff(cosine, axis=1) <= 0).all() and cosine.max() < 1
    assert not (index == np.arange(120)[:, None]).any()


def test_words_are_the_same_every_time_and_do_not_care_for_order_of_features() -> None:
    descriptors = shuffled_ring(40).descriptors()
    one, two = (nearest_images(descriptors, 5, WORDS) for _ in range(2))
    assert np.array_equal(one[0], two[0]) and np.array_equal(one[1], two[1])
    words = bags_of_words([np.concatenate([descriptors[0], descriptors[0][::-1]])] * 2 + descriptors, WORDS)
    assert words.between(np.array([0]), np.array([1]))[0] == pytest.approx(1)


def test_blank_images_have_no_look_alikes() -> None:
    blank = np.zeros((0, 128), np.uint8)
    descriptors = [blank, *shuffled_ring(20).descriptors(), blank]
    index, cosine = nearest_images(descriptors, 50, WORDS)
    assert index.shape == (22, 21) and (index[[0, -1]] == -1).all() and (cosine[[0, -1]] == 0).all()
    assert not np.isin(index, [0, 21]).any()
    assert (nearest_images([blank] * 3, 2, WORDS)[0] == -1).all()
    assert nearest_images([], 5, WORDS)[0].shape == (0, 0)
    assert nearest_images(descriptors[1:2], 5, WORDS)[0].shape == (1, 0)


def test_nearest_answers_queries_among_wanted_images() -> None:
    words = bags_of_words(shuffled_ring(60).descriptors(), WORDS)
    everyone, _ = words.nearest(59)
    some = np.array([7, 3])
    assert np.array_equal(words.nearest(4, some)[0], everyone[some, :4])
    even, _ = words.nearest(5, some, lambda rows: np.broadcast_to(np.arange(60) % 2 == 0, (len(rows), 60)))
    assert (even[even >= 0] % 2 == 0).all() and (even[:, 0] >= 0).all()
    first = BagsOfWords(words.weights).among(np.arange(10))
    assert len(first) == 10 and first.between(np.array([1]), np.array([2])) == words.between([1], [2])


@pytest.mark.slow
@pytest.mark.parametrize("ghosts", [0.0, 0.2])
def test_a_video_that_comes_back_is_tied_to_its_start(ghosts) -> None:
    world = Places(np.arange(400) * 12.0, around=3600, ghosts=ghosts)
    result = loops(world)
    recall, precision = found(result.pairs, far(world, 100))
    assert recall > 0.95 and precision > 0.8 and world.asked < 5 * len(world)
    assert len(result.notes) == 1
    assert "clip frames 0.." in result.notes[0] and "..398 see the same place" in result.notes[0]
    assert result.pairs.from_source("retrieval").all()


@pytest.mark.slow
def test_a_slow_video_is_sampled_and_the_frames_between_are_filled() -> None:
    world = Places(np.arange(400) * 4.0, around=1200)
    result = loops(world)
    recall, precision = found(result.pairs, far(world, 100))
    assert recall > 0.9 and precision > 0.75 and world.asked < len(world)
    assert len(result.pairs.kept()) > 5 * world.asked


@pytest.mark.slow
def test_single_false_look_alikes_are_not_believed() -> None:
    world = Places(np.arange(300) * 12.0, ghosts=0.2)
    result = loops(world)
    assert len(result.pairs.kept()) == 0 and np.mean(result.pairs.score >= 15) > 0.15
    assert (result.pairs.dropped == REASONS.index("weak")).all()
    assert "no loops: none of" in result.notes[0]


@pytest.mark.slow
def test_known_loops_are_not_looked_at_again() -> None:
    world = Places(np.arange(400) * 12.0, around=3600)
    i, j, useful = far(world, 100)
    result = loops(world, Pairs.make(i[useful], j[useful], "offsets"))
    assert len(result.pairs.kept()) == 0
    overlap = world.overlap(result.pairs.i, result.pairs.j)
    assert not (overlap >= 0.15).any()


@pytest.mark.slow
def test_budget_of_previews_is_kept_and_said() -> None:
    looks = TUNING.retrieval.model_copy(update={"loops": LoopSearchTuning(previews_an_image=4)})
    world = Places(np.arange(200) * 12.0, around=600)
    result = loops(world, tuning=TUNING.model_copy(update={"retrieval": looks}))
    assert world.asked <= 4 * 200
    assert any("budget of previews was spent" in note for note in result.notes)


@pytest.mark.slow
def test_the_return_pass_of_a_rig_is_found_without_any_order() -> None:
    survey = boat((14, 10), (2.0, 2.8))
    count = len(survey.scene)
    words = _words_by(survey, count)
    result = loop_candidates(context_of(survey.scene, survey.match), words)
    recall, precision = found(result.pairs, survey.across())
    assert recall > 0.6 and precision > 0.6 and survey.asked < 16 * count


def _words_by(survey, count: int) -> BagsOfWords:
    """Words that are as alike as the images overlap: rows of a matrix with the overlaps as products, nearly."""
    from scipy.sparse import csr_array

    i, j = np.indices((count, count)).reshape(2, -1)
    share = np.maximum(survey.overlap(i, j), survey.overlap(j, i)).reshape(count, count)
    np.fill_diagonal(share, 1)
    rows = share / np.linalg.norm(share, axis=1, keepdims=True)
    return BagsOfWords(csr_array(rows.astype(np.float32)))


def test_scenes_without_passes_or_photographs() -> None:
    world = shuffled_ring(30)
    cache = MatchCache(world.match, 30)
    words = bags_of_words(world.descriptors(), WORDS)
    assert loop_candidates(context_of(photos(30), cache), words).notes == ()
    alone = loop_candidates(context_of(video(2), cache), bags_of_words(world.descriptors()[:2], WORDS))
    assert len(alone.pairs) == 0
    result = retrieve(replace(context_of(photos(30), cache), descriptors=world.descriptors))
    assert found(result.pairs, world.useful())[0] == 1 and "30 loose photographs" in result.notes[0]
    clip = video(30)
    moving = retrieve(replace(context_of(clip, world.match), descriptors=world.descriptors))
    assert all("loose" not in note for note in moving.notes)


@pytest.mark.slow
def test_many_images_are_looked_up_in_linear_memory() -> None:
    """Twice the images take half as much memory again, for the words are as many: a table of all pairs, at four bytes
    each, would add 7 %."""
    peak = []
    for count in (750, 1500):
        world = Places(np.arange(count) * 12.0, around=3 * count)
        descriptors = world.descriptors()
        tracemalloc.start()
        index, _ = nearest_images(descriptors, 20, WORDS.model_copy(update={"rounds": 1}))  # rounds take time alone
        peak.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        rows = np.repeat(np.arange(count), 20)
        assert (world.overlap(rows, index.ravel()) >= 0.1).mean() > 0.9
    assert 1.48 < peak[1] / peak[0] < 1.6


LOOSE = TUNING.retrieval.loose


def tied(world: Places, with_words: bool = True, scene: Scene | None = None, images=None) -> Pairs:
    count = len(world)
    words = words_of(world) if with_words else None
    chosen = np.arange(count) if images is None else images
    return scored_pairs(context_of(scene or photos(count), world.match), chosen, words)


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
    assert recall > 0.97 and precision > least and world.asked <= TUNING.previews_an_image * 300
    assert components(pairs, 300).max() == 0 and pairs.from_source("retrieval").all()


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
    names = [*video(200).names, *(f"img_{k:03d}.jpg" for k in range(40))]
    track, step = np.r_[np.zeros(200), np.full(40, -1)], np.r_[np.arange(200), np.zeros(40)]
    rig, every = Rig("camera", (Sensor("camera"),)), np.arange(240)
    scene = simple_scene(rig, names, every, 0 * every, track, step, sequences=("clip",))
    pairs = tied(world, scene=scene, images=np.arange(200, 240))
    assert (pairs.j >= 200).all()
    i, j, useful = world.useful()
    every_fourth = (i % 4 == 0) | (i >= 200)
    assert found(pairs, (i, j, useful & (j >= 200) & every_fourth))[0] > 0.95


def test_without_words_names_and_chance_must_do() -> None:
    world = shuffled_ring(300)
    recall, precision = found(tied(world, with_words=False), world.useful())
    assert recall > 0.95 and precision > 0.8 and world.asked > TUNING.previews_an_image * 300


def test_nothing_to_tie() -> None:
    world = shuffled_ring(12)
    assert len(tied(world, images=np.zeros(0, int))) == 0
    cache = MatchCache(lambda pairs: [Result(0) for _ in pairs], 150)
    words = bags_of_words([np.zeros((0, 128), np.uint8)] * 150, TUNING.retrieval.vocabulary)
    pairs = scored_pairs(context_of(photos(150), cache), np.arange(150), words)
    assert len(pairs.kept()) == 0 and len(pairs) < 150 * 10


def test_common_ties_decide_about_faint_pairs() -> None:
    a, b = np.triu_indices(6, 1)
    clique = (a < 5) & (b < 5)
    score = np.where(clique, 40, 0)
    score[(a == 0) & (b == 1)] = 10  # faint between images that tie to the same others
    score[(a == 4) & (b == 5)] = 10  # faint and alone
    kept = supported((a, b), score, 6, 12, TUNING)
    assert kept[clique].all() and not kept[~clique].any()
    assert supported((np.array([0]), np.array([1])), np.array([24]), 2, 12, TUNING)[0]  # two photographs alone


def test_same_result_every_time() -> None:
    one, two = tied(shuffled_ring(130)), tied(shuffled_ring(130))
    assert np.array_equal(one.i, two.i) and np.array_equal(one.j, two.j) and np.array_equal(one.dropped, two.dropped)
