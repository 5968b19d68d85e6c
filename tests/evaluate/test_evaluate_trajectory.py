"""Trajectories with known errors: ATE, RPE, yaw drift, blocks and speed-up; paper 000's back-projection (eq. 4-6)."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.evaluate import trajectory
from tiegraph.evaluate.baseline import Reference, Side, compare_sides, stretch
from tiegraph.evaluate.survey import backprojection_rmse
from tiegraph.evaluate.trajectory import PoseMatch, evaluate_trajectory, registered_metrics
from tiegraph.evaluate.tuning import TrajectoryTuning, Tuning
from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import Registration
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

TUNING = TrajectoryTuning()


def river(frames: int = 60, step_m: float = 1.0) -> np.ndarray:
    """Poses (T, 4, 4) along a gentle bend, heading along it, z up."""
    s = np.arange(frames) * step_m
    heading = 0.004 * s
    turn = Rotation.from_rotvec(np.outer(heading, [0, 0, 1])).as_matrix()
    return transforms.rigid(turn, np.column_stack([s, 10 * np.sin(s / 40), 0.05 * np.sin(s)]))


def matched(estimate: np.ndarray, reference: np.ndarray) -> PoseMatch:
    n = len(reference)
    return PoseMatch(estimate, reference, np.zeros(n, int), np.arange(n))


def moved(poses: np.ndarray, scale: float, seed: int = 0) -> np.ndarray:
    rotation = Rotation.random(random_state=seed).as_matrix()
    shift = np.array([100.0, -40, 7])
    return transforms.rigid(rotation @ poses[:, :3, :3], scale * poses[:, :3, 3] @ rotation.T + shift)


def test_a_similarity_is_no_error_but_its_scale_shows() -> None:
    result = evaluate_trajectory(matched(moved(river(), 0.9), river()), (1.0, 10.0), TUNING)
    assert result.sim3.rmse_m < 1e-9 and abs(result.sim3.alignment.scale - 1 / 0.9) < 1e-9
    assert 1.0 < result.se3.rmse_m < 2.5
    assert 0.05 < result.relative[0].translation_m < 0.2 and 0.8 < result.relative[1].translation_m < 1.3
    assert result.within == 1.0 and result.absolute is None


@pytest.mark.slow
def test_a_model_that_nothing_told_the_scale_of_has_no_error_of_scale() -> None:
    match = matched(moved(river(120), 0.4), river(120))
    match = replace(match, parts={"pass": np.full(120, "up")})
    own, told = (evaluate_trajectory(match, (10.0, 1000.0), TUNING, metric=m) for m in (False, True))
    names = {m.name for m in own.metrics()}
    assert not names & {"ate_se3_rmse", "scale_error"} and {"ate_sim3_rmse", "rpe_10m_translation"} <= names
    assert {"ate_se3_rmse", "scale_error"} <= {m.name for m in told.metrics()}
    (row,) = own.tables()["trajectory by pass"]["rows"]
    columns = own.tables()["trajectory by pass"]["columns"]
    assert row[columns.index("rmse m")] < 1e-9 and own.relative[0].translation_m < 1e-9
    assert told.tables()["trajectory by pass"]["rows"][0][3] > 5 and told.relative[0].translation_m > 5
    loose = evaluate_trajectory(replace(match, group=np.full(120, -1)), (10.0,), TUNING, metric=False)
    assert loose.tables()["trajectory by pass"]["columns"] == ["pass", "matched", "rmse m", "median m", "max m"]
    assert "relative pose error" not in loose.tables() and "yaw_drift" not in {m.name for m in loose.metrics()}


@pytest.mark.slow
def test_noise_comes_out_as_it_went_in() -> None:
    truth = river(400)
    noisy = truth.copy()
    noisy[:, :3, 3] += np.random.default_rng(1).normal(0, 0.1, (400, 3))
    result = evaluate_trajectory(matched(moved(noisy, 1.0), truth), (10.0,), TUNING)
    assert 0.16 < result.se3.rmse_m < 0.19  # 0.1 sqrt(3)
    assert 0.22 < result.relative[0].translation_m < 0.27  # two ends
    assert result.relative[0].rotation_deg < 1e-3
    assert 0.5 < result.within < 1


def test_one_wrong_image_counts_in_ate_but_not_for_the_others() -> None:
    wrong = river()
    wrong[30, 2, 3] += 50
    result = evaluate_trajectory(matched(wrong, river()), (1.0,), TUNING)
    assert result.sim3.max_m > 20 and result.within == pytest.approx(59 / 60)


@pytest.mark.slow
def test_yaw_drift_is_read_per_100_m() -> None:
    truth = river(120)
    turn = Rotation.from_rotvec(np.outer(np.radians(0.02 * np.arange(120)), [0, 0, 1])).as_matrix()
    drifting = transforms.rigid(turn @ truth[:, :3, :3], truth[:, :3, 3])
    result = evaluate_trajectory(matched(drifting, truth), (1.0,), TUNING)
    length = trajectory.path_length(truth[:, :3, 3])[-1]
    assert result.yaw_drift_deg_per_100m == pytest.approx(0.02 * 119 / length * 100, rel=0.02)
    assert np.isnan(evaluate_trajectory(matched(truth[:4], truth[:4]), (1.0,), TUNING).yaw_drift_deg_per_100m)


@pytest.mark.slow
def test_each_pass_and_section_is_judged_by_itself() -> None:
    """Up without error, down with a drift of the heading and 0.3 m of noise where it is below the bridge."""
    truth = np.concatenate([river(100), river(100)[::-1]])
    turn = Rotation.from_rotvec(np.outer(np.radians(0.05 * np.arange(100)), [0, 0, 1])).as_matrix()
    estimate = truth.copy()
    estimate[100:, :3, :3] = turn @ truth[100:, :3, :3]
    bridge = np.zeros(200, bool)
    bridge[140:160] = True
    estimate[bridge, :3, 3] += np.random.default_rng(3).normal(0, 0.3, (20, 3))
    parts = {"pass": np.repeat(["up", "down"], 100), "section": np.where(bridge, "1", "0")}
    group, order = np.repeat([0, 1], 100), np.tile(np.arange(100), 2)
    match = PoseMatch(estimate, truth, group, order, parts)
    tables = evaluate_trajectory(match, (10.0, 100.0, 1000.0), TUNING).tables()
    found = tables["trajectory by pass"]
    up, down = (dict(zip(found["columns"], row)) for row in found["rows"])
    assert up["pass"] == "up" and up["matched"] == down["matched"] == 100 and 95 < up["path m"] < 115
    assert up["rmse m"] < 0.05 and 0.15 < down["rmse m"] < 0.35
    assert up["RPE 10 m, m"] < 1e-9 and down["RPE 10 m, m"] > 0.2, "noise and heading"
    assert abs(up["yaw drift deg/100 m"]) < 0.01 and down["yaw drift deg/100 m"] == pytest.approx(5, rel=0.1)
    assert "RPE 1000 m, m" not in found["columns"]
    found = tables["trajectory by section"]
    rows = {row[0]: dict(zip(found["columns"], row)) for row in found["rows"]}
    assert rows["1"]["matched"] == 20 and 0.4 < rows["1"]["rmse m"] < 0.65 and rows["0"]["rmse m"] < 0.05
    assert 15 < rows["1"]["path m"] < 25


@pytest.mark.slow
def test_absolute_error_sees_the_shift() -> None:
    shifted = river()
    shifted[:, :3, 3] += [0.3, 0, 0.4]
    result = evaluate_trajectory(matched(shifted, river()), (1.0,), TUNING, same_frame=True)
    assert result.absolute.rmse_m == pytest.approx(0.5) and result.se3.rmse_m < 1e-9
    assert "absolute_rmse" in [m.name for m in result.metrics()]


def test_a_distance_no_step_fits_has_no_figure_and_two_poses_cannot_be_aligned() -> None:
    far = trajectory.relative_error(matched(river(10, 5.0), river(10, 5.0)), 1.0, TUNING.max_stretch)
    assert far.count == 0 and np.isnan(far.translation_m)
    with pytest.raises(ValueError, match="at least 3"):
        evaluate_trajectory(matched(river(2), river(2)), (1.0,), TUNING)


def test_registered_shares() -> None:
    images = Registration(np.array([True, False, True, True]), np.array([10, 0, 9, 500]), 10)  # 9 points are too few
    assert {m.name: m.value for m in registered_metrics(images)} == {"registered_images": 50.0, "images_by_rig": 25.0}


def out_and_back(frames: int = 20) -> tuple[Scene, np.ndarray]:
    """Two passes along one line, two cameras; places (F, 3): the way back in reverse, 5 m beside."""
    rig = Rig("pair", (Sensor("a", None, np.eye(4)), Sensor("b", None, np.eye(4))))
    names = [f"{p}/{c}/{k:03d}.jpg" for p in ("down", "up") for c in "ab" for k in range(frames)]
    frame = np.array([k + frames * p for p in range(2) for _ in "ab" for k in range(frames)])
    sensor = np.array([c for _ in range(2) for c in range(2) for _ in range(frames)])
    scene = simple_scene(
        rig, names, frame, sensor, np.repeat([0, 1], frames), np.tile(np.arange(frames), 2), sequences=("down", "up")
    )
    x = np.arange(frames, dtype=float)
    along = np.r_[x, x[::-1]]
    return scene, np.column_stack([along, np.repeat([0.0, 5.0], frames), np.zeros(2 * frames)])


def test_a_block_is_a_stretch_of_both_passes_and_keeps_what_was_not_registered() -> None:
    scene, centres = out_and_back()
    lost = np.array(centres)
    lost[[9, 11, 30]] = np.nan
    for places in (centres, lost):
        taken = np.unique(scene.frame[stretch(scene, places, 40)])
        down, up = taken[taken < 20], taken[taken >= 20]
        assert 18 <= len(taken) <= 22 and abs(len(down) - len(up)) <= 6
        assert np.array_equal(down, np.arange(down[0], down[-1] + 1))  # connected, also over the frames that were lost
        assert np.array_equal(up, np.arange(up[0], up[-1] + 1))
        assert 9 in down and 11 in down
    # whole frames, and all of the survey when that is asked for
    assert len(stretch(scene, centres, 39)) == 40 and len(stretch(scene, centres, 10_000)) == len(scene)
    with pytest.raises(ValueError, match="no frame has a place"):
        stretch(scene, np.full_like(centres, np.nan), 40)


def test_loose_photographs_without_a_place_are_taken_by_their_names() -> None:
    names = [f"{k}.jpg" for k in range(10)]
    scene = simple_scene(Rig("one", (Sensor("a", None),)), names, np.arange(10), np.zeros(10, int))
    centres = np.column_stack([np.arange(10.0), np.zeros((10, 2))])
    centres[4] = np.nan
    taken = stretch(scene, centres, 4)
    assert 4 in taken and np.array_equal(taken, np.arange(taken[0], taken[-1] + 1))


def sides(lost: int = 0, bent_m: float = 0.0) -> tuple[Side, Side, Reference]:
    """Ours: 1 cm off, 60 s of CPU; theirs: 120 s, the first images ``lost``, the last half off by ``bent_m``."""
    rng = np.random.default_rng(1)
    true = rng.uniform(0, 30, (40, 3))
    every = np.ones(40, bool)
    ours = Side("tiegraph", every, true + rng.normal(0, 0.01 / 3**0.5, true.shape), np.full(40, 0.008),
                {"match": (50.0, 30.0), "sparse": (10.0, 10.0)}, {"pairs matched": 100})  # fmt: skip
    other = true * 0.5 + rng.normal(0, 0.005 / 3**0.5, true.shape)  # half the scale
    other[20:, 2] += 0.5 * bent_m
    there = np.arange(40) >= lost
    theirs = Side("COLMAP", there, np.where(there[:, None], other, np.nan), np.where(there, 0.004, np.nan),
                  {"match": (120.0, 60.0)}, {"pairs matched": 780})  # fmt: skip
    return ours, theirs, Reference(true, True, 0.3)


def rows(result: dict) -> dict[str, list]:
    return {row[0]: row[1:] for row in result["figures"]["rows"]}


@pytest.mark.slow
def test_equal_registration_is_a_plain_speed_up() -> None:
    result = compare_sides(*sides(), ["0"] * 40)
    (said,) = result["speed_up"]
    assert said.startswith("speed-up at equal registration: 2 ") and "same 40 images" in said
    found = rows(result)
    assert found["CPU s per registered image"] == [1.5, 3.0, 2.0] and found["wall s"] == [40.0, 60.0, 1.5]
    assert all(0.006 < e < 0.014 for e in found["ATE, m"][:2])
    # sigmas in metres: the model of half the scale too
    assert found["sigma of a position, median, m"][:2] == pytest.approx([0.008, 0.008], rel=0.01)


@pytest.mark.slow
def test_a_speed_up_names_the_images_that_are_lost() -> None:
    ours, theirs, reference = sides(lost=10)
    section = ["open"] * 20 + ["bridge"] * 20
    result = compare_sides(ours, theirs, reference, section)
    (said,) = result["speed_up"]
    assert "speed-up 2.667 per registered image, not at equal registration: COLMAP loses 10 images" in said
    assert result["lost"] == {"COLMAP": 10, "tiegraph": 0}
    by_section = {row[0]: row for row in result["sections"]["rows"]}
    assert by_section["open"][1:4] == [20, 20, 10] and by_section["bridge"][1:4] == [20, 20, 20]
    both = compare_sides(replace(ours, registered=np.arange(40) < 38), theirs, reference, section)
    assert both["lost"] == {"COLMAP": 10, "tiegraph": 2}
    assert "tiegraph loses 2" in both["speed_up"][0]


@pytest.mark.slow
def test_a_bent_model_registers_all_and_is_not_called_equal() -> None:
    ours, theirs, reference = sides(bent_m=8.0)
    result = compare_sides(ours, theirs, reference, ["0"] * 40)
    assert "tiegraph 40 of its 40, COLMAP 20 of its 40: speed-up 4 per image at its place" in result["speed_up"][1]
    assert 1.5 < rows(result)["ATE, m"][1] < 4.5
    # by the poses of one side no place is proven
    own = compare_sides(ours, theirs, replace(reference, measured=False), ["0"] * 40)
    assert len(own["speed_up"]) == 1 and rows(own)["registered and at their place"][:2] == [None, None]


def test_a_side_without_a_model_has_no_speed_up() -> None:
    ours, theirs, reference = sides()
    none = replace(theirs, registered=np.zeros(40, bool), centres=np.full((40, 3), np.nan))
    result = compare_sides(ours, none, reference, ["0"] * 40)
    assert result["speed_up"] == ["no speed-up can be stated: COLMAP registered no image"]
    assert rows(result)["ATE, m"][1] is None and rows(result)["CPU s per registered image"][1] is None


TRIED = Tuning().points_tried


def looking(angle_deg: float, at: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    a = np.radians(angle_deg)
    rotation = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return transforms.invert(transforms.rigid(rotation, np.array(at, float)))


def wall(depth: float, points: int = 20000) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(-20, 20, points), rng.uniform(-8, 8, points), np.full(points, depth)])


def found(points: np.ndarray, *poses: np.ndarray) -> tuple[float, float, int]:
    """RMSE, rounding and points of images with these cam_from_world and K = [[500, 0, 320], [0, 510, 240], [0, 0, 1]];
    one more has no pose."""
    model = pycolmap.Reconstruction()
    params = [500.0, 510, 320, 240]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="PINHOLE", width=640, height=480, params=params, camera_id=1)
    )
    for k, pose in enumerate(poses):
        image = pycolmap.Image(name=f"{k}.jpg", camera_id=1, image_id=k + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    model.add_image_with_trivial_frame(pycolmap.Image(name="z.jpg", camera_id=1, image_id=9))
    return backprojection_rmse(points, model, TRIED)


@pytest.mark.parametrize("depth", [5.0, 20.0])
def test_error_is_the_rounding_alone(depth: float) -> None:
    poses = looking(0), looking(8, (1, 0, 0))
    rmse, rounding, points = found(wall(depth), *poses)
    expected = depth * np.sqrt(2 / 12) / 505
    assert 0.95 * expected < rmse < 1.05 * expected
    assert 0.95 < rmse / rounding < 1.05
    alone = [found(wall(depth), pose) for pose in poses]
    assert all(0.9 * expected < one < 1.2 * expected for one, _, _ in alone)
    assert points == sum(count for _, _, count in alone) > 1000


def test_a_wrong_pose_does_not_show_and_nothing_seen_is_nan_not_zero() -> None:
    """The reason the figure proves nothing: a view a metre off has the same error."""
    right, wrong = (found(wall(20.0), looking(0, (x, 0, 0)))[0] for x in (0, 1))
    assert abs(wrong / right - 1) < 0.05
    rmse, _, points = found(wall(10.0, 100), looking(180))
    assert points == 0 and np.isnan(rmse)
