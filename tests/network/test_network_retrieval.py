"""Retrieval: look-alikes, unexpected loops, loose photographs; what a network is written as: tables and pictures."""

import csv
import io
import tracemalloc
import warnings
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pycolmap
import pytest
from matplotlib.figure import Figure
from PIL import Image
from place_world import Places, shuffled_ring, video, words_of

from boat_world import Result, World, boat, found, photos, ring
from network_steps import Steps, context_of, network_of
from tiegraph.network.loose import BagsOfWords, bags_of_words, nearest_images, scored_pairs, supported
from tiegraph.network.network import metres_per_unit, with_bases
from tiegraph.network.passes import MatchCache, find_passes
from tiegraph.network.plots import _aggregated, _joined, _layout, map_png, sections_png, weak_pairs
from tiegraph.network.retrieval import loop_candidates, retrieve
from tiegraph.network.sections import UpLight, find_sections
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.pipeline import network as glue
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.scene.graph import components
from tiegraph.scene.pairs import REASONS, Pairs, PreviewMatches, Visibility
from tiegraph.scene.results import png
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

SETTINGS, TUNING = CandidatesSettings(), Tuning()


def loops(world: Places, known: Pairs | None = None, cache: MatchCache | None = None, tuning: Tuning = TUNING):
    return loop_candidates(context_of(video(len(world)), cache or world.match, tuning=tuning), words_of(world), known)


def far(world: Places, frames: int) -> tuple:
    """Useful pairs that many frames apart."""
    i, j, useful = world.useful()
    return i, j, useful & (j - i >= frames)


@pytest.mark.slow
def test_look_alikes_share_what_they_see() -> None:
    world = shuffled_ring(120)
    index, cosine = nearest_images(world.descriptors(), 10)
    assert index.shape == cosine.shape == (120, 10)
    overlap = world.overlap(np.repeat(np.arange(120), 10), index.ravel())
    assert (overlap >= 0.15).mean() > 0.98
    assert (np.diff(cosine, axis=1) <= 0).all() and cosine.max() < 1
    assert not (index == np.arange(120)[:, None]).any()


@pytest.mark.slow
def test_words_are_the_same_every_time_and_do_not_care_for_order_of_features() -> None:
    descriptors = shuffled_ring(40).descriptors()
    one, two = (nearest_images(descriptors, 5) for _ in range(2))
    assert np.array_equal(one[0], two[0]) and np.array_equal(one[1], two[1])
    words = bags_of_words([np.concatenate([descriptors[0], descriptors[0][::-1]])] * 2 + descriptors)
    assert words.between(np.array([0]), np.array([1]))[0] == pytest.approx(1)


@pytest.mark.slow
def test_blank_images_have_no_look_alikes() -> None:
    blank = np.zeros((0, 128), np.uint8)
    descriptors = [blank, *shuffled_ring(20).descriptors(), blank]
    index, cosine = nearest_images(descriptors, 50)
    assert index.shape == (22, 21) and (index[[0, -1]] == -1).all() and (cosine[[0, -1]] == 0).all()
    assert not np.isin(index, [0, 21]).any()
    assert (nearest_images([blank] * 3, 2)[0] == -1).all()
    assert nearest_images([], 5)[0].shape == (0, 0)
    assert nearest_images(descriptors[1:2], 5)[0].shape == (1, 0)


@pytest.mark.slow
def test_nearest_answers_queries_among_wanted_images() -> None:
    words = bags_of_words(shuffled_ring(60).descriptors())
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
    world = Places(np.arange(200) * 12.0, around=600)
    result = loops(world, tuning=TUNING.model_copy(update={"previews_an_image": 4}))
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


@pytest.mark.slow
def test_scenes_without_passes_or_photographs() -> None:
    world = shuffled_ring(30)
    cache = MatchCache(world.match, 30)
    words = bags_of_words(world.descriptors())
    assert loop_candidates(context_of(photos(30), cache), words).notes == ()
    alone = loop_candidates(context_of(video(2), cache), bags_of_words(world.descriptors()[:2]))
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
        index, _ = nearest_images(descriptors, 20, rounds=1)  # rounds take time alone
        peak.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        rows = np.repeat(np.arange(count), 20)
        assert (world.overlap(rows, index.ravel()) >= 0.1).mean() > 0.9
    assert 1.48 < peak[1] / peak[0] < 1.6


