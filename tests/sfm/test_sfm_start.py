"""A model from given poses: its rounds, path and gate; two surveys in one folder."""

from __future__ import annotations

import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import moving_world, write_database
from scipy.spatial.transform import Rotation
from sfm_worlds import drop_pairs, lone_scene, run_sparse

from near import assert_reconstruction_near
from tiegraph.geometry import transforms
from tiegraph.scene.colmapdatabase import image_ids
from tiegraph.scene.colmapmodel import MAX_IMAGES, image_poses
from tiegraph.scene.colmaprows import write_working_copy
from tiegraph.scene.scene import Scene
from tiegraph.sfm import mapping
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.run import MappingResult, Method, Request, RigsUsed, contradicted, refusal, run_mapper
from tiegraph.sfm.start import StartCheck, check_start, length_of_path, rig_of_poses, start_from, start_told
from tiegraph.sfm.tuning import AdjustTuning, StartCheckTuning, Tuning
from tiegraph.sfm.tuning.placement import StartTuning
from tiegraph.sfm.verified import MatchSource, read_verified

TUNING = Tuning()


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, Scene, Path]:
    model, scene = moving_world(frames=12)
    write_database(model, path := tmp_path_factory.mktemp("known") / "database.db")
    return image_poses(model, scene), scene, path


@pytest.fixture
def world(known, tmp_path: Path) -> tuple[np.ndarray, Scene]:
    """True cam_from_world (N, 4, 4) and the scene; the verified matches are in the folder."""
    true, scene, path = known
    shutil.copy(path, tmp_path / "database.db")
    return true, scene


def _rough(true: np.ndarray, scene: Scene, turn_deg: float = 0.15, shift_m: float = 0.03) -> np.ndarray:
    """Poses as a coarse model has them: the frames a little off, the rig as it is."""
    rng = np.random.default_rng(1)
    turn = Rotation.from_rotvec(np.radians(turn_deg) * rng.standard_normal((scene.frames, 3)) / 1.7).as_matrix()
    wrong = transforms.rigid(turn, shift_m * rng.standard_normal((scene.frames, 3)) / 1.7)
    return _images(frame_poses(true, scene) @ wrong, scene)


def _images(world_from_rig: np.ndarray, scene: Scene) -> np.ndarray:
    """cam_from_world (N, 4, 4) of the images of frames."""
    extrinsics = np.stack([scene.rigs[0].sensors[s].sensor_from_rig for s in scene.sensor])
    return extrinsics @ transforms.invert(world_from_rig[scene.frame])


def _map(
    folder: Path, scene: Scene, poses: np.ndarray, fixed: bool = True, tuning: Tuning | None = None
) -> MappingResult:
    request = Request(
        method=Method("preview", poses=poses), matches=MatchSource(folder / "database.db", least=15), images=None,
        folder=folder / "run", rigs=RigsUsed((0,), (0,) if fixed else (), (1, 2, 3)), scene=scene,
        tuning=tuning or Tuning(),
    )  # fmt: skip
    return run_mapper(request, lambda frames: None)


def _assert_near(folder: Path, true: np.ndarray, scene: Scene, m: float = 0.004, deg: float = 0.03) -> float:
    """``assert_reconstruction_near`` of the model in a folder."""
    return assert_reconstruction_near(pycolmap.Reconstruction(folder), scene, true, m=m, deg=deg)


@pytest.mark.slow
def test_rough_poses_become_a_good_model(world, tmp_path: Path) -> None:
    true, scene = world
    rough = _rough(true, scene)
    before = transforms.centre(rough) - transforms.centre(true)
    assert 0.01 < np.sqrt(np.mean(np.sum(before**2, axis=1))) < 0.1
    mapped = _map(tmp_path, scene, rough)
    assert mapped.refused == "" and mapped.notes == ()
    assert _assert_near(mapped.folders[0], true, scene) == pytest.approx(1, abs=0.005)  # of a rig of 0.4 m
    assert not (tmp_path / "run" / "working.db").exists()


