"""ATE, RPE and yaw drift on trajectories with known errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.evaluate import trajectory
from tiegraph.evaluate.trajectory import PoseMatch, evaluate_trajectory, registered_metrics
from tiegraph.evaluate.tuning import TrajectoryTuning
from tiegraph.geometry import transforms
from tiegraph.scene.registered import Registration

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


def test_yaw_drift_is_read_per_100_m() -> None:
    truth = river(120)
    turn = Rotation.from_rotvec(np.outer(np.radians(0.02 * np.arange(120)), [0, 0, 1])).as_matrix()
    drifting = transforms.rigid(turn @ truth[:, :3, :3], truth[:, :3, 3])
    result = evaluate_trajectory(matched(drifting, truth), (1.0,), TUNING)
    length = trajectory.path_length(truth[:, :3, 3])[-1]
    assert result.yaw_drift_deg_per_100m == pytest.approx(0.02 * 119 / length * 100, rel=0.02)
    assert np.isnan(evaluate_trajectory(matched(truth[:4], truth[:4]), (1.0,), TUNING).yaw_drift_deg_per_100m)


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