def tied(world: Places, scene: Scene | None = None, images=None) -> Pairs:
    count = len(world)
    chosen = np.arange(count) if images is None else images
    return scored_pairs(context_of(scene or photos(count), world.match), chosen, words_of(world))


@pytest.mark.slow
def test_few_photographs_are_all_previewed() -> None:
    world = shuffled_ring(100)
    recall, precision = found(tied(world), world.useful())
    assert world.asked == 100 * 99 // 2 <= TUNING.free_previews
    assert recall > 0.98 and precision > 0.8


@pytest.mark.slow
@pytest.mark.parametrize("ghosts, least", [(0.0, 0.8), (0.2, 0.5)])
def test_a_ring_of_photographs_needs_few_previews_that_grow_with_them_and_not_with_their_square(ghosts, least) -> None:
    asked = []
    for count in (120, 300) if not ghosts else (300,):
        world = shuffled_ring(count)
        world.ghosts = ghosts
        pairs = tied(world)
        recall, precision = found(pairs, world.useful())
        assert recall > 0.97 and precision > least and world.asked <= TUNING.previews_an_image * count
        assert components(pairs, count).max() == 0 and pairs.from_source("retrieval").all()
        asked.append(world.asked)
    assert asked[-1] < 3.0 * asked[0] or ghosts


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


@pytest.mark.slow
def test_nothing_to_tie() -> None:
    world = shuffled_ring(12)
    assert len(tied(world, images=np.zeros(0, int))) == 0
    cache = MatchCache(lambda pairs: [Result(0) for _ in pairs], 150)
    words = bags_of_words([np.zeros((0, 128), np.uint8)] * 150)
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


@pytest.mark.slow
def test_same_result_every_time() -> None:
    one, two = tied(shuffled_ring(130)), tied(shuffled_ring(130))
    assert np.array_equal(one.i, two.i) and np.array_equal(one.j, two.j) and np.array_equal(one.dropped, two.dropped)


RED, ORANGE = (192, 57, 43), (213, 94, 0)
TUNING_PLOTS = Tuning()