@pytest.mark.slow
def test_frames_without_a_pose_are_registered(world, tmp_path: Path) -> None:
    true, scene = world
    rough = _rough(true, scene)
    rough[np.isin(scene.frame, (4, 11))] = np.nan
    mapped = _map(tmp_path, scene, rough)
    assert pycolmap.Reconstruction(mapped.folders[0]).num_reg_images() == len(scene)
    _assert_near(mapped.folders[0], true, scene)


@pytest.mark.slow
@pytest.mark.parametrize("part", [False, True])
def test_frames_that_the_poses_have_at_a_wrong_place_are_placed_by_their_matches(world, tmp_path: Path, part) -> None:
    """Seneca's coarse model had four photographs elsewhere: they stayed there, and were left out in the end. A part
    moves as a whole, without a frame being placed by itself."""
    true, scene = world
    frames = frame_poses(_rough(true, scene), scene)
    if part:
        frames[7:] = transforms.rigid(_turned(20), np.array([3.0, 0, 12.0])) @ frames[7:]
    else:
        frames[[4, 9]] = frames[[10, 3]] @ transforms.rigid(_turned(20), np.array([3.0, 0, 0]))
    tuning = Tuning(start=StartTuning(register_rounds=0)) if part else None
    mapped = _map(tmp_path, scene, _images(frames, scene), tuning=tuning)
    assert mapped.refused == ""
    assert pycolmap.Reconstruction(mapped.folders[0]).num_reg_images() == len(scene)
    _assert_near(mapped.folders[0], true, scene)


@pytest.mark.slow
def test_a_refined_rig_takes_units_and_extrinsics_of_the_poses(world, tmp_path: Path) -> None:
    true, scene = world
    rough = _rough(true, scene)
    rough[:, :3, 3] *= 0.2
    nominal = [replace(s, sensor_from_rig=transforms.rigid(s.sensor_from_rig[:3, :3] @ _turned(k), np.zeros(3)))
               for k, s in enumerate(scene.rigs[0].sensors)]  # fmt: skip
    given = scene.with_(rigs=(replace(scene.rigs[0], sensors=tuple(nominal), fixed=False, nominal=True),))
    rig = rig_of_poses(given, 0, rough, TUNING.start.max_lever_off)
    for found, sensor in zip(rig.sensors, scene.rigs[0].sensors):
        np.testing.assert_allclose(found.sensor_from_rig[:3, :3], sensor.sensor_from_rig[:3, :3], atol=1e-9)
        np.testing.assert_allclose(found.sensor_from_rig[:3, 3], 0.2 * sensor.sensor_from_rig[:3, 3], atol=1e-9)
    mapped = _map(tmp_path, given, rough, fixed=False)
    assert mapped.refused == ""
    _assert_near(mapped.folders[0], true, scene, 0.006, 0.06)


def _turned(k: int) -> np.ndarray:
    return Rotation.from_rotvec([0.0, np.radians(2.0 * k), 0.0]).as_matrix()


@pytest.mark.slow
def test_a_path_too_long_for_its_rig_is_made_right(world, tmp_path: Path) -> None:
    """A coarse model had PandaSet's path 16 times too long against its rig; adjustment does not get out of that."""
    true, scene = world
    frames = frame_poses(true, scene)
    frames[:, :3, 3] *= 8.0
    mapped = _map(tmp_path, scene, _images(frames, scene))
    assert mapped.refused == "" and "0.125, by its matches" in mapped.notes[0]
    assert _assert_near(mapped.folders[0], true, scene) == pytest.approx(1, abs=0.005)


