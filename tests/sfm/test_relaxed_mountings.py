"""The mounting of cameras that fire at other instants than the first: found where the times are known, only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
from driving_world import INTERVAL_S, LATE_S, PLACES, YAWS, Drive, driving_world

from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.scene import Scene
from tiegraph.sfm.rig.linear import per_camera_frames
from tiegraph.sfm.rig.timeoffset import relaxed_mountings
from tiegraph.sfm.tuning.rig import RigTuning

TRUE = [transforms.invert(transforms.rigid(orient(y, 0, 0), np.array(p, float))) for y, p in zip(YAWS, PLACES)]


def _relaxed(drive: Drive) -> tuple[pycolmap.Reconstruction, Scene]:
    """A relaxed model with true poses, each camera at its own time; the scene gives a rig that is 3 degrees off."""
    model, scene = driving_world(drive)
    model = per_camera_frames(model, [1], scene)
    for image in model.images.values():
        time_s = INTERVAL_S * int(image.name[-7:-4]) + drive.late_s[image.camera_id - 1]
        pose = TRUE[image.camera_id - 1] @ transforms.invert(drive.pose_at(time_s))
        model.frame(image.frame_id).rig_from_world = rigid3d(pose)
    off = transforms.rigid(orient(3, 0, 0), np.zeros(3))
    sensors = [
        replace(s, sensor_from_rig=off @ s.sensor_from_rig) if k else s for k, s in enumerate(scene.rigs[0].sensors)
    ]
    times = np.arange(scene.frames) * INTERVAL_S
    return model, scene.with_(rigs=(replace(scene.rigs[0], sensors=tuple(sensors)),), time_s=times)


def test_mountings_are_found_with_the_times_of_the_cameras() -> None:
    drive = Drive(late_s=LATE_S, gain=3.0, weave_deg=4.0)
    model, scene = _relaxed(drive)
    late = {f"cam{k}": t for k, t in enumerate(LATE_S)}
    found = relaxed_mountings(model, scene, 0, late, RigTuning())
    assert sorted(found) == [f"cam{k}" for k in range(1, 6)]
    errors, sure = [], []
    for k in range(1, 6):
        mounting = found[f"cam{k}"]
        np.testing.assert_allclose(mounting.sensor_from_rig[:3, :3], TRUE[k][:3, :3], atol=np.radians(0.02))
        errors.append(np.linalg.norm(transforms.centre(mounting.sensor_from_rig) - PLACES[k]))
        sure.append((mounting.sigma_deg, mounting.sigma))
    assert max(errors) < 0.005  # half of 3 m/s2 times 50 ms squared is 3.8 mm
    assert all(0.05 <= deg < 0.2 and 0.02 <= metres < 0.05 for deg, metres in sure)  # what held them, at least


def test_without_the_times_the_motion_is_taken_for_the_mounting() -> None:
    """The other side: 50 ms at 5 m/s are a quarter of a metre."""
    model, scene = _relaxed(Drive(late_s=LATE_S))
    found = relaxed_mountings(model, scene, 0, {}, RigTuning())
    assert 0.2 < np.linalg.norm(transforms.centre(found["cam3"].sensor_from_rig) - PLACES[3]) < 0.3


def test_a_camera_of_few_frames_has_none() -> None:
    model, scene = _relaxed(Drive(frames=4, late_s=LATE_S))
    assert relaxed_mountings(model, scene, 0, {}, RigTuning()) == {}