def opened(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def share_of(data: bytes, colour: tuple, reach: int = 8) -> float:
    return float((np.abs(opened(data).astype(int) - np.array(colour)).max(axis=-1) < reach).mean())


@lru_cache(maxsize=1)
def surveyed() -> tuple[World, Steps]:
    world = boat((8, 8), (3.0, 3.0), ring(4))
    brightness = np.where(np.isin(world.step, (3, 4, 5)), 60.0, 150.0)
    return world, network_of(world.scene, world.match, light=brightness)


def positions(world: World) -> np.ndarray:
    out = np.full((world.scene.frames, 3), np.nan)
    out[world.scene.frame] = world.world_from_sensor[:, :3, 3]
    return out


@pytest.mark.slow
def test_pictures_of_a_survey() -> None:
    _, network = surveyed()
    pictures = dict(network.pictures())
    assert {"map", "sections"} == set(pictures)
    for data in pictures.values():
        image = opened(data)
        assert 300 < image.shape[0] < 4000 and 800 < image.shape[1] < 2000


@pytest.mark.slow
def test_maps_without_positions_say_so() -> None:
    pairs = Pairs.make([0, 1, 2, 3], [1, 2, 3, 4], "exhaustive")
    assert share_of(map_png(pairs, None, photos(7)), RED) > 1e-4  # it says that there are no positions
    world, _ = surveyed()
    assert share_of(map_png(Pairs.empty(), None, world.scene), RED) > 1e-4


@pytest.mark.slow
def test_the_map_shows_kinds_and_weak_links() -> None:
    world, network = surveyed()
    plain = map_png(network.pairs, positions(world), network.scene)
    kept = network.pairs.kept()
    ends = [int(np.flatnonzero((world.scene.frame == f) & (world.scene.sensor == 0))[0]) for f in (0, 7)]
    weak = map_png(network.pairs, positions(world), network.scene, weak=[(ends[0], ends[1])])
    assert share_of(plain, ORANGE, 60) > 0.001
    assert share_of(weak, RED, 40) > share_of(plain, RED, 40) + 2e-4
    side = {kind: _aggregated(kept, network.scene, _joined(positions(world)[:, :2], network.scene), kind).pairs
            for kind in ("same camera", "across cameras", "across passes")}  # fmt: skip
    inside = int(np.sum(network.scene.frame[kept.i] == network.scene.frame[kept.j]))
    assert sum(side.values()) + inside == len(kept) and min(side.values()) > 0


@pytest.mark.slow
def test_frames_without_a_position_lie_between_their_neighbours() -> None:
    world, _ = surveyed()
    at = positions(world)
    at[[0, 3]] = np.nan
    place, said = _layout(at, world.scene)
    assert said == "" and np.isnan(place[0]).all()
    assert np.allclose(place[3], positions(world)[3, :2], atol=0.01)


def test_many_frames_become_runs() -> None:
    scene = boat((1200, 900), (0.5, 0.7)).scene
    rank = np.stack([scene.sequence_index, scene.sequence], axis=1).astype(float)
    nodes = _joined(rank, scene)
    assert nodes.frames == 7 and 295 <= len(nodes.place) <= 302
    first = int(np.flatnonzero((scene.sequence_index == 0) & (scene.sequence == 0))[0])
    assert np.allclose(nodes.place[nodes.of_frame[first]], [3.0, 0.0])


def test_weak_links_are_read_from_the_table() -> None:
    names = surveyed()[0].scene.names
    rows = [["single link", f"{names[3]} - {names[40]}", 2, 1], ["joint", names[2], 1, 1], ["camera", "cam0", 4, 0]]
    assert weak_pairs({"columns": [], "rows": rows}, surveyed()[0].scene).tolist() == [[3, 40]]
    assert weak_pairs({}, surveyed()[0].scene).shape == (0, 2)


@pytest.mark.slow
def test_sections_show_every_cue() -> None:
    world, network = surveyed()
    under = np.isin(world.step, (3, 4, 5))
    light = UpLight(np.where(under, 60.0, 150.0), np.where(under, 0.1, 0.8))
    found = find_sections(world.scene, find_passes(world.scene), light, TUNING_PLOTS.sections)
    image = opened(sections_png(world.scene.with_(section=found.of_frame), found.sections, found.cues))
    one = opened(sections_png(world.scene.with_(section=found.of_frame), found.sections, found.cues[:1]))
    assert image.shape[0] > one.shape[0] + 150


@pytest.mark.slow
def test_names_are_no_formulas() -> None:
    figure = Figure(figsize=(2, 2), layout="constrained")
    axes = figure.add_subplot(title="$\\frac{$", ylabel="x^$_$^{{")
    axes.set_xticks([0, 1], ["$\\frac{$", "戻り"])
    axes.plot([0, 1], label="$\\frac{$")
    axes.legend(title="$\\frac{$")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert png(figure)[1:4] == b"PNG"


FOCAL_PX, UNIT_M = 500.0, 4.0  # a unit of the model is 4 m
CAMERA = pycolmap.Camera.create_from_model_name(0, "SIMPLE_PINHOLE", FOCAL_PX, 640, 480)


def wall(sigma_m: float = 0.02) -> tuple[Scene, Visibility]:
    """Four images along x, 2 units apart, that look at a wall 10 units away; first and last share no point."""
    centre = np.stack([2.0 * np.arange(4), np.zeros(4), np.zeros(4)], axis=1)
    wall = np.stack([np.linspace(-3, 9, 121), np.zeros(121), np.full(121, 10.0)], axis=1)
    seen = [np.flatnonzero(np.abs(wall[:, 0] - x) < 2.5) for x in centre[:, 0]]
    start = np.r_[0, np.cumsum([len(s) for s in seen])]
    poses = np.tile(np.eye(4), (4, 1, 1))
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    poses[:, :3, 3] = UNIT_M * centre @ turn.T + [5, 6, 7]
    poses[3] = np.nan  # under the bridge
    rig = Rig("camera", (Sensor("camera", camera=CAMERA),))
    scene = simple_scene(
        rig, [f"{k}.jpg" for k in range(4)], np.arange(4), np.zeros(4), world_from_rig=poses, prior="gnss",
        position_sigma_m=np.where(np.isfinite(poses[:, :3, 3]), sigma_m, np.nan),
    )  # fmt: skip
    return scene, Visibility(start, np.concatenate(seen), wall, centre)


def test_base_distance_over_base_and_sigma_of_pairs():
    scene, visibility = wall()
    pairs = Pairs.make([0, 0, 0, 2], [1, 2, 3, 3], "sequence", score=np.array([100.0, 25, 25, np.nan]))
    found = with_bases(pairs, scene, visibility)
    assert metres_per_unit(scene.measured(), visibility.centre) == pytest.approx(UNIT_M)
    assert found.baseline_m == pytest.approx([8, 16, 24, 8], rel=1e-5), "the fourth image has no position"
    assert found.h_over_b[[0, 1, 3]] == pytest.approx([10.1 / 2, 10.1 / 4, 10.1 / 2], rel=0.02)
    assert np.isnan(found.h_over_b[2]) and np.isnan(found.sigma_m[2:]).all(), "no common point, no matches"
    assert found.sigma_m[:2] == pytest.approx([40.4 / FOCAL_PX / 10, 40.4 / FOCAL_PX / 5], rel=0.02)
    known = with_bases(pairs.with_(baseline_m=np.full(4, 9.0)), scene, visibility)
    assert np.all(known.baseline_m == 9.0), "known by poses"


def test_without_positions_that_tell_the_scale_only_the_ratio_is_known():
    pairs = Pairs.make([0], [1], "sequence", score=np.array([100.0]))
    scene, visibility = wall(sigma_m=50.0)
    nowhere = scene.with_(world_from_rig=np.full((4, 4, 4), np.nan))
    for uncertain in (scene, nowhere, replace(scene, prior="odometry")):
        found = with_bases(pairs, uncertain, visibility)
        assert np.isnan([found.baseline_m[0], found.sigma_m[0]]).all() and np.isfinite(found.h_over_b[0])


@pytest.mark.slow
def test_the_stage_network_writes_them(tmp_path, monkeypatch):
    scene, visibility = wall()
    pairs = Pairs.make([0, 1], [1, 2], "sequence", score=np.array([100.0, 100.0]))
    (tmp_path / "coarse").mkdir()
    (tmp_path / "coarse" / "scene.json").write_text(scene.to_json())
    np.savez(tmp_path / "coarse.npz", **pairs.to_npz())
    np.savez(tmp_path / "coarse" / "matches.npz", **PreviewMatches.empty().to_npz())
    np.savez(tmp_path / "coarse" / "visibility.npz", **visibility.to_npz())
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, 3] = -visibility.centre
    np.savez(tmp_path / "coarse" / "model.npz", cam_from_world=poses)
    monkeypatch.setattr(glue, "up_light", lambda run, scene: UpLight(np.full(len(scene), 99.0)))
    glue.network(Run(tmp_path, Inputs(tmp_path), Settings(), "serial"))
    with (tmp_path / "network.csv").open(newline="") as file:
        row = next(csv.DictReader(file))
    assert float(row["h_over_b"]) == pytest.approx(10.1 / 2, rel=0.02) and float(row["baseline_m"]) == 8
    assert float(row["sigma_m"]) == pytest.approx(40.4 / FOCAL_PX / 10, rel=0.02)
    with np.load(tmp_path / "network.npz") as stored:
        assert np.isfinite(stored["h_over_b"]).all()
