"""Robust averages of the rig's extrinsics over frames of a model made without rig."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world, without_extrinsics

from tiegraph.geometry import transforms
from tiegraph.geometry.align import l1_mean_rotation
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.sfm.rig.rig import derive_rig
from tiegraph.sfm.tuning.rig import DeriveTuning


def test_l1_mean_ignores_a_third_of_outliers() -> None:
    rng = np.random.default_rng(0)
    true = Rotation.random(random_state=1)
    good = Rotation.from_rotvec(np.radians(0.3) * rng.standard_normal((20, 3))) * true
    bad = Rotation.from_rotvec(np.radians(60) * rng.standard_normal((10, 3))) * true
    mean = l1_mean_rotation(np.concatenate([good.as_matrix(), bad.as_matrix()]))
    assert 0 < transforms.angle_deg(mean, true.as_matrix()) < 0.4


def test_a_camera_that_moves_against_the_rig_is_left_out(tmp_path) -> None:
    """The truth with trivial frames, one camera shaken by 4 degrees: the others make the rig, it does not."""
    truth, scene = make_world(tmp_path / "database.db", cameras=3, frames=8)
    rng = np.random.default_rng(0)
    poses = {i: truth.image(i).cam_from_world() for i in truth.reg_image_ids()}
    shaken = max(truth.cameras)
    model = type(truth)()
    for camera in truth.cameras.values():
        model.add_camera_with_trivial_rig(camera)
    for i, pose in poses.items():
        image = truth.image(i)
        if image.camera_id == shaken:
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec(np.radians(4) * rng.standard_normal(3)).as_matrix()
            pose = rigid3d(turn) * pose
        fresh = type(image)(name=image.name, camera_id=image.camera_id, image_id=i)
        model.add_image_with_trivial_frame(fresh, pose)
    derived = derive_rig(without_extrinsics(scene), 0, [model], DeriveTuning())
    assert derived.rig is not None
    names = [name for name, _ in derived.left_out]
    assert names == [f"cam{shaken}"] and "not rigid" in derived.left_out[0][1]
    found = derived.rig.sensors[1].sensor_from_rig
    np.testing.assert_allclose(found, scene.rigs[0].sensors[1].sensor_from_rig, atol=1e-6)


def test_too_few_frames_give_no_rig(tmp_path) -> None:
    truth, scene = make_world(tmp_path / "database.db", cameras=2, frames=2)
    derived = derive_rig(without_extrinsics(scene), 0, [truth], DeriveTuning())
    assert derived.rig is None and "only 2 frames" in derived.left_out[0][1]