@pytest.mark.slow
@pytest.mark.parametrize(("seeing", "doubted", "again"), [(1.0, False, True), (1.0, True, False), (0.0, True, True)])
def test_what_a_mapper_made_too_long_is_mapped_again(
    world, tmp_path: Path, monkeypatch, seeing: float, doubted: bool, again: bool
) -> None:
    """A model in doubt is used only instead of one whose images see hardly a point: PandaSet's cameras fire at
    different times, so its rig as given contradicts any right model."""
    true, scene = world
    model = pycolmap.Reconstruction(_map(tmp_path, scene, _rough(true, scene)).folders[0])
    for frame in model.frames.values():
        frame.rig_from_world.translation *= 8.0
    for point in model.points3D.values():
        point.xyz = 8.0 * point.xyz
    stretched = tmp_path / "stretched"
    stretched.mkdir()
    model.write(stretched)
    run, doubt = mapping.run_once, "it contradicts 9 of 10 pairs" if doubted else ""
    monkeypatch.setattr(
        mapping, "_mapped", lambda *job: mapping.Outcome("global", [stretched], round(seeing * len(scene)))
    )
    monkeypatch.setattr(mapping, "run_once", lambda *job: replace(run(*job), refused=doubt))
    made = run_sparse(tmp_path, scene, mapper="global")
    assert "the path scaled to the rig" in str(made.tables)
    assert any("0.125, by its matches" in note for note in made.remarks.notes)
    if again:
        assert _assert_near(tmp_path / "sparse" / "0", true, scene) == pytest.approx(1, abs=0.005)
    else:
        assert any("should be 0.125 times as long" in note and doubt in note for note in made.remarks.notes)


@pytest.mark.slow
def test_positions_tell_the_length_where_matches_do_not(world, tmp_path: Path) -> None:
    true, scene = world
    frames = frame_poses(true, scene)
    verified = read_verified(tmp_path / "database.db", scene)
    alone = verified.where(scene.sensor[verified.pairs].max(axis=1) == 0)  # the reference camera: no baselines
    stretched = frames.copy()
    stretched[:, :3, 3] *= 3.0
    assert np.isnan(length_of_path(stretched, scene, (0,), alone, TUNING)[0])
    placed = scene.with_(world_from_rig=frames, position_sigma_m=np.full((scene.frames, 3), 0.02), prior="gnss")
    scale, by = length_of_path(stretched, placed, (0,), alone, TUNING)
    assert by == "the positions" and scale == pytest.approx(1 / 3, rel=0.01)
    assert length_of_path(frames, placed, (0,), alone, TUNING)[0] == 1.0
    extent = float(np.ptp(frames[:, :3, 3], axis=0).max())
    hardly = placed.with_(position_sigma_m=np.full((scene.frames, 3), extent))  # moved no farther than the noise
    assert np.isnan(length_of_path(frames, hardly, (0,), alone, TUNING)[0])
    far = frames.copy()
    far[:, :3, 3] *= 100.0
    assert length_of_path(far, hardly, (0,), alone, TUNING)[0] == pytest.approx(0.01, rel=0.8)
    assert length_of_path(stretched, scene, (0,), verified, TUNING)[0] == pytest.approx(1 / 3, rel=0.03)


def test_a_rig_of_one_centre_has_no_length_to_compare(world, tmp_path: Path) -> None:
    """The views of a panorama: nothing fixes the scale, and nothing contradicts it."""
    true, scene = world
    sensors = [replace(s, sensor_from_rig=transforms.rigid(s.sensor_from_rig[:3, :3], np.zeros(3)))
               for s in scene.rigs[0].sensors]  # fmt: skip
    views = scene.with_(rigs=(replace(scene.rigs[0], sensors=tuple(sensors)),))
    verified = read_verified(tmp_path / "database.db", views)
    started = start_from(true, views, (0,), (0,), verified, TUNING)
    assert started is not None and started.notes == ()
    np.testing.assert_allclose(started.world_from_rig, frame_poses(true, scene), atol=1e-9)


