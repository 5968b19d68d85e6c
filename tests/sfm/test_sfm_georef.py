"""Placing a model in the world: scale, lever arm, held-out check, straight tracks, rig scale, levelling."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from sfm_worlds import World, elsewhere, make_world, true_frames, with_positions

from tiegraph.geometry.geodesy import make_origin
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.world.fixes import Measurements


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return make_world(tmp_path_factory.mktemp("world") / "database.db", cameras=3, frames=20)


@pytest.mark.slow
def test_positions_bring_the_model_back(world) -> None:
    noise = 0.1 * np.random.default_rng(0).standard_normal((20, 3))
    noise[3] = [8, 0, 0]  # an outlier
    survey = with_positions(world.scene, world.centres + noise, 0.1)
    found = world.placed_by(survey)
    error = world.error_m(found.apply(elsewhere(world.truth)))
    assert found.placed and found.scale_source == "gnss"
    assert found.world_from_model.scale == pytest.approx(1 / 0.37, rel=0.03)
    assert 0.005 < error < 0.12  # better than one position, not perfect
    assert not found.residuals.inlier[3] and found.residuals.inlier.sum() >= 18
    assert 0.05 < np.hypot(*list(found.residuals.rms_m().values())[:2]) < 0.25
    held = np.isfinite(found.residuals.held_out_m).all(axis=1)
    assert held.sum() == len(found.residuals.held_m) == found.to_dict()["held_out"]["count"] == 4
    assert found.to_dict()["held_out"]["sigma_m"] == pytest.approx(0.1 * np.sqrt(3))  # as stated
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["positions"] == 20
    assert found.counts()["inliers"] == found.residuals.inlier.sum()
    assert 0.03 < found.residuals.held_out_rms_m()["east"] < 0.3
    # What all positions of a receiver share (0.07 m east and north) no residual shows.
    assert 0.1 < found.uncertainty.sigma["position_m"] < 0.2 and 0.1 < found.uncertainty.sigma["yaw_deg"] < 5
    assert error < 5 * found.uncertainty.sigma["position_m"]
    # A shift of datum; one datum by two names.
    for crs, place, tied_m in (("EPSG:27700", (52.0, -1.0, 0.0), 2.0), ("EPSG:6677", (36.0, 140.0, 0.0), 0.0)):
        here = replace(survey, origin=make_origin(*place, crs))
        there = world.placed_by(here).uncertainty.sigma
        assert there["position_m"] == pytest.approx(np.hypot(found.uncertainty.sigma["position_m"], tied_m), rel=0.01)
        assert there["height_m"] == found.uncertainty.sigma["height_m"]


def test_positions_that_do_not_tell_the_size_place_nothing(world) -> None:
    """Twenty photographs from one spot, to which positions of 5 m give places a millimetre apart."""
    survey = with_positions(world.scene, 0.001 * np.random.default_rng(0).standard_normal((20, 3)), 5.0)
    assert world.placed_by(survey).placed  # the rig tells its size
    found = world.placed_by(survey.with_(rigs=tuple(replace(r, nominal=True) for r in survey.rigs)))
    assert not found.placed and any("do not determine its size" in n for n in found.findings.notes)


ARM = (0.9, -0.4, 0.5)


def _antenna(world: World) -> np.ndarray:
    """Where it is at each frame, so far from the first camera."""
    true = true_frames(*world)
    return true[:, :3, 3] + true[:, :3, :3] @ ARM


@pytest.mark.slow
def test_lever_arm_given_and_estimated(world) -> None:
    survey = with_positions(world.scene, _antenna(world), 0.05)
    without = world.placed_by(survey, antenna="ignored")
    with_arm = world.placed_by(survey.with_(rigs=(replace(survey.rigs[0], antenna_m=ARM),)))
    assert max(with_arm.residuals.rms_m().values()) < 1e-3 < 0.05 < max(without.residuals.rms_m().values())
    estimated = world.placed_by(survey, antenna="estimated")
    np.testing.assert_allclose(estimated.antenna_m, ARM, atol=0.1)
    assert any("estimated" in n for n in estimated.findings.notes)


@pytest.mark.slow
def test_a_stretch_of_multipath_does_not_hide_behind_the_lever_arm(world) -> None:
    antenna = _antenna(world) + 0.02 * np.random.default_rng(1).standard_normal((20, 3))
    antenna[3:8] += [0.9, -0.6, 1.2]  # with the same sigma stated
    found = world.placed_by(with_positions(world.scene, antenna, 0.02))
    assert 0.001 < world.error_m(found.apply(elsewhere(world.truth))) < 0.04
    np.testing.assert_allclose(found.antenna_m, ARM, atol=0.05)
    assert not found.residuals.inlier[3:8].any() and found.residuals.inlier.sum() >= 15


def test_fixed_rig_alone_gives_the_scale(world) -> None:
    scene = world.scene
    found = world.placed_by(scene)
    assert not found.placed and found.scale_source == "rig baseline" and found.origin is None
    assert found.world_from_model.scale == pytest.approx(1 / 0.37, rel=1e-6)
    shrink = np.array([[1, 1, 1, 0.02]] * 3 + [[1, 1, 1, 1]])
    short = tuple(replace(s, sensor_from_rig=s.sensor_from_rig * shrink) for s in scene.rigs[0].sensors)
    for change, said in (({"nominal": True}, "nominal"), ({"sensors": short}, "the rig gives no scale")):
        none = world.placed_by(scene.with_(rigs=(replace(scene.rigs[0], **change),)))
        assert none.scale_source == "none" and any(said in n for n in none.findings.notes)


@pytest.mark.slow
def test_images_that_hardly_carry_the_baseline_widen_the_scale_of_the_rig(world) -> None:
    survey = with_positions(world.scene, 1.03 * world.centres, 0.05)
    sure, vague = (world.placed_by(survey, Measurements(model_scale_sigma=s)) for s in (1e-4, 0.05))
    (sure,), (vague_scale,) = (f.placing.measured.lengths for f in (sure, vague))
    assert sure.sigma < 0.01 and vague_scale == replace(sure, sigma=pytest.approx(0.05, rel=0.05))
    assert vague.world_from_model.scale == pytest.approx(1.03 / 0.37, rel=0.01)  # the positions have their say
    alone = world.placed_by(world.scene, Measurements(model_scale_sigma=0.05))
    assert alone.scale_source == "rig baseline" and any("scale good to 5.0%" in n for n in alone.findings.notes)


def test_a_trajectory_holds_the_roll_and_the_rig_is_scaled_too(world) -> None:
    truth, scene = world
    poses = true_frames(truth, scene)
    survey = scene.with_(world_from_rig=poses, position_sigma_m=np.full((scene.frames, 3), 0.1), prior="trajectory")
    found = world.placed_by(survey)
    assert found.scale_source in ("trajectory", "rig baseline")
    placed = frame_poses(image_poses(found.apply(elsewhere(truth)), scene), scene)
    np.testing.assert_allclose(placed, poses, atol=1e-3)
    placed = world.placed_by(world.measured(0.0, sigma_m=0.05)).apply(elsewhere(truth))
    for sensor, pose in truth.rig(1).non_ref_sensors.items():
        np.testing.assert_allclose(placed.rig(1).sensor_from_rig(sensor).translation, pose.translation, atol=1e-4)
