"""Awkward surveys: the ties that exist are found, few false ones, and what is odd is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from place_world import Places, shuffled_ring, video

from boat_world import Result, World, boat, found, photos, quality, ring
from network_steps import Steps, context_of, network_of
from tiegraph.network.retrieval import retrieve
from tiegraph.scene.pairs import REASONS


def tied(world: World, recall: float, precision: float, across: float = 0.0) -> Steps:
    """The network of a survey whose ties are as good as that."""
    network = network_of(world.scene, world.match)
    found = quality(world, network.pairs)
    assert found[0] > recall and found[1] > precision and (found[2] > across or not across)
    return network


def test_one_camera_there_and_back() -> None:
    network = tied(boat((40, 30), (1.0, 1.4), ring(1, up=False)), 0.9, 0.5)
    odd = ("rig", "late", "early", "lack", "missing", "swapped", "turned")
    assert not any(word in note for note in network.notes for word in odd)


@pytest.mark.slow
def test_a_pass_that_stops_half_way() -> None:
    world = boat((24, 24), (1.5, 1.5))
    network = tied(world.only((world.track == 0) | (world.step < 11)), 0.93, 0.5, 0.9)
    assert any("runs back along" in note and "common view: frames" in note for note in network.notes)
    (said,) = (note for note in network.notes if note.startswith("short passes"))
    assert "back1 has 11 frames, the others 24 (last: back1/cam0/0010.jpg)" in said


@pytest.mark.slow
def test_a_camera_that_stopped_recording() -> None:
    world = boat((20, 16), (1.5, 1.9))
    network = tied(world.only((world.scene.sensor != 2) | (world.step < 8)), 0.93, 0.5, 0.9)
    assert {n for n in network.notes if n.startswith("pass ")} == {
        "pass there0: cam2 has 8 of 20 frames, missing: after frame 8 (there0/cam2/0007.jpg)",
        "pass back1: cam2 has 8 of 16 frames, missing: after frame 8 (back1/cam2/0007.jpg)",
    }


@pytest.mark.slow
@pytest.mark.parametrize("late", [2, 6])
def test_cameras_that_did_not_start_together(late) -> None:
    """Camera 2 lags: its k-th image belongs to the rig's frame k - late. The rig is wrong then; the ties are not."""
    world = boat((20, 16), (1.5, 1.9))
    sensor, at = world.scene.sensor, np.arange(len(world.scene))
    for k in np.flatnonzero(sensor == 2):
        source = (sensor == 2) & (world.track == world.track[k]) & (world.step == max(0, world.step[k] - late))
        at[k] = np.flatnonzero(source)[0]
    tied(world.seen_from(at), 0.9, 0.45, 0.9)


@pytest.mark.slow
def test_two_passes_far_apart_are_not_tied_and_have_no_heading() -> None:
    world = boat((20, 20), (1.5, 1.5))
    world.world_from_sensor[world.track == 1, 0, 3] += 500
    network = tied(world, 0.93, 0.5)
    kept = network.pairs.kept()
    assert np.sum(world.of_two_passes(kept.i, kept.j)) < 5
    assert any(note.startswith("the pairs fall into 4 components") for note in network.notes)  # up cameras apart
    assert any("no common view" in note for note in network.notes)
    assert not any("voted by previews" in note for note in network.notes)


def twins() -> tuple[World, np.ndarray]:
    """Two passes, and of each image that of the first which has its camera and its step."""
    world = boat((20, 20), (1.5, 1.5))
    own = list(zip(world.scene.sensor.tolist(), world.step.tolist()))
    first = {key: n for n, key in enumerate(own) if world.track[n] == 0}
    return world, np.array([first[key] for key in own])


@pytest.mark.slow
def test_the_same_pass_twice() -> None:
    world, first = twins()
    network = tied(world.seen_from(first), 0.95, 0.5, 0.95)
    assert any("follows" in note and "about 0 deg" in note for note in network.notes)


def test_a_pass_written_anew_has_no_base() -> None:
    """Other files with the same pictures: nothing moves, every feature is found again."""
    world, twin = twins()
    copy = world.seen_from(twin)
    every = np.repeat(np.arange(90)[:, None], 2, axis=1)

    def match(pairs: np.ndarray) -> list[Result]:
        again = Result(90, np.eye(3), np.zeros(2), every)
        return [again if twin[i] == twin[j] else r for (i, j), r in zip(pairs, copy.match(pairs))]

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
    network = tied(boat((20, 16), (1.5, 1.9), wrong), 0.85, 0.4, 0.85)
    assert any("check the rig file" in note for note in network.notes)


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
    loops = retrieve(replace(context_of(scene, world.match), descriptors=world.descriptors), network.pairs)
    recall, precision = found(network.pairs | loops.pairs, (i, j, useful))
    assert recall > 0.95 and precision > 0.7 and world.asked - asked < 4 * 400
    assert any("see the same place" in note for note in loops.notes)