def _spoiled(model: pycolmap.Reconstruction, how: str) -> pycolmap.Reconstruction:
    """A right model, made wrong in one of the ways that the gate knows."""
    out = pycolmap.Reconstruction(model)
    rng = np.random.default_rng(0)
    if how == "moved":
        for k in out.reg_frame_ids()[1::2]:
            out.frame(k).rig_from_world.translation += np.array([3.0, 0, 0])
    if how == "lens":
        out.camera(2).params = 1000 * out.camera(2).params
    for number in out.reg_image_ids():
        for row, point in enumerate(out.image(number).points2D):
            if how == "noise":
                point.xy = point.xy + 8 * rng.standard_normal(2)
            if how == "bare" and number % 2 and point.has_point3D():
                out.delete_observation(number, row)
    out.update_point_3d_errors()
    return out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "why"),
    [
        ("", ""),
        ("moved", "its reprojection error is"),
        ("lens", "the adjusted intrinsics of camera cam1"),
        ("noise", "its reprojection error is 10.1 px"),
        ("bare", "only 9 of 18 tied images see 10 or more of its points"),
    ],
)
def test_the_gate_says_what_is_wrong_with_a_model(how: str, why: str, tmp_path: Path) -> None:
    model, scene = moving_world(frames=6)
    write_database(model, tmp_path / "database.db")
    verified = read_verified(tmp_path / "database.db", scene)
    spoiled = _spoiled(model, how)
    said = refusal(spoiled, scene, verified, np.ones(len(scene), bool), Tuning())
    assert said.startswith(why) and bool(said) == bool(why)
    doubt = contradicted(spoiled, scene, verified, Tuning())
    assert (doubt == "it contradicts 56 of 96 verified pairs of images") == (how == "moved")
    assert how or not doubt


@pytest.mark.slow
def test_a_model_that_does_not_pass_the_gate_is_not_kept(world, tmp_path: Path) -> None:
    true, scene = world
    strict = Tuning(adjust=AdjustTuning(filter_px=0.01))
    mapped = _map(tmp_path, scene, _rough(true, scene), tuning=strict)
    assert mapped.folders == [] and mapped.refused.startswith("its reprojection error is 0."), mapped


@pytest.mark.slow
def test_wrong_poses_are_mapped_from_nothing(tmp_path: Path) -> None:
    model, scene = moving_world(frames=14)
    write_database(model, tmp_path / "database.db")
    true = image_poses(model, scene)
    wrong = _rough(true, scene)
    wrong[:, :3, 3] += 6.0 * np.sin(scene.frame)[:, None]  # a frame here, the next elsewhere
    result = run_sparse(tmp_path, scene, {"preview": wrong}, covariance_frames=0)
    assert result.mapper == "global" and any("could not start from the coarse model" in n for n in result.remarks.notes)
    assert_reconstruction_near(result.load(), scene, true, m=0.004, deg=0.03)
    assert [row[0] for row in result.tables["runs"]["rows"]][:2] == ["preview", "global"]


@pytest.mark.slow
def test_the_stage_starts_from_the_coarse_model(world, tmp_path: Path) -> None:
    true, scene = world
    result = run_sparse(tmp_path, scene, {"preview": _rough(true, scene)})
    assert result.mapper == "preview" and result.counts["registered"] == len(scene)
    assert_reconstruction_near(result.load(), scene, true, m=0.004, deg=0.03)
    assert result.sigma is not None and 1e-5 < result.sigma.median < 0.01


CHECK, COUNT, REACH = StartCheckTuning(), 40, 8.0


