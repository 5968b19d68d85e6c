"""The unit of a model by the depth maps of shots."""

import numpy as np
import pytest

from tiegraph.dense.shotscale import first_guess, in_camera, points_scale, shot_scale
from tiegraph.dense.tuning import ShotScaleTuning
from tiegraph.geometry.transforms import apply, invert, rigid
from tiegraph.scene.results import DepthMap

TUNING = ShotScaleTuning()
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


def test_points_on_the_surface_tell_the_unit():
    rng = np.random.default_rng(0)
    rig_from_wide = rigid(np.eye(3), np.array([0.04, 0.07, -0.005]))
    x, y = rng.uniform(-0.2, 0.2, (2, 400))
    on_surface = np.column_stack([x, y, wavy(x, y)])
    rays = apply(invert(rig_from_wide), on_surface) / UNIT
    depth = depth_of(rigid(np.eye(3), np.array([-0.05, 0.0, 0])), noise=3e-4)
    found = points_scale(rays, rig_from_wide, depth, first_guess(depth, rays), TUNING)
    known = np.isfinite(found)
    assert 200 < known.sum() < 400  # not those that fall outside, or where the map has no depth
    np.testing.assert_allclose(found[known], UNIT, rtol=6e-3)
    total = shot_scale([found, found * 1.0002, np.full(5, 3.0)], TUNING)
    assert abs(total.metres_per_unit / UNIT - 1) < 4e-4 and total.shots == 2 and total.points == 2 * known.sum() + 5
    assert 5e-5 < total.sigma < 2e-4


def test_points_off_the_surface_are_outvoted_and_few_tell_nothing():
    assert shot_scale([np.full(TUNING.least_points - 1, 1.0)], TUNING) is None
    assert np.isnan(first_guess(depth_of(np.eye(4)), np.zeros((0, 3))))
    mixed = np.r_[np.full(100, UNIT), np.full(40, 2.0)]
    assert shot_scale([mixed], TUNING).metres_per_unit == pytest.approx(UNIT)


def test_points_behind_the_camera_are_none():
    local = in_camera(np.eye(4), np.array([[0.0, 0, 1], [0, 0, -1]]))
    np.testing.assert_array_equal(local, [[0, 0, 1]])
