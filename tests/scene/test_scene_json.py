"""Scenes: written and read unchanged, parts of them, geometry of rigs, and what a pixel looks at."""

import numpy as np
import pycolmap

from tiegraph.geometry.geodesy import make_origin
from tiegraph.scene.rig import Rig, Sensor, on_plane, pixel_rays, rays_or_axis
from tiegraph.scene.scene import Dropped, Scene, simple_scene


def scene():
    camera = pycolmap.Camera(model="OPENCV", width=64, height=48, params=[30, 31, 32, 24, 0.1, 0, 0, 0])
    turned = np.eye(4)
    turned[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    turned[:3, 3] = [0.1, 0, 0]
    rig = Rig("boat", (Sensor("cam0", camera, np.eye(4)), Sensor("cam1", camera, turned), Sensor("up", role="up")),
              antenna_m=(0, 0, 1.5))  # fmt: skip
    return simple_scene(rig, ["a/0", "a/1", "b/0"], np.array([0, 1, 0]), np.array([0, 0, 1]), np.zeros(2),
                        origin=make_origin(35, 139, 10), dropped=(Dropped("x.jpg", "truncated"),), sequences=("up",),
                        time_s=np.array([5.0, np.nan]))  # fmt: skip


def test_json_round_trip():
    one = scene()
    two = Scene.from_json(one.to_json())
    assert two.to_json() == one.to_json()
    assert two.names == one.names and two.dropped == one.dropped and two.origin == one.origin
    assert two.rigs[0].antenna_m == (0, 0, 1.5)
    np.testing.assert_array_equal(two.time_s, one.time_s)
    assert two.rigs[0].sensors[0].camera.params.tolist() == one.rigs[0].sensors[0].camera.params.tolist()


def test_exposure_is_there_where_it_is_known():
    one = scene().with_(exposure=np.array([0.25, np.nan, 2.0]))
    assert scene().exposure is None and Scene.from_json(scene().to_json()).exposure is None
    np.testing.assert_array_equal(Scene.from_json(one.to_json()).exposure, one.exposure)
    np.testing.assert_array_equal(one.only(np.array([0, 2])).exposure, [0.25, 2.0])


def test_rig_geometry_and_priors():
    rig = scene().rigs[0]
    assert abs(rig.axis_angles_deg()[0, 1] - 90) < 1e-9
    assert np.isnan(rig.axis_angles_deg()[0, 2]) and not rig.known()
    pose = np.full((2, 4, 4), np.nan)
    pose[0] = np.eye(4)
    priors = scene().with_(world_from_rig=pose).image_priors()
    np.testing.assert_allclose(np.linalg.inv(priors[2]), rig.sensors[1].sensor_from_rig, atol=1e-12)
    assert np.isnan(priors[1]).all()


def test_a_part_of_a_scene_keeps_what_its_images_are():
    whole = scene().with_(sources=("p", "q", "r"))
    part = whole.only(np.array([1, 2]))
    assert part.names == ("a/1", "b/0") and part.sources == ("q", "r") and part.frames == 2
    assert part.frame.tolist() == [1, 0] and part.sequence_index[part.frame].tolist() == [1, 0]
    assert part.sensor_key.tolist() == whole.sensor_key[1:].tolist()
    last = whole.only(np.array([1]))
    assert last.frames == 1 and last.frame.tolist() == [0] and np.isnan(last.time_s).all()
    assert last.world_from_rig.shape == (1, 4, 4) and last.origin == whole.origin


CAMERA = pycolmap.Camera(model="OPENCV", width=640, height=480, params=[500, 500, 320, 240, 0.1, 0.01, 0, 0])


def test_rays_come_back_to_their_pixels():
    xy = np.random.default_rng(0).uniform((0, 0), (640, 480), (50, 2))
    rays = pixel_rays(CAMERA, xy)
    assert np.allclose(np.linalg.norm(rays, axis=1), 1)
    assert np.allclose(CAMERA.img_from_cam(rays), xy, atol=1e-6)
    assert np.allclose(rays[:, :2] / rays[:, 2:], on_plane(CAMERA, xy))
    assert np.array_equal(rays_or_axis(CAMERA, xy), rays)
    assert np.array_equal(on_plane(CAMERA, xy[:1])[0], CAMERA.cam_from_img(xy[0]))


def test_pixels_without_inverse_are_nan_or_the_axis():
    far = np.array([[1e9, 1e9], [320.0, 240.0]])
    assert np.isnan(pixel_rays(CAMERA, far)[0]).all() and np.isfinite(pixel_rays(CAMERA, far)[1]).all()
    assert np.array_equal(rays_or_axis(CAMERA, far)[0], [0.0, 0.0, 1.0])


def test_beyond_90_degrees_a_fisheye_pixel_has_no_ray():
    params = [129.15, 129.26, 240, 240, 0.0381, -0.008, 0.00833, -0.00269]
    camera = pycolmap.Camera(model="OPENCV_FISHEYE", width=480, height=480, params=params)
    radius = np.arange(1.0, 239.0)
    rays = pixel_rays(camera, np.column_stack([240 + radius, np.full(len(radius), 240.0)]))
    angle = np.degrees(np.arccos(rays[:, 2]))
    known = np.isfinite(angle)
    assert known[radius < 212].all() and not known[radius > 218].any()
    assert (np.diff(angle[known]) > 0).all() and 86 < angle[known].max() < 90
