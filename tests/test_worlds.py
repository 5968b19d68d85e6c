"""The synthetic survey is what it says: geometry, depths and images agree, and it is the same each time."""

from pathlib import Path

import cv2
import numpy as np

import worlds
from tiegraph.geometry import transforms


def test_depth_moves_pixels_onto_the_same_colour_in_the_next_image() -> None:
    rig, world = worlds.two_camera_rig(160, 120), worlds.corridor(seed=4)
    sensor = rig.sensors[0]
    assert sensor.camera is not None and sensor.sensor_from_rig is not None
    bodies = worlds.body_poses("up", 2, seed=4)
    a, b = (transforms.invert(p @ worlds.body_from_rig()) for p in bodies)
    image_a, image_b = world.render(sensor.camera, a), world.render(sensor.camera, b)
    depth_a, depth_b = world.depth_m(sensor.camera, a), world.depth_m(sensor.camera, b)
    k = sensor.camera.calibration_matrix()
    x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(k).T
    seen = transforms.apply(b @ transforms.invert(a), (depth_a[..., None] * rays)[np.isfinite(depth_a)])
    pixel = ((seen @ k.T)[:, :2] / seen[:, 2:]).astype(np.float32)
    u, v = (np.ascontiguousarray(pixel[None, :, c] - 0.5) for c in (0, 1))
    there = cv2.remap(image_b, u, v, cv2.INTER_LINEAR, borderValue=0)[0].astype(float)
    depth_there = cv2.remap(depth_b, u, v, cv2.INTER_NEAREST, borderValue=-1)[0]
    same = np.abs(depth_there - seen[:, 2]) < 0.05
    assert same.mean() > 0.4, "much of the image is in the next one too"
    difference = np.abs(there - image_a[np.isfinite(depth_a)].astype(float)).mean(axis=1)
    assert np.median(difference[same]) < 12 < np.median(difference[~same])


def test_survey_is_deterministic_and_complete(tmp_path: Path) -> None:
    first = worlds.make_survey(tmp_path / "a", passes=("up",), frames=1, size=(96, 72))
    second = worlds.make_survey(tmp_path / "b", passes=("up",), frames=1, size=(96, 72))
    names = sorted(p.relative_to(first.images).as_posix() for p in first.images.rglob("*.jpg"))
    assert names == sorted(first.cam_from_world) == ["up/cam0/000000.jpg", "up/cam1/000000.jpg"]
    assert all((first.images / n).read_bytes() == (second.images / n).read_bytes() for n in names)
    apart = first.centres_m(names)
    assert abs(np.linalg.norm(apart[0] - apart[1]) - 0.5) < 1e-9, "the rig's baseline"


def test_the_way_back_sees_the_wall_of_the_way_out_with_the_other_camera() -> None:
    out, back = (worlds.body_poses(track, 6, seed=0)[:, :3, :3] for track in ("up", "down"))
    axes = [s.optical_axis() @ worlds.body_from_rig()[:3, :3].T for s in worlds.two_camera_rig().sensors]
    assert (out[0] @ axes[0])[1] > 0.9 and (back[0] @ axes[1])[1] > 0.9
    assert (out[0] @ axes[1])[1] < -0.9
