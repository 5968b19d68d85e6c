"""A sequence is what its images show to be one; numbers in the names do not make photographs follow each other."""

from __future__ import annotations

import numpy as np
import pytest

from boat_world import Result
from network_steps import estimate_network
from tiegraph.network.candidates import shown_order
from tiegraph.network.passes import MatchCache
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene


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
    return shown_order(scene, MatchCache(match, len(scene)), CandidatesSettings(**settings), Tuning())


def test_a_pass_whose_neighbours_tie_is_a_sequence() -> None:
    scene = numbered(60)
    match, asked = along(np.arange(60.0), 4)
    found, (note,) = ordered(scene, match)
    assert (found.sequence == 0).all() and found.sequences == ("p0",) and found.guessed == ()
    assert "a sequence, 40 of 40 previews of neighbours tie, and 0 of 40" in note
    assert Tuning().sources.sample < sum(asked) <= 2 * Tuning().sources.sample


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


def test_a_few_lost_neighbours_do_not_part_a_sequence() -> None:
    match, _ = along(np.arange(60.0), 4, lost=0.15)
    assert (ordered(numbered(60), match)[0].sequence == 0).all()


@pytest.mark.parametrize("far, sequence", [(20, True), (50, False)])
def test_images_far_apart_may_tie_by_clearly_fewer_matches(far: int, sequence: bool) -> None:
    match, _ = along(np.arange(40.0), 4, far=far)
    assert (ordered(numbered(40), match)[0].sequence == (0 if sequence else -1)).all()


def test_a_handful_of_images_shows_nothing() -> None:
    found, (note,) = ordered(numbered(8), along(np.arange(8.0), 1)[0])
    assert (found.sequence == -1).all() and "too few to tell" in note


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
    network = estimate_network(numbered(60), np.zeros(60), match, CandidatesSettings(), Tuning())
    assert (network.scene.sequence == -1).all() and Scene.from_json(network.scene.to_json()).guessed == ()
    kept = network.pairs.kept()
    true = np.abs(place[:, None] - place) <= 2
    assert true[kept.i, kept.j].sum() == (true.sum() - 60) // 2
    assert any("loose photographs and no sequence" in note for note in network.notes)
