"""Rays of a camera and their angles to epipolar planes."""

import numpy as np

from tiegraph.geometry.rays import cross, off_plane, unit_rays


def pairs(angle: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays of 40 points from two centres, the second turned off the epipolar plane; the way to the second centre."""
    rng = np.random.default_rng(0)
    xyz, way = rng.uniform((-4, -3, 6), (4, 3, 12), (40, 3)), np.tile([1.0, 0.2, 0.1], (40, 1))
    first, second = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (xyz, xyz - way))
    normal = np.cross(way, first)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return first, np.cos(angle) * second + np.sin(angle) * normal, way


def test_unit_rays_go_through_their_places_and_keep_nan():
    rays = unit_rays(np.array([[0.3, -0.4], [0.0, 0.0], [np.nan, 1.0]]))
    assert np.allclose(np.linalg.norm(rays[:2], axis=1), 1) and np.allclose(rays[0, :2] / rays[0, 2], [0.3, -0.4])
    assert np.isnan(rays[2]).all()


def test_cross_is_numpys():
    a, b = np.random.default_rng(0).normal(size=(2, 20, 3))
    assert np.allclose(cross(a, b), np.cross(a, b))


def test_angles_to_the_plane_are_those_by_which_rays_were_turned():
    for angle in (0.0, 1e-4, 0.02):
        first, second, way = pairs(angle)
        assert np.allclose(off_plane(way, first, np.cross(first, second)), np.sin(angle), atol=1e-12)
