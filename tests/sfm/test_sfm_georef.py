"""Placing a model in the world: scale, lever arm, held-out check, straight tracks, rig scale, levelling."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world, true_frames, with_positions

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene
from tiegraph.sfm.model import frame_poses, image_poses
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning.world import WorldTuning
from tiegraph.sfm.world.fit import Evidence, fit_similarity
from tiegraph.sfm.world.fixes import Measurements
from tiegraph.sfm.world.georef import georeference
from tiegraph.sfm.world.gravity import Up, up_vector
from tiegraph.sfm.world.unknowns import LeverArm

import pycolmap  # isort: skip

TUNING = WorldTuning()


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return make_world(tmp_path_factory.mktemp("world") / "database.db", cameras=3, frames=20)


def _moved(truth):
    """The truth in another frame and unit, as a mapper would give it."""
    model = pycolmap.Reconstruction(truth)
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_quat()
    model.transform(pycolmap.Sim3d(0.37, pycolmap.Rotation3d(turn), np.array([5.0, -3.0, 2.0])))
    return model


@pytest.mark.slow
def test_positions_bring_the_model_back(world) -> None:
    truth, scene = world
    true = true_frames(truth, scene)[:, :3, 3]
    noise = 0.1 * np.random.default_rng(0).standard_normal(true.shape)
    noise[3] = [8, 0, 0]  # an outlier
    survey = with_positions(scene, true + noise, 0.1)
    found = georeference(_moved(truth), survey, GeorefSettings(), TUNING)
    placed = frame_poses(image_poses(found.apply(_moved(truth)), scene), scene)[:, :3, 3]
    error = np.sqrt(np.mean(np.sum((placed - true) ** 2, axis=1)))
    assert found.placed and found.scale_source == "gnss"
    assert found.world_from_model.scale == pytest.approx(1 / 0.37, rel=0.03)
    assert 0.005 < error < 0.12  # better than one position, not perfect
    assert not found.residuals.inlier[3] and found.residuals.inlier.sum() >= 18
    assert 0.05 < np.hypot(*list(found.residuals.rms_m().values())[:2]) < 0.25
    held = np.isfinite(found.residuals.held_out_m).all(axis=1)
    assert held.sum() == len(found.residuals.held.residual_m) == found.to_dict()["held_out"]["count"] == 4
    assert found.to_dict()["held_out"]["sigma_m"] == pytest.approx(0.1 * np.sqrt(3))  # as stated
    assert 0.03 < found.residuals.held_out_rms_m()["east"] < 0.3
    # What all positions of a receiver share (0.1 m east and north) no residual shows.
    assert 0.14 < found.uncertainty.sigma["position_m"] < 0.2 and 0.1 < found.uncertainty.sigma["yaw_deg"] < 5
    assert error < 5 * found.uncertainty.sigma["position_m"]


def test_apply_scales_the_rig_too(world) -> None:
    truth, scene = world
    survey = with_positions(scene, true_frames(truth, scene)[:, :3, 3], 0.05)
    model = _moved(truth)
    placed = georeference(model, survey, GeorefSettings(), TUNING).apply(model)
    for sensor, pose in truth.rig(1).non_ref_sensors.items():
        np.testing.assert_allclose(placed.rig(1).sensor_from_rig(sensor).translation, pose.translation, atol=1e-4)


@pytest.mark.slow
def test_lever_arm_given_and_estimated(world) -> None:
    truth, scene = world
    true = true_frames(truth, scene)
    arm = np.array([0.9, -0.4, 0.5])
    survey = with_positions(scene, true[:, :3, 3] + true[:, :3, :3] @ arm, 0.05)
    given = survey.with_(rigs=(replace(scene.rigs[0], antenna_m=tuple(arm)),))
    without = georeference(_moved(truth), survey, GeorefSettings(antenna="ignored"), TUNING)
    with_arm = georeference(_moved(truth), given, GeorefSettings(), TUNING)
    assert max(with_arm.residuals.rms_m().values()) < 1e-3 < 0.05 < max(without.residuals.rms_m().values())
    estimated = georeference(_moved(truth), survey, GeorefSettings(antenna="estimated"), TUNING)
    np.testing.assert_allclose(estimated.receiver.antenna_m, arm, atol=0.1)
    assert any("estimated" in n for n in estimated.findings.notes)


@pytest.mark.slow
def test_a_stretch_of_multipath_does_not_hide_behind_the_lever_arm(world) -> None:
    truth, scene = world
    true, arm = true_frames(truth, scene), np.array([0.9, -0.4, 0.5])
    antenna = true[:, :3, 3] + true[:, :3, :3] @ arm + 0.02 * np.random.default_rng(1).standard_normal((20, 3))
    antenna[3:8] += [0.9, -0.6, 1.2]  # with the same sigma stated
    found = georeference(_moved(truth), with_positions(scene, antenna, 0.02), GeorefSettings(), TUNING)
    placed = frame_poses(image_poses(found.apply(_moved(truth)), scene), scene)[:, :3, 3]
    assert 0.001 < np.sqrt(np.mean(np.sum((placed - true[:, :3, 3]) ** 2, axis=1))) < 0.04
    np.testing.assert_allclose(found.receiver.antenna_m, arm, atol=0.05)
    assert not found.residuals.inlier[3:8].any() and found.residuals.inlier.sum() >= 15


def test_fixed_rig_alone_gives_the_scale(world) -> None:
    truth, scene = world
    found = georeference(_moved(truth), scene, GeorefSettings(), TUNING)
    assert not found.placed and found.scale_source == "rig baseline" and found.origin is None
    assert found.world_from_model.scale == pytest.approx(1 / 0.37, rel=1e-6)
    nominal = scene.with_(rigs=(replace(scene.rigs[0], nominal=True),))
    other = georeference(_moved(truth), nominal, GeorefSettings(), TUNING)
    assert other.scale_source == "none" and any("nominal" in n for n in other.findings.notes)
    shrink = np.array([[1, 1, 1, 0.02]] * 3 + [[1, 1, 1, 1]])
    short = tuple(replace(s, sensor_from_rig=s.sensor_from_rig * shrink) for s in scene.rigs[0].sensors)
    near = georeference(
        _moved(truth), scene.with_(rigs=(replace(scene.rigs[0], sensors=short),)), GeorefSettings(), TUNING
    )
    assert near.scale_source == "none" and any("no scale taken from the rig" in n for n in near.findings.notes)


@pytest.mark.slow
def test_images_that_hardly_carry_the_baseline_widen_the_scale_of_the_rig(world) -> None:
    truth, scene = world
    survey = with_positions(scene, 1.03 * true_frames(truth, scene)[:, :3, 3], 0.05)
    sure, vague = (
        georeference(_moved(truth), survey, GeorefSettings(), TUNING, Measurements(model_scale_sigma=s))
        for s in (1e-4, 0.05)
    )
    true_scale = 1 / 0.37
    assert sure.placing is not None and vague.placing is not None and sure.placing.model.scale is not None
    assert sure.placing.model.scale.sigma < 0.01
    assert vague.placing.model.scale == replace(sure.placing.model.scale, sigma=pytest.approx(0.05, rel=0.05))
    assert vague.world_from_model.scale == pytest.approx(1.03 * true_scale, rel=0.01)  # the positions have their say
    alone = georeference(_moved(truth), scene, GeorefSettings(), TUNING, Measurements(model_scale_sigma=0.05))
    assert alone.scale_source == "rig baseline" and any("scale good to 5.0%" in n for n in alone.findings.notes)


LEVEL = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float)  # world_from_cam of a level camera that looks north


def _up(turns, cameras=1):
    """What images of ``cameras`` cameras, turned (N, 3, 3) world_from_cam and frame by frame, say of up."""
    frames = len(turns) // cameras
    sensors = tuple(Sensor(f"cam{k}", None, None, "side") for k in range(cameras))
    names = [f"cam{k}/{f:03d}.jpg" for f in range(frames) for k in range(cameras)]
    frame, sensor = np.repeat(np.arange(frames), cameras), np.tile(np.arange(cameras), frames)
    scene = simple_scene(Rig("rig", sensors), names, frame, sensor, np.zeros(frames))
    return up_vector(transforms.rigid(np.swapaxes(turns, 1, 2), np.zeros((len(names), 3))), scene, TUNING.up)


def _off_deg(up):
    return np.degrees(np.arccos(min(1.0, up.direction[2])))


@pytest.mark.parametrize(("yaws", "ring"), [((80, -80), True), ((0, 180), True), ((0, 10), False), ((0, 60), False)])
def test_cameras_all_round_say_which_way_is_up(yaws: tuple[float, float], ring: bool) -> None:
    """Two that look away from each other do; of a stereo pair that drives in a circle only the x axes do."""
    for size in (0.0, 12.0):
        up = _up([
            Rotation.from_euler("ZXZ", [30.0 * f, size * (-1) ** (f // 2), yaws[k]], degrees=True).as_matrix() @ LEVEL
            for f in range(12) for k in range(2)
        ], cameras=2)  # fmt: skip
        assert up is not None and up.ring == ring and up.tilt
        assert up.direction[2] > 0.99
        if ring:
            assert up.sigma_deg == pytest.approx(max(size, 3.0), rel=0.1)


def _held(headings_deg, pitch_deg, roll_deg, rng):
    """Photographs (N, 3, 3) world_from_cam: all pitched alike, rolled with a sigma."""
    rolls = roll_deg * rng.standard_normal(len(headings_deg))
    angles = [[h, pitch_deg, 0.0] for h in headings_deg]
    turned = Rotation.from_euler("ZXZ", angles, degrees=True).as_matrix() @ LEVEL
    return turned @ Rotation.from_euler("z", rolls[:, None], degrees=True).as_matrix()


@pytest.mark.parametrize("pitch_deg", [25.0, 60.0, -50.0], ids=["up a facade", "up at a bridge", "down at a find"])
def test_photographs_held_level_say_which_way_is_up_however_they_are_pitched(pitch_deg: float) -> None:
    rng = np.random.default_rng(3)
    up = _up(_held(rng.uniform(-60, 60, 30), pitch_deg, 4.0, rng))
    assert up.tilt and not up.ring
    assert _off_deg(up) < min(4.0, 1.5 * up.sigma_deg) and 3.0 <= up.sigma_deg < 9.0


def test_photographs_of_one_heading_tell_the_roll_only_and_those_held_anyhow_nothing() -> None:
    rng = np.random.default_rng(4)
    facade = _up(_held(rng.uniform(-4, 4, 30), 10.0, 2.0, rng))
    assert not facade.tilt and 8 < _off_deg(facade) < 12 and facade.sigma_deg == TUNING.up.lone_sigma_deg
    assert _up(_held([0.0, 180.0] * 10, -90.0, 1.0, rng)) is None  # lines of a drone, to and fro
    assert _up(_held(rng.uniform(-180, 180, 30), -90.0, 1.0, rng)) is None  # straight down, or straight up?
    assert _up(Rotation.random(40, random_state=5).as_matrix()) is None


def test_trajectory_orientations_hold_the_roll(world) -> None:
    truth, scene = world
    poses = true_frames(truth, scene)
    survey = scene.with_(world_from_rig=poses, position_sigma_m=np.full((scene.frames, 3), 0.1), prior="trajectory")
    found = georeference(_moved(truth), survey, GeorefSettings(), TUNING)
    assert found.scale_source in ("trajectory", "rig baseline")
    placed = frame_poses(image_poses(found.apply(_moved(truth)), scene), scene)
    np.testing.assert_allclose(placed, poses, atol=1e-3)


@pytest.mark.slow
def test_to_dict_is_json(world) -> None:
    truth, scene = world
    survey = with_positions(scene, true_frames(truth, scene)[:, :3, 3], 0.05)
    found = georeference(_moved(truth), survey, GeorefSettings(), TUNING)
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["positions"] == 20
    assert found.counts()["inliers"] == 20


def _straight(noise_m: float, seed: int = 0) -> tuple[Evidence, Similarity]:
    """Thirty poses on a straight level line, upright; the model is turned, scaled and moved."""
    rng = np.random.default_rng(seed)
    true = Similarity(2.5, Rotation.from_euler("xyz", [0.6, 0.3, -1.0]).as_matrix(), np.array([10.0, 20.0, 3.0]))
    world = np.zeros((30, 3))
    world[:, 0] = np.linspace(0, 100, 30)
    world[:, 1] = 0.3 * np.linspace(0, 100, 30)
    pose = np.tile(np.eye(4), (30, 1, 1))
    pose[:, :3, 3] = (world - true.translation) @ true.rotation / true.scale
    upright = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
    pose[:, :3, :3] = true.rotation.T @ upright
    evidence = Evidence(
        frame=np.arange(30), pose=pose, position=world + noise_m * rng.standard_normal((30, 3)),
        sigma=np.full((30, 3), max(noise_m, 0.05)), orientation=np.full((30, 3, 3), np.nan), arm=LeverArm(np.zeros(3)),
        log_scale=None,
    )  # fmt: skip
    return evidence, true


def test_straight_track_needs_the_upward_direction() -> None:
    evidence, true = _straight(noise_m=0.3)
    up = Up(true.rotation.T @ np.array([0.0, 0.0, 1.0]), 3.0, True, True, "the ring")
    alone = fit_similarity(evidence, None, TUNING.fit)
    held = fit_similarity(evidence, up, TUNING.fit)
    tilt = lambda fit: np.degrees(np.arccos((fit.similarity.rotation @ up.direction)[2]))  # noqa: E731
    assert alone.roll_sigma_deg > 20
    assert tilt(held) < 1.0
    assert 0.1 < held.roll_sigma_deg < 5
    assert held.similarity.scale == pytest.approx(true.scale, rel=0.02)
    lone = fit_similarity(evidence, replace(up, ring=False, tilt=False, sigma_deg=10.0), TUNING.fit)
    assert tilt(lone) < 1.0
