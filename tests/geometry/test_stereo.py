import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.stereo import Pinhole, rectify, rectifying_rotation, usable_rays

K = np.array([[400.0, 0, 320], [0, 400, 240], [0, 0, 1]])
SIZE = (640, 480)
RANGE = (4.0, 40.0)


def camera(position, turn_deg=(0, 0, 0), K=K):
    rotation = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    return Pinhole(K, transforms.rigid(rotation, -rotation @ np.asarray(position, float)), SIZE)


PAIRS = {
    "right": camera((1, 0, 0)),
    "left": camera((-1, 0, 0)),
    "above": camera((0, -1, 0)),
    "diagonal": camera((0.7, 0.7, 0.1)),
    "convergent": camera((1.5, 0, 0), (0, 8, 0)),
    "rolled": camera((1, 0.2, 0), (2, -3, 40)),
    "half forward": camera((1, 0, 0.8)),
    "other focal": camera((1, 0, 0), K=np.diag([1.3, 1.3, 1]) @ K),
}


def points_seen(pair, partner, count=400):
    """World points in both images within the range, with their pixels."""
    rng = np.random.default_rng(0)
    pixels = rng.uniform((0, 0), SIZE, (count, 2))
    depth = 1 / rng.uniform(1 / RANGE[1], 1 / RANGE[0], count)
    world = np.c_[(pixels - K[:2, 2]) / 400, np.ones(count)] * depth[:, None]
    there = transforms.apply(partner.cam_from_world, world) @ partner.K.T
    ok = there[:, 2] > 0
    pixels_there = there[:, :2] / there[:, 2:]
    ok &= ((pixels_there >= 0) & (pixels_there <= SIZE)).all(axis=1)
    return pixels[ok], pixels_there[ok], depth[ok]


def map_pixels(homography, pixels):
    ray = np.c_[pixels, np.ones(len(pixels))] @ homography.T
    assert (ray[:, 2] > 0).all()
    return ray[:, :2] / ray[:, 2:]


@pytest.mark.parametrize("name", PAIRS)
def test_same_row_and_disparity_gives_depth(name):
    reference, partner = camera((0, 0, 0)), PAIRS[name]
    pair = rectify(reference, partner, RANGE, 1e6, 1024)
    pixels, there, depth = points_seen(reference, partner)
    inside_ray = np.c_[pixels, np.ones(len(pixels))] @ pair.rect_from_reference.T
    front = inside_ray[:, 2] > 0
    pixels, there, depth = pixels[front], there[front], depth[front]
    a, b = map_pixels(pair.rect_from_reference, pixels), map_pixels(pair.rect_from_partner, there)
    window = ((a >= 0) & (a <= pair.size)).all(axis=1)
    assert window.mean() > (0.6 if name == "half forward" else 0.9)  # there the epipole is near the border
    np.testing.assert_allclose(a[:, 1], b[:, 1], atol=1e-6)
    disparity = a[:, 0] - b[:, 0]
    assert (disparity[window] > -1e-6).all() and (disparity[window] < pair.disparities).all()
    inverse = pair.inverse_depth_per_px(*pixels.T) * (disparity + pair.offset)
    np.testing.assert_allclose(1 / inverse, depth, rtol=1e-9)


@pytest.mark.parametrize("name", PAIRS)
def test_resolution_is_kept(name):
    pair = rectify(camera((0, 0, 0)), PAIRS[name], RANGE, 1e7, 4096)
    stretch = pair.stretch(np.array([320.0]), np.array([240.0]))
    assert 0.7 < stretch[0] < 1.4


def test_limits_make_the_window_coarser():
    reference, partner = camera((0, 0, 0)), PAIRS["right"]
    free = rectify(reference, partner, RANGE, 1e7, 4096)
    few = rectify(reference, partner, RANGE, 1e7, 32)
    small = rectify(reference, partner, RANGE, 20_000, 4096)
    assert few.disparities <= 32 < free.disparities and few.focal < free.focal
    assert 15_000 < small.size[0] * small.size[1] < 22_000


def test_no_baseline_motion_along_the_view_and_no_common_part_are_refused():
    reference = camera((0, 0, 0))
    for other in (camera((0, 0, 0), (0, 5, 0)), camera((0, 0, 2))):
        assert rectifying_rotation(reference.cam_from_world, other.cam_from_world) is None
    assert rectify(reference, camera((0, 0, 2)), RANGE, 1e6, 512) is None
    for other, reach in ((camera((1, 0, 0), (0, 170, 0)), RANGE), (camera((100, 0, 0)), (4.0, 5.0))):
        assert rectify(camera((0, 0, 0)), other, reach, 1e6, 512) is None


def test_usable_rays_end_at_the_limit():
    at = np.radians([0, 64, 66, 120])
    rays = np.stack([np.sin(at), np.zeros(4), np.cos(at)], axis=1)
    assert usable_rays(rays).tolist() == [True, True, False, False]
