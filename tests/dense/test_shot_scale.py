"""The unit of a model by the depth maps of shots."""

import numpy as np

from tiegraph.dense.shotscale import Seen, in_camera, shot_scale
from tiegraph.geometry.transforms import apply, invert, rigid
from tiegraph.scene.results import DepthMap

K = np.array([[400.0, 0, 160], [0, 400, 120], [0, 0, 1]])
UNIT = 0.37  # metres


def wavy(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.6 + 0.3 * x + 0.02 * np.sin(40 * y)


def depth_of(camera: np.ndarray, noise: float = 0.0) -> DepthMap:
    """Depth of the surface from a camera shifted in x, y, by fixed point."""
    u, v = np.meshgrid((np.arange(320) + 0.5 - 160) / 400, (np.arange(240) + 0.5 - 120) / 400)
    place = invert(camera)[:3, 3]
    z = np.full(u.shape, 0.6)
    for _ in range(12):
        z = wavy(place[0] + u * z, place[1] + v * z)
    z = z + noise * np.random.default_rng(1).normal(size=z.shape)
    z[:, :40] = np.nan
    return DepthMap("a", z.astype(np.float32), z, np.ones(z.shape, np.uint8), K, camera)


def seen(shot: int, far: int = 300, noise: float = 3e-4) -> Seen:
    """Points of the surface in a wide camera, and more behind it that no depth map has."""
    rng = np.random.default_rng(shot)
    rig_from_wide = rigid(np.eye(3), np.array([0.04, 0.07, -0.005]))
    x, y = rng.uniform(-0.2, 0.2, (2, 300))
    points = np.column_stack([x, y, wavy(x, y)])
    behind = rng.uniform((-1, -1, 1.5), (1, 1, 3), (far, 3))
    depth = depth_of(rigid(np.eye(3), np.array([-0.05, 0.0, 0])), noise)
    return Seen(shot, apply(invert(rig_from_wide), np.concatenate([points, behind])) / UNIT, rig_from_wide, depth)


def test_points_on_the_surface_tell_the_unit():
    found = shot_scale([seen(0), seen(1), seen(2)])
    assert found.shots == 3 and 450 < found.points < 900  # not those that fall outside, or where the map has no depth
    assert 0 < abs(found.metres_per_unit / UNIT - 1) < 4e-4
    assert 0 < found.sigma < 3e-4
    each = seen(0).scales(UNIT * 1.01)
    np.testing.assert_allclose(each[np.isfinite(each)], UNIT, rtol=0.05)


def test_points_that_lie_on_no_map_tell_nothing():
    one = seen(0)
    off = Seen(0, one.points[300:], one.rig_from_camera, one.depth)
    assert shot_scale([off]) is None
    few = Seen(0, one.points[:9], one.rig_from_camera, one.depth)
    assert shot_scale([few]) is None and shot_scale([]) is None


def test_points_behind_the_camera_are_none():
    local = in_camera(np.eye(4), np.array([[0.0, 0, 1], [0, 0, -1]]))
    np.testing.assert_array_equal(local, [[0, 0, 1]])
