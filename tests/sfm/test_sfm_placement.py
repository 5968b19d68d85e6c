"""Frames at a wrong place are found; several models in one world, or left out with the reason."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import moving_world, write_database
from scipy.sparse import csr_array
from sfm_worlds import elsewhere, frame_centres, make_world, part_of, with_positions

from near import off_after_similarity
from tiegraph import papers
from tiegraph.geometry import transforms
from tiegraph.project.settings import merged as merged_settings
from tiegraph.scene.colmapmodel import image_poses, matrix, rigid3d
from tiegraph.scene.composed import merged
from tiegraph.scene.scene import Scene
from tiegraph.sfm import finish
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
    torn_told,
)
from tiegraph.sfm.rigcheck import FinishRequest, Held
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.placement import PlacementTuning
from tiegraph.sfm.verified import MatchSource, VerifiedMatches, read_verified, tears
from tiegraph.sfm.world.fixes import Measurements
from tiegraph.sfm.world.georef import georeference
from tiegraph.sfm.world.oneworld import OneWorld, one_world

pytestmark = pytest.mark.slow
TUNING = PlacementTuning()


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> tuple[pycolmap.Reconstruction, Scene, Path]:
    model, scene = moving_world(frames=14)
    write_database(model, path := tmp_path_factory.mktemp("drawn") / "database.db")
    return model, scene, path


@pytest.fixture
def world(drawn, tmp_path: Path) -> tuple[pycolmap.Reconstruction, Scene]:
    """A model and its database that a test may change."""
    model, scene, path = drawn
    shutil.copy(path, tmp_path / "database.db")
    return pycolmap.Reconstruction(model), scene


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


@pytest.mark.parametrize(("agree", "torn"), [(0, False), (40, False), (60, True)])
def test_a_frame_left_out_that_part_of_the_model_agrees_with_tells_of_a_tear(world, tmp_path, agree, torn) -> None:
    """Frame 6 contradicts those after it by 100 matches: twice as many as agree leave it in doubt only."""
    model, scene = world
    found = _explained(model, scene, tmp_path)
    votes = [np.zeros((scene.frames, scene.frames)) for _ in range(2)]
    others = [k for k in range(scene.frames) if k != 6]
    votes[0][others[:-1], others[1:]], votes[0][6, 5], votes[1][6, 7] = 500, agree, 100
    found = replace(found, votes=tuple(csr_array(v) for v in votes))
    assert found.in_doubt(found.tuning.loses).doubts.keys() == {6}
    told = torn_told(found, [6])
    assert len(told) == torn and all("cam0/006.jpg" in said and "may be torn" in said for said in told)


def _tears(model: pycolmap.Reconstruction, scene: Scene, folder: Path, doubtful: Sequence[int] = ()) -> list:
    found = _explained(model, scene, folder)
    return tears(found.verified, found.agreed, scene, doubtful, found.tuning)


def test_a_model_is_torn_between_the_frames_whose_matches_it_contradicts(world, tmp_path: Path) -> None:
    model, scene = world
    assert _tears(model, scene, tmp_path) == []
    _shift(model, range(7, 14), (0, 0, -40))  # the second half behind the first
    ((before, after, agree, all_),) = _tears(model, scene, tmp_path)
    assert (before, after) == (6, 7) and agree < 0.1 * all_ and all_ >= TUNING.consistency.min_votes
    passes = scene.with_(sequence=np.repeat([0, 1], 7), sequences=("road", "back"))
    assert _tears(model, passes, tmp_path) == [], "two passes may be anywhere"


@pytest.mark.parametrize("torn", [False, True])
def test_a_torn_model_says_so_and_states_no_sigma(world, tmp_path: Path, monkeypatch, torn: bool) -> None:
    """Unless a second place of one part explains it: then the sigmas cover both."""
    model, scene = world
    if torn:
        _shift(model, range(7, 14), (0, 0, -40))
    monkeypatch.setattr(finish, "steps_of_parts", lambda *_: [])  # as where a repeated wall holds the parts together
    (tmp_path / "mapped").mkdir()
    model.write(tmp_path / "mapped")
    request = FinishRequest(
        folder=tmp_path / "mapped",
        target=tmp_path / "0",
        scene=scene,
        tuning=Tuning(),
        held=Held({0: "fixed"}, cameras=(1, 2, 3), readout_ms=0),
        matched=MatchSource(tmp_path / "database.db"),
        covariance_frames=100,
    )
    found = finish.finish_model(request, lambda _: None)
    said = [text for text in found.contradictions if "the model is torn" in text]
    assert len(said) == torn and (found.sigma is None) == (found.shape is None) == torn
    assert not torn or "cam0/006.jpg and cam0/007.jpg" in said[0]


def test_a_single_frame_elsewhere_is_no_tear(world, tmp_path: Path) -> None:
    model, scene = world
    _shift(model, range(6, 7), (0, 0, 12))
    assert _explained(model, scene, tmp_path).doubts.keys() == {6}
    assert _tears(model, scene, tmp_path, [6]) == []


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


TUNING_ONEWORLD = Tuning()
NONE = VerifiedMatches(np.zeros((0, 2), int), (), {})
FIRST = 12  # frames of the first model


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """(scene without positions, truth, two models of it in frames and units of their own, all verified matches)."""
    path = tmp_path_factory.mktemp("world") / "database.db"
    truth, scene = make_world(path, cameras=2, frames=20, points=200)
    rng = np.random.default_rng(5)
    first = part_of(truth, range(FIRST), 0.01, rng)
    second = part_of(truth, range(FIRST, 20), 0.01, rng)
    return scene, truth, (first, elsewhere(second)), read_verified(path, scene)


def _brought_together(models, scene, matches, tuning=TUNING_ONEWORLD) -> OneWorld:
    settings = GeorefSettings(adjust="no")

    def similarity(model, given):
        return georeference(model, scene, settings, tuning.world, given)

    def whole(model, given):
        found = similarity(model, given)
        return found, found.apply(model)

    return one_world(models, scene, matches, similarity, whole, Measurements(), tuning)


def _joined(survey, verified=None, scene=None, tuning=TUNING_ONEWORLD) -> OneWorld:
    without, _, models, matches = survey
    scene, matches = without if scene is None else scene, matches if verified is None else verified
    return _brought_together(models, scene, matches, tuning)


def _off(found, survey):
    """(largest distance of a projection centre in the truth's units, largest turn in degrees), after the similarity
    that brings the first model back."""
    scene, truth, (first, _), _ = survey
    world_from_truth = found.first.world_from_model
    here, there = image_poses(found.model, scene), image_poses(truth, scene)
    centres = world_from_truth(transforms.centre(there))
    turned = there[:, :3, :3] @ world_from_truth.rotation.T
    off = np.linalg.norm(transforms.centre(here) - centres, axis=1) / world_from_truth.scale
    return np.nanmax(off), np.nanmax(transforms.angle_deg(here[:, :3, :3], turned))


def _with_positions(survey, moved_m=0.0, sigma_m=0.02):
    scene, truth, _, _ = survey
    true = frame_centres(truth, scene)
    noise = sigma_m * np.random.default_rng(1).standard_normal(true.shape)
    noise[FIRST:, 0] += moved_m
    return with_positions(scene, true + noise, sigma_m)


def test_matches_join_two_models_without_any_position_into_a_whole_one(survey, tmp_path) -> None:
    found = _joined(survey)
    (second,) = found.others
    assert second.by == "matches" and not found.contradictions
    off, turn = _off(found, survey)
    assert 1e-6 < off < 0.04 and turn < 0.5  # of a path of some units; points are off by 0.01
    assert 0.7 < second.test.explained < 1 and 0.7 < second.test.ties / second.test.total < 1
    assert 1e-6 < second.test.jump < 0.02 and second.test.independent >= 4
    assert found.model.num_reg_images() == 40
    assert second.row()[:3] == ["sparse/1", 16, "matches"] and second.row()[-1] == ""
    assert "joined to the others by" in second.note(metric=True)
    found.model.write(tmp_path)
    again = pycolmap.Reconstruction(tmp_path)
    scene, _, (first, second), _ = survey
    assert again.num_reg_frames() == 20 and again.num_cameras() == 4 and again.num_rigs() == 2
    assert again.num_points3D() == first.num_points3D() + second.num_points3D()
    for model in (first, second):
        model.update_point_3d_errors()
    worse = max(m.compute_mean_reprojection_error() for m in (first, second))
    again.update_point_3d_errors()
    assert again.compute_mean_reprojection_error() < 1.01 * worse
    assert {again.image(k).name for k in again.reg_image_ids()} == set(scene.names)


def test_an_image_of_two_models_stays_once(survey) -> None:
    _, truth, (first, _), _ = survey
    both = merged([first, truth])
    assert both.num_reg_images() == 40 and merged([first, first]).num_cameras() == 2
    names = [both.image(k).name for k in both.reg_image_ids()]
    assert len(names) == len(set(names))
    points = [p for p in both.points3D.values() if any(e.image_id not in both.images for e in p.track.elements)]
    assert not points


def test_matches_that_agree_with_nothing_join_nothing(survey) -> None:
    scene, _, (first, _), verified = survey
    rng = np.random.default_rng(2)
    across = (scene.frame[verified.pairs] < FIRST).sum(axis=1) == 1
    wrong = tuple(
        np.stack([m[:, 0], rng.permutation(m[:, 1])], 1) if a else m for m, a in zip(verified.matches, across)
    )
    found = _joined(survey, replace(verified, matches=wrong))
    (second,) = found.others
    assert second.by == "" and "matches run between it" in second.why_not or "no match" in second.why_not
    assert found.model.num_reg_images() == first.num_reg_images()
    assert "not in the world and not in the cloud" in found.notes()[-1]


def test_one_repeated_wall_joins_nothing(survey) -> None:
    """Matches that agree, but of a single pair of images: nothing independent says so."""
    scene, _, _, verified = survey
    across = np.flatnonzero((scene.frame[verified.pairs] < FIRST).sum(axis=1) == 1)
    found = _joined(survey, verified.where(across[:1]))
    assert found.others[0].by == ""


def test_positions_place_what_no_match_joins(survey) -> None:
    found = _joined(survey, NONE, _with_positions(survey))
    (second,) = found.others
    assert second.by == "positions" and found.model.num_reg_images() == 40
    assert 0.005 < second.sigma_m < 0.2
    poses, true = image_poses(found.model, survey[0]), image_poses(survey[1], survey[0])
    off = np.linalg.norm(transforms.centre(poses) - transforms.centre(true), axis=1)
    assert 1e-4 < np.median(off) < 0.06


def test_without_matches_and_positions_a_model_stays_out_and_says_why(survey) -> None:
    for scene in (survey[0], _with_positions(survey).with_(prior="gnss")):
        poses = scene.world_from_rig.copy()
        poses[FIRST:] = np.nan
        found = _joined(survey, NONE, scene.with_(world_from_rig=poses))
        assert found.others[0].by == "" and "too few positions" in found.others[0].why_not
        assert found.model.num_reg_images() == 2 * FIRST


@pytest.mark.parametrize("joins", [True, False])
def test_the_largest_model_with_positions_carries_the_world(survey, joins) -> None:
    """As where a survey is cut at a bridge below which most of it lies, and no position."""
    scene = _with_positions(survey)
    places = scene.world_from_rig.copy()
    places[:FIRST] = np.nan
    recipe = merged_settings(papers.colmap_alone()).tuning.sfm
    found = _joined(survey, scene=scene.with_(world_from_rig=places), tuning=TUNING_ONEWORLD if joins else recipe)
    (first,) = found.others
    assert found.first.placed and first.number == 0 and first.row()[0] == "sparse/0"
    assert (first.by, found.model.num_reg_images()) == (("matches", 40) if joins else ("", 16))
    said = "24 images of 1 models are not in the world frame: the recipe has no such step"
    assert [line[: len(said)] for line in found.by_hand()] == ([] if joins else [said])
    off = transforms.centre(image_poses(found.model, scene)) - transforms.centre(image_poses(survey[1], scene))
    assert 1e-4 < np.nanmedian(np.linalg.norm(off, axis=1)) < 0.06


def test_one_place_for_all_frames_is_no_position(survey) -> None:
    """Phones write one place into all photographs of an object; the fit ended with an error."""
    scene = _with_positions(survey)
    there = scene.world_from_rig.copy()
    there[FIRST:, :3, 3] = [1.0, 2.0, 3.0]
    found = _joined(survey, NONE, scene.with_(world_from_rig=there))
    assert found.others[0].by == "" and "too few positions" in found.others[0].why_not
    settings = GeorefSettings()
    alone = georeference(survey[2][1], scene.with_(world_from_rig=there), settings, TUNING_ONEWORLD.world)
    assert not alone.placed
    assert "8 registered frames have a prior position (1 different ones)" in alone.findings.notes[0]


def test_a_turn_about_the_track_that_is_open_keeps_a_model_out(survey) -> None:
    """Positions so loose that they tell the place and no turn."""
    found = _joined(survey, NONE, _with_positions(survey, sigma_m=5.0))
    assert found.others[0].by == "" and "do not determine the rotation about its track" in found.others[0].why_not
    assert found.model.num_reg_images() == 2 * FIRST


def test_positions_that_contradict_the_matches_are_said(survey) -> None:
    right, wrong = (_joined(survey, scene=_with_positions(survey, moved)) for moved in (0.0, 3.0))
    assert right.others[0].by == wrong.others[0].by == "matches"
    assert not right.contradictions and right.others[0].off[0] < 0.1
    assert len(wrong.contradictions) == 1 and "matches were used" in wrong.contradictions[0]
    assert 1.5 < wrong.others[0].off[0] < 4.0
