"""Awkward surveys: the ties that exist are found, few false ones, and what is odd is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from place_world import Places, shuffled_ring, video

from boat_world import Result, World, boat, found, photos, quality, ring
from network_steps import network_of
from tiegraph.network.passes import MatchCache, find_passes
from tiegraph.network.retrieval.retrieval import retrieve
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.pairs import REASONS


def test_one_camera_there_and_back() -> None:
    world = boat((40, 30), (1.0, 1.4), ring(1, up=False))
    network = network_of(world.scene, world.match)
    recall, precision, _ = quality(world, network.pairs)
    assert recall > 0.9 and precision > 0.5
    odd = ("rig", "late", "early", "lack", "missing", "swapped", "turned")
    assert not any(word in note for note in network.notes for word in odd)


@pytest.mark.slow
def test_a_pass_that_stops_half_way() -> None:
    world = boat((24, 24), (1.5, 1.5))
    step, track = world.scene.sequence_index[world.scene.frame], world.scene.sequence[world.scene.frame]
    short = world.only((track == 0) | (step < 11))
    network = network_of(short.scene, short.match)
    recall, precision, across = quality(short, network.pairs)
    assert recall > 0.93 and across > 0.9 and precision > 0.5
    assert any("runs back along" in note and "common view: frames" in note for note in network.notes)
    said = [note for note in network.notes if note.startswith("short passes")]
    assert len(said) == 1 and "back1 has 11 frames, the others 24 (last: back1/cam0/0010.jpg)" in said[0]


@pytest.mark.slow
def test_a_camera_that_stopped_recording() -> None:
    world = boat((20, 16), (1.5, 1.9))
    lost = (world.scene.sensor == 2) & (world.scene.sequence_index[world.scene.frame] >= 8)
    short = world.only(~lost)
    network = network_of(short.scene, short.match)
    recall, precision, across = quality(short, network.pairs)
    assert recall > 0.93 and across > 0.9 and precision > 0.5
    assert {n for n in network.notes if n.startswith("pass ")} == {
        "pass there0: cam2 has 8 of 20 frames, missing: after frame 8 (there0/cam2/0007.jpg)",
        "pass back1: cam2 has 8 of 16 frames, missing: after frame 8 (back1/cam2/0007.jpg)",
    }


@pytest.mark.slow
@pytest.mark.parametrize("late", [2, 6])
def test_cameras_that_did_not_start_together(late) -> None:
    """Camera 2 lags: its k-th image belongs to the rig's frame k - late. The rig is wrong then; the ties are not."""
    world = boat((20, 16), (1.5, 1.9))
    scene = world.scene
    step, track = scene.sequence_index[scene.frame], scene.sequence[scene.frame]
    at = np.arange(len(scene))
    for k in np.flatnonzero(scene.sensor == 2):
        source = (scene.sensor == 2) & (track == track[k]) & (step == max(0, step[k] - late))
        at[k] = np.flatnonzero(source)[0]
    lagging = world.seen_from(at)
    recall, precision, across = quality(lagging, network_of(lagging.scene, lagging.match).pairs)
    assert recall > 0.9 and across > 0.9 and precision > 0.45


@pytest.mark.slow
def test_two_passes_far_apart_are_not_tied_and_have_no_heading() -> None:
    world = boat((20, 20), (1.5, 1.5))
    away = world.scene.sequence[world.scene.frame] == 1
    poses = world.world_from_sensor.copy()
    poses[away, 0, 3] += 500
    world = World(world.scene, poses)
    network = network_of(world.scene, world.match)
    recall, precision, _ = quality(world, network.pairs)
    kept = network.pairs.kept()
    track = world.scene.sequence[world.scene.frame]
    assert recall > 0.93 and precision > 0.5 and np.sum(track[kept.i] != track[kept.j]) < 5
    assert any(note.startswith("the pairs fall into 4 components") for note in network.notes)  # up cameras apart
    assert any("no common view" in note for note in network.notes)
    assert not any("voted by previews" in note for note in network.notes)


