"""What a pixel looks at."""

import numpy as np
import pycolmap

from tiegraph.scene.rig import on_plane, pixel_rays, rays_or_axis

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
