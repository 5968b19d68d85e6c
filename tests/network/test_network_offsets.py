"""Offset voting on a synthetic boat survey with exact overlap."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from boat_world import Result, boat, quality, ring
from network_steps import context_of, network_of
from tiegraph import papers
from tiegraph.network.axes import (
    angles_deg,
    direction,
    in_words,
    strangers,
    vertical,
    votes,
    without_chance,
    yaw,
    yaw_between,
)
from tiegraph.network.offsets import OFFSETS, curves_csv, estimate_offsets
from tiegraph.network.passes import MatchCache, find_passes, loose_images
from tiegraph.network.scorematrix import score_matrix
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.papers.meguro2024 import _around
from tiegraph.scene.graph import best_line
from tiegraph.scene.pairs import REASONS

TUNING = Tuning()
papers.plug_in(papers.OFFSETS, "constant", OFFSETS)


def measure(world, settings):
    """Recall, precision, recall between passes, and the network."""
    network = network_of(world.scene, world.match, settings)
    return *quality(world, network.pairs), network


@pytest.mark.slow
def test_default_finds_the_return_pass_at_another_speed() -> None:
    world = boat((24, 15), (1.5, 2.4))
    recall, precision, cross, network = measure(world, CandidatesSettings())
    assert recall > 0.95 and cross > 0.95 and 0.5 < precision < 1.0
    assert world.asked < 0.25 * len(world.scene) ** 2 / 2
    assert any("runs back along" in note and "180" in note for note in network.notes)
    assert (network.pairs.degree(len(world.scene)) > 0).all()


@pytest.mark.slow
def test_constant_offsets_lose_what_local_ones_keep() -> None:
    paper = CandidatesSettings(sources=("sequence", "offsets"), offsets="constant", axes_deg=90, offset_range=3)
    slow = measure(boat((24, 24), (1.5, 1.5)), paper)
    other = measure(boat((24, 12), (1.5, 3.0)), paper)
    ours = measure(boat((24, 12), (1.5, 3.0)), CandidatesSettings())
    assert 0.1 < slow[2] < 0.9 and 0.1 < other[2] < 0.9
    assert ours[0] > other[0] + 0.2 and ours[2] > other[2] + 0.3  # one offset is exact only at equal speed
    reasons = slow[3].pairs.funnel()
    assert reasons["offset"] > 0 and reasons["votes"] > 0 and reasons["axes"] > 0


def test_constant_offsets_stay_in_their_range() -> None:
    world = boat((20, 20), (1.5, 1.5))
    settings = CandidatesSettings(sources=("offsets",), offsets="constant", axes_deg=90, offset_range=2)
    network = network_of(world.scene, world.match, settings)
    best = {(c.pass_a, c.pass_b, c.sensor_a, c.sensor_b): c for c in network.candidates.curves if c.accepted}
    kept = network.pairs.kept()
    label = world.scene.image_label()
    step = world.step
    assert len(kept)
    for i, j in zip(kept.i, kept.j):
        if (label[i][0], label[j][0], label[i][1], label[j][1]) not in best:
            i, j = j, i
        curve = best[label[i][0], label[j][0], label[i][1], label[j][1]]
        offset = step[j] + step[i] if curve.reversed else step[j] - step[i]
        assert abs(offset - curve.best) <= 2
    assert {c.reversed for c in network.candidates.curves if c.pass_a != c.pass_b} == {True}
    rows = list(csv.DictReader(io.StringIO(curves_csv(network.candidates.curves))))
    assert len(rows) == sum(len(c.offsets) for c in network.candidates.curves)
    for (pass_a, pass_b, sensor_a, sensor_b), curve in best.items():
        ends = {"pass1": pass_a, "camera1": sensor_a, "pass2": pass_b, "camera2": sensor_b}
        own = [r for r in rows if ends.items() <= r.items()]
        assert {r["accepted"] for r in own} == {"1"} and {r["direction"] for r in own} <= {"back", "same"}
        assert [int(r["offset"]) for r in own if r["best"] == "1"] == [curve.best]
        assert [float(r["votes"]) for r in own] == pytest.approx(curve.votes.tolist(), rel=1e-5)


@pytest.mark.slow
def test_paper_000_keeps_the_best_partner_of_each_camera() -> None:
    world = boat((16, 16), (1.5, 1.5))
    settings = CandidatesSettings(sources=("offsets",), offsets="constant", axes_deg=90, offset_range=4, offset_best=1)
    network = network_of(world.scene, world.match, settings)
    kept = network.pairs.kept()
    assert len(kept) and (kept.score >= settings.min_matches).all()
    cameras = len(world.scene.rigs[0].sensors)
    assert len(kept) <= len(world.scene) * 2 * cameras and network.pairs.funnel()["weak"] > 0


def test_of_the_partners_around_an_offset_the_best_ones_are_kept() -> None:
    """``offset_best`` of each image and camera pair; those of too few matches are none."""
    world = boat((16, 16), (1.5, 1.5))
    p, q = find_passes(world.scene)
    settings = CandidatesSettings(offsets="constant", offset_range=4, min_matches=40)
    cache = MatchCache(world.match, len(world.scene))
    scores = score_matrix(p, q, 1, np.ones((5, 5), bool), TUNING.offsets)
    step, every = world.step, _around(scores, (1, 3), 15, True, cache, settings)
    assert set(step[every.i] + step[every.j] - 15) == set(range(-4, 5))
    for best in (1, 2):
        chosen = settings.model_copy(update={"offset_best": best})
        pairs = _around(scores, (1, 3), 15, True, cache, chosen)
        image, partner = np.where(np.isin(pairs.i, p.images[1]), (pairs.i, pairs.j), (pairs.j, pairs.i))
        assert len(np.unique(image)) == 16 and np.isin(partner, q.images[3]).all()
        for k in np.unique(image):
            here = image == k
            ranked = np.sort(pairs.score[here])[::-1]
            enough = ranked[: min(best, int(np.sum(ranked >= 40)))]
            np.testing.assert_array_equal(np.sort(pairs.score[here & (pairs.dropped == 0)])[::-1], enough)


def test_axes_that_forbid_a_match_are_previewed_only_to_check_the_rig() -> None:
    world = boat((10,), (2.0,))
    world.pairs_asked = set()
    _, _, _, network = measure(world, CandidatesSettings(axes_deg=100))
    angle = world.scene.rigs[0].axis_angles_deg()
    sensor, frame = world.scene.sensor, world.scene.frame
    forbidden = [(i, j) for i, j in world.pairs_asked if angle[sensor[i], sensor[j]] > 100]
    assert len(forbidden) == 5 * 10 and all(frame[i] == frame[j] for i, j in forbidden)
    rejected = network.pairs.where(network.pairs.dropped == REASONS.index("axes"))
    assert len(rejected) == 5 * 10 * 10  # five camera pairs of the ring look 144 degrees apart
    assert np.isfinite(rejected.score).sum() == len(forbidden)


def test_single_pass_and_unknown_rig_work() -> None:
    world = boat((20,), (1.5,))
    bare = tuple(replace(s, sensor_from_rig=None) for s in world.scene.rigs[0].sensors)
    world.scene = world.scene.with_(rigs=(replace(world.scene.rigs[0], sensors=bare),))
    recall, precision, _, network = measure(world, CandidatesSettings())
    assert recall > 0.95 and precision > 0.4 and not any("runs back" in n for n in network.notes)


@pytest.mark.slow
def test_missing_images_and_frames_are_no_obstacle() -> None:
    world = boat((16, 16), (1.5, 1.5))
    keep = np.random.default_rng(0).random(len(world.scene)) > 0.15
    keep[world.scene.frame == 5] = False
    world = world.only(keep)
    recall, _, _, network = measure(world, CandidatesSettings())
    assert recall > 0.9 and network.pairs.j.max() < keep.sum()


@pytest.mark.slow
def test_result_does_not_depend_on_how_often_it_is_asked() -> None:
    one, two = (measure(boat((12, 9), (2.0, 2.6)), CandidatesSettings())[3] for _ in range(2))
    for name in one.pairs.columns():
        assert np.array_equal(getattr(one.pairs, name), getattr(two.pairs, name), equal_nan=True)


@pytest.mark.slow
def test_four_thousand_images_need_few_previews() -> None:
    world = boat((335, 250), (0.5, 0.67))
    n = len(world.scene)
    network = network_of(world.scene, world.match, CandidatesSettings())
    rng = np.random.default_rng(1)
    i, j = rng.integers(0, n, 60000), rng.integers(0, n, 60000)
    i, j = i[i < j], j[i < j]
    useful = np.maximum(world.overlap(i, j), world.overlap(j, i)) >= 0.15
    kept = network.pairs.kept()
    hit = np.isin(i * n + j, kept.i.astype(np.int64) * n + kept.j)
    assert (hit & useful).sum() / useful.sum() > 0.95
    assert 0.002 < world.asked / (n * (n - 1) / 2) < 0.03
    assert not np.any(network.pairs.dropped == REASONS.index("axes"))
    assert any("not matched" in note for note in network.notes)
    assert len(network.pairs) < 200 * n  # rows of the table, dropped ones too: bounded by the image


@pytest.mark.slow
def test_pairs_and_previews_grow_with_the_images_and_not_with_their_square() -> None:
    rows, asked = [], []
    for frames in (80, 240):
        world = boat((frames, frames), (1.0, 1.0), ring(3, up=False))
        context = context_of(world.scene, world.match)
        rows.append(len(estimate_offsets(context).pairs) / len(world.scene))
        asked.append(len(context.cache) / len(world.scene))
    assert 0.5 < rows[1] / rows[0] < 1.3 and asked[1] / asked[0] < 1.3


def test_a_coarser_lattice_looks_no_further_from_the_path() -> None:
    """Out of its budget of previews the lattice takes every second frame, and still as many frames beside the path."""
    world = boat((160,), (1.0,), ring(3, up=False))
    step = world.step

    def match(pairs: np.ndarray) -> list[Result]:
        apart = np.abs(step[pairs[:, 0]] - step[pairs[:, 1]])
        return [Result(30 if a <= 12 else 9) for a in apart]

    furthest, previews = [], []
    for budget in (1000, 2):
        offsets = TUNING.offsets.model_copy(update={"min_budget": 0})
        tuning = TUNING.model_copy(update={"offsets": offsets, "previews_an_image": budget})
        context = context_of(world.scene, match, tuning=tuning)
        kept = estimate_offsets(context).pairs.kept()
        furthest.append(np.abs(step[kept.i] - step[kept.j]).max())
        previews.append(len(context.cache))
    assert previews[1] < previews[0] and 12 <= furthest[1] <= 1.3 * furthest[0]


def test_chance_gives_neither_heading_nor_direction() -> None:
    world = boat((20, 20), (1.5, 1.5))
    p, q = find_passes(world.scene)
    scores = score_matrix(p, q, 2, np.ones((6, 6), bool), TUNING.offsets)
    rng = np.random.default_rng(3)
    few = np.zeros(scores.inliers.shape)
    few[tuple(rng.integers(0, n, 6) for n in few.shape)] = 1.0
    assert votes(few) == pytest.approx(6) and votes(np.zeros(3)) == 0
    assert yaw(scores, few, TUNING.rig) is None and in_words(scores, few, TUNING.rig) == ""
    smooth = np.full(few.shape, 8.0, np.float32)
    smooth[0, 0, 0, :3] = 20
    measured = replace(scores, inliers=smooth)
    assert without_chance(measured, smooth, 12, TUNING).max() == pytest.approx(8)
    smooth[1, 1, 0, :3] = 20
    assert without_chance(measured, smooth, 12, TUNING) is smooth
    back = np.zeros(few.shape)
    for c, d in [(0, 2), (0, 3), (1, 3), (1, 4), (2, 0), (3, 0)]:
        back[c, d, np.arange(10), 9 - np.arange(10)] = 1.0
    assert direction(scores, back, TUNING.rig.common_view) == (True, True)
    said = in_words(scores, back, TUNING.rig)
    assert "runs back along" in said and "turned by about" in said and "common view" not in said
    back[:, :, 5:] = 0
    assert "common view: frames 1 to 9 of 20" in in_words(scores, back, TUNING.rig)


def test_couples_of_passes_without_common_view_are_one_note() -> None:
    assert strangers([]) == ()
    (note,) = strangers([f"a - b{k}" for k in range(20)])
    assert note.startswith("no common view was found: a - b0, a - b1")
    assert note.endswith("and 12 more pairs of passes")


def test_yaw_and_vertical_of_a_ring() -> None:
    rig = ring()
    assert np.allclose(vertical(rig), (0, -1, 0))
    evidence = np.zeros((6, 6))
    evidence[0, 2] = evidence[0, 3] = evidence[1, 3] = evidence[1, 4] = 1.0
    assert yaw_between(rig, evidence) == pytest.approx(180, abs=12)
    assert yaw_between(rig, np.eye(6)) == pytest.approx(0, abs=12)
    assert yaw_between(rig, np.zeros((6, 6))) is None
    assert np.allclose(np.diag(angles_deg(rig, 180))[:5], 180)
    turned = np.array([-np.sin(np.radians(72)), 0, np.cos(np.radians(72))])  # the first axis, z, about -y by 72 degrees
    axes = np.array([s.optical_axis() for s in rig.sensors])
    assert np.allclose(angles_deg(rig, 72)[:, 0], np.degrees(np.arccos(np.clip(axes @ turned, -1, 1))))


def test_book_asks_each_pair_once() -> None:
    world = boat((6,), (2.0,))
    cache = MatchCache(world.match, len(world.scene))
    i, j = np.array([3, 1, 3, 5]), np.array([1, 3, 9, 4])
    first = cache.measure(i, j)
    assert world.asked == 3 and len(cache) == 3
    assert np.array_equal(cache.measure(j, i), first) and world.asked == 3
    assert np.isnan(cache.known(np.array([0]), np.array([2]))) and first[0] == first[1]


def test_passes_of_two_rigs_on_one_track_are_two() -> None:
    world = boat((4,), (2.0,))
    assert len(find_passes(world.scene)) == 1
    rigs = (world.scene.rigs[0], world.scene.rigs[0])
    scene = world.scene.with_(rigs=rigs, rig=np.array([0, 1, 0, 1]))
    passes = find_passes(scene)
    assert [len(p) for p in passes] == [2, 2] and passes[0].name != passes[1].name
    loose = scene.with_(sequence=np.array([0, 0, -1, -1]))
    assert set(scene.frame[loose_images(loose)]) == {2, 3}


def test_the_path_between_passes_goes_by_a_lone_peak() -> None:
    rows, columns = np.mgrid[:20, :30]
    evidence = 10 * np.exp(-(((columns - rows - 4) / 2.0) ** 2))
    evidence[10, 28] = 14.0
    assert np.abs(best_line(evidence, 0.02 * evidence.max()) - (np.arange(20) + 4)).max() <= 1