def twins() -> tuple[World, np.ndarray]:
    """Two passes, and of each image that of the first which has its camera and its step."""
    world = boat((20, 20), (1.5, 1.5))
    scene = world.scene
    step, track = scene.sequence_index[scene.frame], scene.sequence[scene.frame]
    table = {(int(s), int(k)): n for n, (s, k, t) in enumerate(zip(scene.sensor, step, track)) if t == 0}
    return world, np.array([table[int(s), int(k)] for s, k in zip(scene.sensor, step)])


@pytest.mark.slow
def test_the_same_pass_twice() -> None:
    world, first = twins()
    twin = world.seen_from(first)
    network = network_of(twin.scene, twin.match)
    recall, precision, across = quality(twin, network.pairs)
    assert recall > 0.95 and across > 0.95 and precision > 0.5
    assert any("follows" in note and "about 0 deg" in note for note in network.notes)


def test_a_pass_written_anew_has_no_base() -> None:
    """Other files with the same pictures: nothing moves, every feature is found again."""
    world, twin = twins()
    copy = world.seen_from(twin)
    every = np.repeat(np.arange(90)[:, None], 2, axis=1)

    def match(pairs: np.ndarray) -> list[Result]:
        plain = copy.match(pairs)
        return [
            Result(90, np.eye(3), np.zeros(2), every) if twin[i] == twin[j] else r
            for (i, j), r in zip(pairs.tolist(), plain)
        ]

    network = network_of(world.scene, match)
    assert any("repeats pass" in n and "120 of 120 images show the same picture" in n for n in network.notes)
    pairs = network.pairs
    same = twin[pairs.i] == twin[pairs.j]
    assert same.sum() == 120 and set(pairs.dropped[same]) == {REASONS.index("similar")}
    assert not np.any(pairs.dropped[~same] == REASONS.index("similar"))


@pytest.mark.parametrize("order", [[0, 2, 1, 3, 4, 5], [0, 2, 4, 1, 3, 5]])
def test_a_rig_file_with_cameras_in_another_order_is_called_wrong_and_loses_few_ties(order) -> None:
    rig = ring()
    poses = [rig.sensors[k].sensor_from_rig for k in order]
    wrong = replace(rig, sensors=tuple(replace(s, sensor_from_rig=p) for s, p in zip(rig.sensors, poses)))
    world = boat((20, 16), (1.5, 1.9), wrong)
    network = network_of(world.scene, world.match)
    assert any("check the rig file" in note for note in network.notes)
    recall, precision, across = quality(world, network.pairs)
    assert recall > 0.85 and across > 0.85 and precision > 0.4


@pytest.mark.slow
def test_photographs_on_a_ring() -> None:
    world = shuffled_ring(300)
    network = network_of(photos(300), world.match)
    recall, precision = found(network.pairs, world.useful())
    assert recall > 0.95 and precision > 0.8
    assert not any("components" in note or "no pair" in note for note in network.notes)


def test_photographs_of_two_places_are_named_as_two() -> None:
    order = np.random.default_rng(2).permutation(150)
    world = Places(np.where(order < 75, order * 12.0, 50_000 + order * 12.0))
    network = network_of(photos(150), world.match)
    assert found(network.pairs, world.useful())[0] > 0.95
    assert any("the pairs fall into 2 components: 75 images with" in note for note in network.notes)


@pytest.mark.slow
def test_a_video_with_a_loop_is_closed_by_retrieval() -> None:
    world, scene = Places(np.arange(400) * 12.0, around=3600, ghosts=0.05), video(400)
    network = network_of(scene, world.match)
    i, j, useful = world.useful()
    assert found(network.pairs, (i, j, useful & (j - i < 100)))[0] > 0.95
    asked = world.asked
    cache = MatchCache(world.match, 400)
    loops = retrieve(
        scene, find_passes(scene), cache, CandidatesSettings(), Tuning(), world.descriptors, known=network.pairs
    )
    recall, precision = found(network.pairs | loops.pairs, (i, j, useful))
    assert recall > 0.95 and precision > 0.7 and world.asked - asked < 4 * 400
    assert any("see the same place" in note for note in loops.notes)