def river(seed: int = 0) -> np.ndarray:
    """(N, 4, 4) world_from_camera along a bent way."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 60, COUNT)
    turns = Rotation.from_euler("zyx", np.stack([s, rng.uniform(-9, 9, COUNT), 3 * s], axis=1), degrees=True)
    return transforms.rigid(turns.as_matrix(), np.stack([s, 8 * np.sin(s / 15), rng.uniform(-0.3, 0.3, COUNT)], axis=1))


def elsewhere(poses: np.ndarray, scale: float = 0.07) -> np.ndarray:
    """In another world of another unit, with the noise of a finished model."""
    rng = np.random.default_rng(5)
    turn = Rotation.from_euler("xyz", [70, -20, 110], degrees=True).as_matrix()
    noise = Rotation.from_rotvec(np.radians(rng.normal(0, 0.1, (COUNT, 3)))).as_matrix()
    place = poses[:, :3, 3] + rng.normal(0, 0.02, (COUNT, 3))
    return transforms.rigid(turn @ poses[:, :3, :3] @ noise, scale * place @ turn.T + [5.0, 6, 7])


def turned(poses: np.ndarray, rows: slice, deg: float) -> np.ndarray:
    out, turn = poses.copy(), Rotation.from_euler("z", deg, degrees=True).as_matrix()
    pivot = out[rows][0, :3, 3].copy()
    out[rows, :3, 3] = (out[rows, :3, 3] - pivot) @ turn.T + pivot
    out[rows, :3, :3] = turn @ out[rows, :3, :3]
    return out


def judged(given: np.ndarray) -> tuple[StartCheck, str, bool]:
    """A start model against that of the images: what is found, what is told, and whether it contradicts."""
    found = check_start(given, river(), REACH, CHECK)
    return found, *start_told(found, lone_scene(COUNT), CHECK)


def test_a_model_of_another_world_and_unit_agrees() -> None:
    found, text, contradicts = judged(elsewhere(river()))
    assert found.both.all() and not found.bad.any()
    assert 0.01 < np.median(found.turned_deg) < 0.5 and 1e-4 < np.median(found.off) < 0.02
    assert not contradicts and text.startswith("start model: 40 of 40 images agree with it, to 0.")


@pytest.mark.slow
@pytest.mark.parametrize("rows", [slice(22, None), slice(0, 14), slice(30, None)])
def test_a_part_that_is_turned_is_found_and_named(rows: slice) -> None:
    found, text, contradicts = judged(turned(elsewhere(river()), rows, 20.0))
    wrong = np.arange(COUNT)[rows]
    assert np.array_equal(np.flatnonzero(found.bad), wrong)
    assert np.median(found.turned_deg[wrong]) == pytest.approx(20, abs=0.3)
    first = f"such as {wrong[0]:03d}.jpg"
    assert contradicts and "rotated relative to the others by 20 deg" in text and first in text and "bent there" in text


def test_a_part_of_another_scale_is_found_though_it_is_not_turned() -> None:
    given = elsewhere(river())
    given[25:, :3, 3] = given[25, :3, 3] + 3 * (given[25:, :3, 3] - given[25, :3, 3])
    found, _, contradicts = judged(given)
    assert contradicts and not found.bad[:25].any() and found.bad[26:].mean() > 0.9 and np.nanmax(found.turned_deg) < 1


def test_another_survey_is_told_as_one_and_few_wrong_images_are_no_contradiction() -> None:
    _, text, contradicts = judged(river()[np.random.default_rng(1).permutation(COUNT)])
    assert contradicts and "is it of another survey, or are names different?" in text
    _, text, contradicts = judged(turned(elsewhere(river()), slice(37, None), 20.0))
    assert not contradicts and "37 of 40 images agree" in text and "3 images do not" in text


def test_too_few_common_images_say_nothing() -> None:
    given = elsewhere(river())
    given[2:] = np.nan
    found, text, contradicts = judged(given)
    assert found.both.sum() == 2 and not found.bad.any() and not contradicts
    assert text == "start model: 2 of its images are in the model, too few to test it"


@pytest.fixture(scope="module")
def known_blocks(tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, Scene, Path]:
    model, scene = moving_world(frames=24, points=1500)
    write_database(model, path := tmp_path_factory.mktemp("known") / "database.db")
    return image_poses(model, scene), scene, path


@pytest.fixture
def world_blocks(known_blocks, tmp_path: Path) -> tuple[np.ndarray, Scene]:
    true, scene, path = known_blocks
    shutil.copy(path, tmp_path / "database.db")
    return true, scene


@pytest.mark.slow
def test_a_working_copy_of_some_images_holds_nothing_else(world_blocks, tmp_path: Path) -> None:
    _, scene = world_blocks
    some = np.flatnonzero(scene.frame < 3)
    write_working_copy(tmp_path / "database.db", tmp_path / "part.db", scene, {0: scene.rigs[0]}, None, (), some)
    with sqlite3.connect(tmp_path / "part.db") as copy:
        names = {name for (name,) in copy.execute("SELECT name FROM images")}
        ends = {k for (p,) in copy.execute("SELECT pair_id FROM two_view_geometries") for k in divmod(p, MAX_IMAGES)}
        frames = copy.execute("SELECT COUNT(*) FROM frames").fetchone()[0]
        ids = {k for (k,) in copy.execute("SELECT image_id FROM images")}
    assert names == {scene.names[k] for k in some} and frames == 3 and ends == ids


def _cut(folder: Path, scene: Scene, frame: int) -> None:
    """No verified pair between the frames before and from ``frame`` on."""
    late = {number for k, number in image_ids(folder / "database.db", scene).items() if scene.frame[k] >= frame}
    drop_pairs(folder / "database.db", lambda *pair: len({*pair} & late) == 1)


@pytest.mark.slow
def test_two_surveys_in_one_folder_by_the_default_mapper(tmp_path: Path) -> None:
    """The mapper makes two models by itself; that they are two surveys, and which images, is said."""
    model, scene = moving_world(frames=12, points=1000)
    write_database(model, tmp_path / "database.db")
    _cut(tmp_path, scene, 7)
    result = run_sparse(tmp_path, scene, covariance_frames=0)
    assert result.mapper == "global" and result.components == (21, 15)
    assert [len(m.images) for m in result.models] == [21, 15]
    (said,) = (n for n in result.remarks.notes if "another survey" in n)
    assert said.startswith("15 images (cam0/007.jpg .. cam2/011.jpg) have no verified pair")
    assert "mapped separately" in said and len(result.tables["runs"]["rows"]) == 1
    assert result.tables["models"]["rows"][1][1] == 15
    assert len(result.remarks.dropped) == 15, "nothing is lost without a word"
    assert all(why.startswith("in model 1, not joined to the first") for _, why in result.remarks.dropped)
    true = image_poses(model, scene)
    for made, there in zip(result.models, (scene.frame < 7, scene.frame >= 7), strict=True):
        images = np.flatnonzero(there)  # the second: 5 frames, free lenses
        assert_reconstruction_near(pycolmap.Reconstruction(made.folder), scene, true, m=0.2, deg=2.0, images=images)


@pytest.mark.slow
def test_two_surveys_in_one_folder_become_two_models(world_blocks, tmp_path: Path) -> None:
    """The coarse model puts them side by side, but no verified pair ties them."""
    true, scene = world_blocks
    _cut(tmp_path, scene, 18)
    result = run_sparse(tmp_path, scene, {"preview": true}, covariance_frames=0)
    assert result.mapper == "preview" and [len(m.images) for m in result.models] == [54, 18]
    assert any("18 images" in n and "another survey" in n for n in result.remarks.notes)
    assert len(result.remarks.dropped) == 18
    assert {why for _, why in result.remarks.dropped} == {"in model 1, not joined to the first"}
    for made, there in zip(result.models, (scene.frame < 18, scene.frame >= 18), strict=True):
        images = np.flatnonzero(there)
        assert_reconstruction_near(pycolmap.Reconstruction(made.folder), scene, true, m=0.01, deg=0.15, images=images)
