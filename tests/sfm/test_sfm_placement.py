"""Frames at a wrong place are found and left out with their reason; a good model is let be."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import moving_world, write_database
from scipy.sparse import csr_array

from near import off_after_similarity
from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import image_poses, matrix, rigid3d
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import Findings
from tiegraph.sfm.placement import (
    Explained,
    confirmed_places,
    explained,
    leave_out_doubtful,
    part_places,
    placed_anew,
    rivals,
    rivals_told,
    steps_of_parts,
    suspect_frames,
)
from tiegraph.sfm.tuning.placement import PlacementTuning
from tiegraph.sfm.verified import MatchSource

TUNING = PlacementTuning()


@pytest.fixture
def world(tmp_path: Path) -> tuple[pycolmap.Reconstruction, Scene]:
    model, scene = moving_world(frames=14)
    write_database(model, tmp_path / "database.db")
    return model, scene


def _test(model: pycolmap.Reconstruction, scene: Scene, folder: Path) -> Findings:
    return leave_out_doubtful(model, scene, MatchSource(folder / "database.db"), TUNING)


def _explained(model: pycolmap.Reconstruction, scene: Scene, folder: Path) -> Explained:
    return explained(model, scene, MatchSource(folder / "database.db").read(scene), TUNING)


def _suspects(scene: Scene, *tables: dict) -> dict[tuple[int, ...], str]:
    """By agreeing and contradicting matches (a, b), of which both frames tell the same."""
    both = []
    for table in tables:
        dense = np.zeros((scene.frames, scene.frames))
        for (a, b), matches in table.items():
            dense[a, b] = dense[b, a] = matches
        both.append(csr_array(dense))
    return suspect_frames(range(scene.frames), tuple(both), TUNING.consistency.min_votes, TUNING.consistency.loses)


def _centres(model: pycolmap.Reconstruction, scene: Scene) -> np.ndarray:
    poses = image_poses(model, scene)[: scene.frames]  # cam0 is the rig
    return transforms.centre(poses)


def _shift(model: pycolmap.Reconstruction, frames: range, step_m: Sequence[float], scale: float = 1.0) -> None:
    """Frames to another place, and of another size, with points of their own there, as a repeated wall does it."""
    inside = {i for i in model.reg_image_ids() if model.image(i).frame_id - 1 in frames}
    for key, point in list(model.points3D.items()):
        place = np.array(point.xyz)
        elements = [(e.image_id, e.point2D_idx) for e in point.track.elements]
        own, rest = [e for e in elements if e[0] in inside], [e for e in elements if e[0] not in inside]
        if own:
            model.delete_point3D(key)
            for part, xyz in ((own, scale * place + step_m), (rest, place)):
                if len(part) >= 2:
                    model.add_point3D(xyz, pycolmap.Track([pycolmap.TrackElement(*e) for e in part]))
    for f in frames:
        pose = model.frame(f + 1).rig_from_world
        now = transforms.invert(matrix(pose))
        now[:3, 3] = scale * now[:3, 3] + step_m
        model.frame(f + 1).rig_from_world = rigid3d(transforms.invert(now))


def test_a_good_model_is_let_be(world, tmp_path: Path) -> None:
    model, scene = world
    assert _test(model, scene, tmp_path) == Findings()
    assert model.num_reg_images() == len(scene)


def test_a_frame_at_a_repeated_wall_is_left_out_with_its_reason(world, tmp_path: Path) -> None:
    model, scene = world
    true = _centres(model, scene)
    _shift(model, range(6, 7), (0, 0, 12))
    found = _test(model, scene, tmp_path)
    assert {name for name, _ in found.dropped} == {f"cam{s}/006.jpg" for s in range(3)}
    assert all(why.startswith("left out: most of its matches") for _, why in found.dropped)
    assert [row[0] for row in found.tables["placement"]["rows"]] == ["cam0/006.jpg"]
    assert found.notes == ["1 of 14 frames were at a doubtful place and are left out; see the table of placement"]
    assert model.num_reg_images() == len(scene) - 3
    others = np.arange(scene.frames) != 6
    assert np.linalg.norm(_centres(model, scene) - true, axis=1)[others].max() < 1e-9
    assert all(p.track.length() >= 2 for p in model.points3D.values())


@pytest.mark.parametrize("steps", [-2.0, 1.5])
def test_a_frame_that_slid_along_the_line_to_the_others_is_left_out(world, tmp_path: Path, steps: float) -> None:
    """There the rays of any two images meet as they did: only points that two others made tell."""
    model, scene = world
    _shift(model, range(13, 14), steps * np.diff(_centres(model, scene)[12:], axis=0)[0])
    found = _test(model, scene, tmp_path)
    assert [row[0] for row in found.tables["placement"]["rows"]] == ["cam0/013.jpg"]


@pytest.mark.parametrize(("cameras", "percent"), [(3, 88.4), (1, 88.4)])
def test_where_else_a_frame_could_stand_is_found(world, tmp_path: Path, cameras: int, percent: float) -> None:
    """Of a rig and of one camera: the true place, by the points of the others; how much the model explains is told."""
    model, scene = world
    if cameras == 1:
        for k in [k for k in model.reg_image_ids() if model.image(k).camera_id > 1]:
            for row in range(model.image(k).num_points2D()):
                if model.image(k).point2D(row).has_point3D():
                    model.delete_observation(k, row)
        write_database(model, tmp_path / "database.db")
    assert rivals(_explained(model, scene, tmp_path)) == {}
    _shift(model, range(6, 7), (0.5, 0, 3))
    found = _explained(model, scene, tmp_path)
    (frame, rival), *more = rivals(found).items()
    assert frame == 6 and not more and rival.here < 0.2 * rival.there
    assert np.allclose(rival.step, (-0.5, 0, -3), atol=0.02)
    assert found.table()["rows"][0][0] == "cam0/006.jpg" and found.table()["rows"][0][2] < 20
    assert found.percent() == pytest.approx(percent, abs=3)
    (said,) = rivals_told({6: rival}, scene)
    assert (
        f"cam0/006.jpg: {rival.here} matches agree with its place, {rival.there} with a place 3.04 model units" in said
    )


@pytest.mark.parametrize(
    ("frames", "scale"), [(range(5, 9), 1.0), (range(9, 14), 1.0), (range(7, 14), 1.0), (range(9, 14), 1.1)]
)
def test_a_part_that_stands_wrong_moves_as_a_whole(world, tmp_path: Path, frames: range, scale: float) -> None:
    """A section in the middle, an end, a half, and one that is of another size; what is right stays."""
    model, scene = world
    true = _centres(model, scene)
    _shift(model, frames, (0.5, 0, 15), scale)
    off = _centres(model, scene)
    found = _explained(model, scene, tmp_path)
    places = part_places(found, TUNING)
    assert all(p.wins and p.positions == 0 and p.here < 0.2 * p.there for p in places)
    moves = {f: p.move for p in places for f in p.frames}
    steps = {f: step for part in steps_of_parts(found, places) for f, step in part.items()}
    assert (
        all(np.allclose(off[f] + steps[f], moves[f](off[f]), atol=1e-9) for f in moves) and steps.keys() == moves.keys()
    )
    assert set(moves) == set(frames) or set(moves) == set(range(14)) - set(frames) and len(frames) == 7
    now = np.array([moves[f](off[f]) if f in moves else off[f] for f in range(14)])
    assert np.linalg.norm(off_after_similarity(now, true), axis=1).max() < 0.02
    poses, out = placed_anew(model, scene, found.verified, TUNING)
    assert sorted(poses) == [f + 1 for f in sorted(moves)] and out == []
    placed = np.array([transforms.centre(matrix(poses[f + 1])) for f in sorted(moves)])
    assert np.allclose(placed, now[sorted(moves)], atol=1e-9)


@pytest.mark.parametrize("right", ["here", "there", "nowhere"])
def test_measured_positions_decide_between_two_places_of_a_part(world, tmp_path: Path, right: str) -> None:
    """Whatever the matches say; where positions do not reach the part, or are too poor, the matches decide."""
    model, scene = world
    true = _centres(model, scene)
    _shift(model, range(9, 14), (0.5, 0, 15))
    now = _centres(model, scene)
    position = now if right == "here" else true
    sigma_m = 30.0 if right == "nowhere" else 0.02
    noise = np.random.default_rng(1).normal(0, min(sigma_m, 0.02), position.shape)
    pose = np.tile(np.eye(4), (scene.frames, 1, 1))
    pose[:, :3, 3] = position + noise
    scene = scene.with_(world_from_rig=pose, position_sigma_m=np.full((scene.frames, 3), sigma_m), prior="gnss")
    found = _explained(model, scene, tmp_path)
    (place,) = part_places(found, TUNING)
    assert set(place.frames) == set(range(9, 14))
    assert place.positions == {"here": -1, "there": 1, "nowhere": 0}[right] and place.wins == (right != "here")
    moved, out = placed_anew(model, scene, found.verified, TUNING)
    assert len(moved) == (0 if right == "here" else 5) and out == []
    assert (steps_of_parts(found, [place]) == []) == (right == "here")
    check, (said, sure) = _test(model, scene, tmp_path), confirmed_places([place], scene)
    assert check.dropped == [] and len(check.notes) == (right != "here") and len(said) == (right == "here")
    assert sure == (set(range(9, 14)) if right == "here" else set())


def test_a_model_that_fell_apart_keeps_its_frames_and_it_is_said(world, tmp_path: Path) -> None:
    model, scene = world
    _shift(model, range(9, 14), (0, 0, 15))  # a third of the frames, and a fifth may be left out
    found = _test(model, scene, tmp_path)
    assert found.tables == {} and found.dropped == [] and model.num_reg_images() == len(scene)
    named = "cam0/009.jpg, cam0/010.jpg, cam0/011.jpg, cam0/012.jpg and 1 more"
    assert found.notes == [
        f"5 of 14 frames are at doubtful places; because they are so many, none is left out ({named})"
    ]


def test_photographs_numbered_in_another_order_than_they_stand_all_stay(world, tmp_path: Path) -> None:
    """Every verified tie agrees with every place."""
    model, scene = world
    true = _centres(model, scene)
    step = np.arange(14)
    step[2] = 14  # the last number, at the beginning of the road
    found = _test(model, scene.with_(sequence_index=step, time_s=np.full(14, np.nan)), tmp_path)
    assert found == Findings() and model.num_reg_images() == len(scene)
    assert np.linalg.norm(_centres(model, scene) - true, axis=1).max() < 1e-9


@pytest.mark.parametrize(
    "agree, contradict, kept",
    [
        ({(2, 7): 200.0, (3, 8): 200.0}, {}, True),  # true ties over a gap in the pass
        (
            {(2, 7): 200.0, (3, 8): 200.0},
            {(4, 5): 300.0, (4, 6): 200.0},
            True,
        ),  # not clearly more speak against than for it
        ({(2, 7): 200.0, (3, 8): 200.0}, {(1, 9): 400.0, (0, 8): 300.0}, False),  # more speak against than for it
    ],
)
def test_a_half_that_hangs_on_few_ties_is_judged_by_these(agree: dict, contradict: dict, kept: bool) -> None:
    _, scene = moving_world(frames=10)
    beside = {(k, k + 1): 500.0 for k in range(9) if k != 4}
    found = _suspects(scene, {**beside, **agree}, contradict)
    assert [len(frames) for frames in found] == ([] if kept else [5])
    assert all("matches" in why for why in found.values())


@pytest.mark.parametrize(
    "agree, contradict, left_out",
    [
        ({(3, 4): 60.0, (5, 8): 45.0}, {(3, 5): 80.0, (4, 7): 90.0}, (4, 5, 6)),  # more speak against than for them
        ({(3, 4): 300.0, (5, 8): 200.0}, {(2, 4): 90.0, (5, 7): 90.0}, ()),  # more speak for them
        ({(3, 4): 60.0, (5, 8): 55.0}, {}, ()),  # few points hold them, and all agree: said elsewhere
    ],
)
def test_frames_that_stand_wrong_together_are_asked_together(agree: dict, contradict: dict, left_out: tuple) -> None:
    """Each of three frames has most of its ties with the other two, which agree: alone none is in doubt."""
    _, scene = moving_world(frames=10)
    scene = scene.with_(sequence=np.full(10, -1))  # photographs: no course that could jump
    inside = {(4, 5): 800.0, (5, 6): 700.0, (4, 6): 600.0}
    outside = {(a, b): 500.0 for a in range(10) for b in range(a + 1, a + 3) if b < 10 and not {a, b} & {4, 5, 6}}
    outside[3, 7] = 500.0
    found = _suspects(scene, {**inside, **outside, **agree}, contradict)
    assert list(found) == ([left_out] if left_out else [])
    assert all("tested together with the 2 frames it is tied to most" in why for why in found.values())


def test_halves_of_two_passes_that_false_ties_hold_together_are_found() -> None:
    """Two passes torn at one place: each half stays with its half; the ties over the tear are the neighbours'."""
    _, scene = moving_world(frames=12)
    scene = scene.with_(
        sequence=np.repeat([0, 1], 6), sequence_index=np.tile(np.arange(6), 2), sequences=("up", "down")
    )
    beside = {(k, k + 1): 300.0 for k in range(11) if k not in (2, 5, 8)}
    agree = {**beside, (0, 6): 500.0, (1, 7): 500.0, (2, 8): 500.0, (3, 9): 400.0, (4, 10): 400.0, (2, 9): 90.0}
    found = _suspects(scene, agree, {(2, 3): 80.0, (8, 9): 80.0})
    assert len(found) == 1 and next(iter(found)) in ((0, 1, 2, 6, 7, 8), (3, 4, 5, 9, 10, 11))
