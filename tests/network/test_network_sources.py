"""Pair sources, loose photographs, what is chosen by itself, and awkward surveys: the ties that exist are found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from place_world import Places, video

from boat_world import Result, World, boat, found, photos, quality, ring
from network_steps import Steps, context_of, network_of
from tiegraph.errors import InputError, SettingsError
from tiegraph.network import network
from tiegraph.network.candidates import Context, exhaustive, sequence, shown_order
from tiegraph.network.passes import find_passes
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.pairs import REASONS, Pairs, pair_lines, read_pair_list
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Dropped, Scene, simple_scene


def context(scene: Scene, settings: CandidatesSettings) -> Context:
    return context_of(scene, lambda pairs: [Result(0)] * len(pairs), settings)


def write(folder: Path, text: str) -> Path:
    path = folder / "pairs.txt"
    path.write_text(text)
    return path


def test_pair_list_is_read_and_oddities_are_counted(tmp_path) -> None:
    text = "# made by hand\n000.jpg 002.jpg\n\n002.jpg 000.jpg # again\n001.jpg 001.jpg\n"
    pairs, notes = read_pair_list(write(tmp_path, text + "003.jpg  001.jpg\n"), photos(4))
    assert list(zip(pairs.i.tolist(), pairs.j.tolist())) == [(0, 2), (1, 3)]
    assert "1 self pairs (line 5), 1 repeated pairs (line 4)" in notes[0]


@pytest.mark.parametrize(
    "text, parts",
    [
        ("000.jpg 001.jpg\n000.jpg imgg_03.jpg\n", ["pairs.txt, line 2", "'imgg_03.jpg'", "perhaps"]),
        ("000.jpg\n", ["line 1", "two image names"]),
        ("000.jpg 001.jpg 3\n", ["line 1", "3 words"]),
        ("# nothing\n", ["no pairs"]),
        ("\n001.jpg 001.jpg\n002.jpg 002.jpg\n", ["line 2", "its 2 lines", "themselves"]),
        ("000.jpg img\0_1\n", ["pairs.txt: is no text"]),
        ("000.jpg broken.jpg\n", ["left out by scan: truncated"]),
    ],
)  # fmt: skip
def test_bad_pair_lists_name_file_line_and_name(tmp_path, text, parts) -> None:
    scene = photos(4).with_(dropped=(Dropped("broken.jpg", "truncated"),))
    with pytest.raises(InputError) as error:
        read_pair_list(write(tmp_path, text), scene)
    for part in parts:
        assert part in str(error.value)


def test_missing_pair_list_and_unknown_source_are_errors(tmp_path) -> None:
    with pytest.raises(ValueError):
        CandidatesSettings(sources=("offset",))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="cannot be read"):
        read_pair_list(tmp_path / "none.txt", photos(3))
    with pytest.raises(SettingsError, match="pairs_file"):
        network_of(photos(3), lambda p: [], CandidatesSettings(sources=("file",)))


def test_pair_list_as_only_source_previews_nothing(tmp_path) -> None:
    path = write(tmp_path, "000.jpg 001.jpg\n")
    settings = CandidatesSettings(sources=("file",), pairs_file=path)
    network = network_of(photos(4), lambda p: pytest.fail("asked"), settings)
    assert len(network.pairs.kept()) == 1
    assert any("2 images have no pair: 002.jpg, 003.jpg" in n for n in network.notes)


def test_sequence_ties_the_next_frames_of_each_camera() -> None:
    world = boat((6, 5), (2.0, 2.0))
    plain = sequence(context(world.scene, CandidatesSettings(sequence_frames=2))).pairs
    step, key = world.scene.sequence_index[world.scene.frame], world.scene.sensor_key
    assert len(plain) == 6 * (5 + 4) + 6 * (4 + 3)
    assert (key[plain.i] == key[plain.j]).all() and (np.abs(step[plain.i] - step[plain.j]) <= 2).all()
    wider = CandidatesSettings(sequence_frames=1, sequence_cameras=True, axes_deg=80)
    wide = sequence(context(world.scene, wider)).pairs
    across = wide.where(key[wide.i] != key[wide.j])
    angle = world.scene.rigs[0].axis_angles_deg()
    assert len(across) and angle[world.scene.sensor[across.i], world.scene.sensor[across.j]].max() < 80
    nothing = sequence(context(photos(3), CandidatesSettings()))
    assert len(nothing.pairs) == 0 and nothing.notes


def test_sequence_bridges_a_lost_image() -> None:
    rig = Rig("camera", (Sensor("camera"),))
    scene = simple_scene(rig, ["a.jpg", "c.jpg"], np.array([0, 1]), np.zeros(2), np.zeros(2), np.array([0, 2]))
    assert len(sequence(context(scene, CandidatesSettings(sequence_frames=1))).pairs) == 1


def test_few_photographs_are_compared_with_one_another() -> None:
    network = network_of(photos(11), lambda p: [Result(0)] * len(p))
    assert len(network.pairs.kept()) == 55  # whatever the previews say
    assert len(exhaustive(context(photos(11), CandidatesSettings())).pairs) == 55
    assert "sources chosen: exhaustive" in network.notes


def test_nothing_matches_at_all_is_said_and_not_fatal() -> None:
    world = boat((6,), (2.0,))
    network = network_of(world.scene, lambda pairs: [Result(0)] * len(pairs))
    assert network.pairs.funnel()["votes"] > 0
    assert len(network.pairs.kept()) == 6 * (5 + 4)  # the sequence stays


def test_sources_are_merged() -> None:
    world = boat((6,), (2.0,))
    settings = CandidatesSettings(sources=("sequence", "exhaustive"))
    pairs = network_of(world.scene, world.match, settings).pairs
    assert len(pairs) == 36 * 35 // 2
    assert pairs.from_source("sequence").sum() == 6 * 9 and pairs.from_source("exhaustive").all()


def test_pairs_that_the_axes_rule_out_are_counted_without_a_table() -> None:
    world = boat((12, 9), (2.0, 2.0))
    passes = find_passes(world.scene)
    listed, (note,) = network._with_axes(Pairs.empty(), world.scene, passes, CandidatesSettings(axes_deg=80))
    assert f": {len(listed)} pairs" in note and len(listed) > 100
    assert np.all(listed.dropped == REASONS.index("axes"))


def test_pair_lists_of_another_system_and_no_text(tmp_path) -> None:
    path = write(tmp_path, "\ufeff000.jpg ./001.jpg\r\n001.jpg 002.jpg\r\n")
    assert len(read_pair_list(path, photos(4))[0]) == 2
    assert pair_lines(write(tmp_path, "I 1.jpg,I 2.jpg\n'a' \"b c.jpg\"\n")) == [
        (1, ["I 1.jpg", "I 2.jpg"]), (2, ["'a'", "b c.jpg"])
    ]  # fmt: skip
    for data in (b"\xff\xfei\x00", b"\x89PNG\r\n"):
        path.write_bytes(data)
        with pytest.raises(InputError, match="pairs.txt(: is no text|, line 1: expected two image names)"):
            read_pair_list(path, photos(4))


def numbered(*counts: int) -> Scene:
    """Passes of so many images of one camera, in the order of their names, which is a guess."""
    names = [f"p{p}/{k:04d}.jpg" for p, count in enumerate(counts) for k in range(count)]
    track = np.repeat(np.arange(len(counts)), counts)
    step = np.concatenate([np.arange(count) for count in counts])
    tracks = tuple(f"p{p}" for p in range(len(counts)))
    frames, rig = np.arange(len(names)), Rig("camera", (Sensor("camera"),))
    return simple_scene(rig, names, frames, np.zeros(len(names)), track, step, sequences=tracks, guessed=tracks)


def along(place: np.ndarray, reach: float, lost: float = 0.0, far: int = 9):
    """Match function of images at places on a line: they tie within a reach, but for a share of them; ``far``: matches
    of those beyond it."""
    asked: list[int] = []

    def match(pairs: np.ndarray) -> list[Result]:
        asked.append(len(pairs))
        blind = (pairs.sum(axis=1) * 7919 % 100) < 100 * lost
        apart = np.abs(place[pairs[:, 0]] - place[pairs[:, 1]])
        return [Result(0 if b else 60 if a <= reach else far) for a, b in zip(apart, blind)]

    return match, asked


def ordered(scene: Scene, match, **settings: object) -> tuple[Scene, tuple[str, ...]]:
    return shown_order(context_of(scene, match, CandidatesSettings(**settings)))


def test_a_pass_whose_neighbours_tie_is_a_sequence() -> None:
    scene = numbered(60)
    match, asked = along(np.arange(60.0), 4)
    found, (note,) = ordered(scene, match)
    assert (found.sequence == 0).all() and found.sequences == ("p0",) and found.guessed == ()
    assert "a sequence, 40 of 40 previews of neighbours tie, and 0 of 40" in note
    assert Tuning().verdict.sample < sum(asked) <= 2 * Tuning().verdict.sample


@pytest.mark.parametrize("case", ["another order", "everything ties", "gaps", "nothing ties"])
def test_photographs_that_are_only_numbered_are_loose(case: str) -> None:
    scene = numbered(40)
    place = np.arange(40.0)
    match = {
        "another order": along(np.random.default_rng(0).permutation(place), 4),
        "everything ties": along(place, 100),  # a turntable: each image sees the same
        "gaps": along(np.cumsum(np.where(np.arange(40) % 3, 1.0, 9.0)), 4),  # stations of three
        "nothing ties": along(place, 0),
    }[case][0]
    found, (note,) = ordered(scene, match)
    assert (found.sequence == -1).all() and found.sequences == () and found.guessed == ()
    assert found.sequence_index.tolist() == list(range(40))
    assert "pass p0: 40 loose photographs and no sequence" in note and "--scan.layout sequence" in note


def test_a_few_lost_neighbours_do_not_part_a_sequence_and_a_handful_of_images_shows_nothing() -> None:
    match, _ = along(np.arange(60.0), 4, lost=0.15)
    assert (ordered(numbered(60), match)[0].sequence == 0).all()
    found, (note,) = ordered(numbered(8), along(np.arange(8.0), 1)[0])
    assert (found.sequence == -1).all() and "too few for a test" in note


@pytest.mark.parametrize("far, sequence", [(20, True), (50, False)])
def test_images_far_apart_may_tie_by_clearly_fewer_matches(far: int, sequence: bool) -> None:
    match, _ = along(np.arange(40.0), 4, far=far)
    assert (ordered(numbered(40), match)[0].sequence == (0 if sequence else -1)).all()


def test_each_pass_is_asked_for_itself() -> None:
    scene = numbered(40, 30, 50)
    place = np.r_[np.arange(40.0), 1000 + np.random.default_rng(0).permutation(30) * 10.0, 2000 + np.arange(50.0)]
    found, notes = ordered(scene, along(place, 3)[0])
    assert found.sequences == ("p0", "p2") and len(notes) == 3
    assert found.sequence.tolist() == [0] * 40 + [-1] * 30 + [1] * 50
    assert found.sequence_index.tolist() == [*range(40), *range(30), *range(50)]


def test_who_asks_for_a_sequence_gets_one_and_who_looks_at_nothing_none() -> None:
    scene = numbered(40)
    match, asked = along(np.arange(40.0), 4)
    assert (ordered(scene, match, sources=("sequence",))[0].sequence == 0).all()
    assert (ordered(scene, match, sources=("exhaustive",))[0].sequence == -1).all()
    assert (ordered(scene.with_(guessed=()), along(np.zeros(40), 1)[0])[0].sequence == 0).all()  # known: nobody asks
    assert not asked


def test_the_network_looks_at_every_pair_of_numbered_photographs() -> None:
    """60 of them in no order: as a sequence only neighbours and their offsets would be tried."""
    place = np.random.default_rng(3).permutation(60).astype(float)
    match, _ = along(place, 2)
    network = network_of(numbered(60), match)
    assert (network.scene.sequence == -1).all() and Scene.from_json(network.scene.to_json()).guessed == ()
    kept = network.pairs.kept()
    true = np.abs(place[:, None] - place) <= 2
    assert true[kept.i, kept.j].sum() == (true.sum() - 60) // 2
    assert any("loose photographs and no sequence" in note for note in network.notes)


def tied(world: World, recall: float, precision: float, across: float = 0.0) -> Steps:
    """The network of a survey whose ties are as good as that."""
    network = network_of(world.scene, world.match)
    found = quality(world, network.pairs)
    assert found[0] > recall and found[1] > precision and (found[2] > across or not across)
    return network


@pytest.mark.slow
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
def test_cameras_that_did_not_start_together() -> None:
    """Camera 2 lags: its k-th image belongs to the rig's frame k - 6. The rig is wrong then; the ties are not."""
    world = boat((20, 16), (1.5, 1.9))
    sensor, at = world.scene.sensor, np.arange(len(world.scene))
    for k in np.flatnonzero(sensor == 2):
        source = (sensor == 2) & (world.track == world.track[k]) & (world.step == max(0, world.step[k] - 6))
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_rig_file_with_cameras_in_another_order_is_called_wrong_and_loses_few_ties() -> None:
    rig = ring()
    poses = [rig.sensors[k].sensor_from_rig for k in (0, 2, 4, 1, 3, 5)]
    wrong = replace(rig, sensors=tuple(replace(s, sensor_from_rig=p) for s, p in zip(rig.sensors, poses)))
    network = tied(boat((20, 16), (1.5, 1.9), wrong), 0.85, 0.4, 0.85)
    assert any("check the rig file" in note for note in network.notes)


@pytest.mark.slow
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
    recall, precision = found(network.pairs, world.useful())
    assert recall > 0.95 and precision > 0.7 and world.asked < 10 * 400
    assert any("see the same place" in note for note in network.notes)
    assert not any("components" in note or "no pair" in note for note in network.notes)
