"""A rigid, synchronised rig is called so; a late camera is named, timed and relaxed; a loose one is named."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest
from moving_world import moving_world

from tiegraph.geometry import transforms
from tiegraph.sfm.adjust import final_adjustment
from tiegraph.sfm.model import image_poses
from tiegraph.sfm.rig.diagnosis import diagnose
from tiegraph.sfm.rig.health import COLUMNS, resect_all, sensor_health
from tiegraph.sfm.rig.relax import relax
from tiegraph.sfm.rig.soft import available
from tiegraph.sfm.rig.sync import rig_motion, time_offset

LATE_S = 0.04


def _rigid(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    return final_adjustment(model, [1], [1, 2, 3]).model


def test_a_good_rig_scatters_as_expected() -> None:
    model, scene = moving_world()
    found = diagnose(_rigid(model), scene, 1.0)
    assert found.moving == () and found.notes == []
    assert [h.name for h in found.health] == ["cam0", "cam1", "cam2"]
    for h in found.health:
        assert 0.5 < h.scatter_ratio < 2.0
        assert 0.0005 < h.scatter_m < 0.05 and 0.002 < h.scatter_deg < 0.2
    assert all(len(row) == len(COLUMNS) for row in found.rows)


def test_a_loose_camera_is_named() -> None:
    model, scene = moving_world(loose_deg=(0, 0, 0.2))
    found = diagnose(_rigid(model), scene, 1.0)
    assert found.moving == (0,)
    assert any("cam2 is not rigid" in note for note in found.notes)


def test_a_camera_that_comes_off_is_named_and_let_go() -> None:
    """At 2 degrees the adjustment throws its sightings out: that gives it away."""
    model, scene = moving_world(loose_deg=(0, 0, 2.0))
    found = diagnose(_rigid(model), scene, 1.0, model)
    assert found.moving == (0,) and 2 in found.loose


def test_resection_finds_the_lateness_of_one_camera() -> None:
    """Of three cameras one is late: in the true model it stands off by its offset times the speed."""
    model, scene = moving_world(late_s=(0, 0, LATE_S))
    found = resect_all(model, scene, 1.0)
    assert {h.name for h in sensor_health(found, scene)} == {"cam0", "cam1", "cam2"}
    poses = transforms.invert(image_poses(model, scene)[: scene.frames])  # cam0 is the rig
    motion = rig_motion(poses, scene)
    assert motion.timed
    own = found.where(scene.sensor_key[found.image] == 2)
    late = time_offset(own.residual(), own.covariance, motion.columns(scene.frame[own.image]))
    assert late is not None and abs(late.offset_s - LATE_S) < 0.25 * LATE_S
    assert 0 < late.sigma_s < 0.25 * LATE_S


def test_constant_speed_tells_no_offset_from_a_lever() -> None:
    columns = np.tile([0.0, 0, 3, 0, 0, 0], (20, 1)) + 1e-4 * np.random.default_rng(0).standard_normal((20, 6))
    residual = LATE_S * columns + 0.01 * np.random.default_rng(1).standard_normal((20, 6))
    late = time_offset(residual, np.tile(1e-4 * np.eye(6), (20, 1, 1)), columns)
    assert late is not None and late.sigma_s > 0.5 and not late.there(0.001)


@pytest.mark.slow
@pytest.mark.skipif(not available(), reason="pyceres is not there")
def test_a_late_camera_is_relaxed() -> None:
    model, scene = moving_world(late_s=(0, 0, LATE_S))
    rigid = _rigid(model)
    found = diagnose(rigid, scene, 1.0)
    assert found.moving == (0,) and any("not synchronised" in note for note in found.notes)
    relaxed = relax(rigid, scene, 0, (1.0, True), [1, 2, 3])
    assert relaxed.offsets[2].offset_s == pytest.approx(LATE_S, rel=0.15)
    assert abs(relaxed.offsets[1].offset_s) < 0.1 * LATE_S
    assert relaxed.model.compute_mean_reprojection_error() < 0.9 * rigid.compute_mean_reprojection_error()
    assert relaxed.model.num_reg_images() == len(scene)
    # in the relaxed model the late camera stands where it really was: ahead, by up to 0.14 m at the end
    poses = image_poses(relaxed.model, scene)
    last = [scene.image_index[f"cam{s}/017.jpg"] for s in (0, 2)]
    apart = transforms.apply(poses[last[0]], transforms.centre(poses[last[1]])[None])[0]
    assert apart[2] - 0.1 == pytest.approx(LATE_S * 0.4 * 8.5, abs=0.04)


@pytest.mark.slow
@pytest.mark.skipif(not available(), reason="pyceres is not there")
def test_a_relaxed_calibrated_rig_keeps_its_rotations_though_the_lenses_are_not_as_told() -> None:
    """Distortion that the calibration leaves out must not turn the cameras; the offset is found all the same."""
    model, scene = moving_world(late_s=(0, 0, LATE_S))
    for image_id in model.reg_image_ids():
        for point in model.image(image_id).points2D:
            ray = (point.xy - [400, 300]) / 400
            point.xy = point.xy + 400 * ray * 0.004 * (ray @ ray) + [0.6 * (ray[0] ** 2), 0.0]
    relaxed = relax(_rigid(model), scene, 0, (1.0, True), [1, 2, 3])
    assert relaxed.offsets[2].offset_s == pytest.approx(LATE_S, rel=0.25)
    poses = image_poses(relaxed.model, scene)
    for s in (1, 2):
        given = scene.rigs[0].sensors[s].sensor_from_rig
        turned = [
            float(transforms.angle_deg(poses[scene.image_index[f"cam{s}/{f:03d}.jpg"]][:3, :3]
                  @ poses[scene.image_index[f"cam0/{f:03d}.jpg"]][:3, :3].T, given[:3, :3]))
            for f in range(scene.frames)
        ]  # fmt: skip
        assert np.median(turned) < 0.2  # of it the car's own turn in the offset: 3 deg/s x 40 ms = 0.12 deg
