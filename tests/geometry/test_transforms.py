"""Motions, similarities and rays."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity, robust_umeyama, umeyama
from tiegraph.geometry.transforms import cross, off_plane, unit_rays

vectors = arrays(float, 3, elements=st.floats(-100, 100))


def pose(rotvec, t):
    return transforms.rigid(Rotation.from_rotvec(rotvec / 50).as_matrix(), t)


@given(vectors, vectors)
@settings(max_examples=50, deadline=None)
def test_inverses_undo_and_quaternions_come_back(rotvec, t):
    a = pose(rotvec, t)
    np.testing.assert_allclose(transforms.invert(a) @ a, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(transforms.apply(a, transforms.centre(a)[None]), 0, atol=1e-9)
    q = transforms.quaternion_xyzw(a[:3, :3])
    np.testing.assert_allclose(transforms.from_quaternion_wxyz(np.roll(q, 1), t), a, atol=1e-9)


def test_angle_between_rotations():
    a, b = np.eye(3), Rotation.from_euler("y", 72, degrees=True).as_matrix()
    assert abs(transforms.angle_deg(a, b) - 72) < 1e-9


def test_interpolation_is_halfway_and_respects_gaps():
    times = np.array([0.0, 2.0, 10.0])
    poses = np.stack([pose(np.array([0, 0, 0.0]), [0, 0, 0]), pose(np.array([0, 0, 50.0]), [4, 0, 0]),
                      pose(np.array([0, 0, 50.0]), [8, 0, 0])])  # fmt: skip
    out = transforms.interpolate(times, poses, np.array([1.0, 5.0, 11.0, np.nan, 2.0]), max_gap_s=3.0)
    np.testing.assert_allclose(out[0, :3, 3], [2, 0, 0])
    assert abs(transforms.angle_deg(np.eye(3), out[0, :3, :3]) - np.degrees(0.5)) < 1e-9
    assert np.isnan(out[1]).all() and np.isnan(out[2]).all() and np.isnan(out[3]).all()
    np.testing.assert_allclose(out[4], poses[1])


@given(vectors, vectors)
@settings(max_examples=50, deadline=None)
def test_jacobians_of_rotation_vectors(rotvec, direction):
    v, step = rotvec / max(np.linalg.norm(rotvec), 1.0) * 3.0, direction / 100 * 1e-6
    by_vector = transforms.turn_by_vector(v[None])[0]
    moved = Rotation.from_rotvec(v + step) * Rotation.from_rotvec(v).inv()
    np.testing.assert_allclose(moved.as_rotvec(), by_vector @ step, atol=1e-11)
    np.testing.assert_allclose(transforms.vector_by_turn(v[None])[0] @ by_vector, np.eye(3), atol=1e-9)


def test_jacobians_of_rotation_vectors_where_their_series_begin():
    ends = np.array([[0.0, 0.0, 0.9999e-3], [0.0, 0.0, 1.0001e-3]])
    for jacobian in (transforms.turn_by_vector, transforms.vector_by_turn):
        first, second = jacobian(ends)
        np.testing.assert_allclose(first, second, atol=2e-7)
        np.testing.assert_array_equal(jacobian(np.zeros((1, 3)))[0], np.eye(3))


def world(seed=0, n=40):
    rng = np.random.default_rng(seed)
    truth = Similarity(2.5, Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3) * 10)
    source = rng.normal(size=(n, 3)) * 5
    return truth, source, rng


def test_similarities_are_recovered_exactly_and_never_a_mirror():
    truth, source, _ = world()
    fit = umeyama(source, truth(source))
    assert abs(fit.scale - 2.5) < 1e-12
    np.testing.assert_allclose(fit.matrix, truth.matrix, atol=1e-9)
    rigid = umeyama(source, Similarity(1.0, truth.rotation, truth.translation)(source), with_scale=False)
    np.testing.assert_allclose(rigid.rotation, truth.rotation, atol=1e-9)
    assert rigid.scale == 1.0
    rng = np.random.default_rng(1)
    source = rng.normal(size=(10, 3))
    fit = umeyama(source, source * [1, 1, -1])
    assert np.linalg.det(fit.rotation) > 0.99
    with pytest.raises(ValueError, match="at least 3 points, got 2"):
        umeyama(np.zeros((2, 3)), np.zeros((2, 3)))


def test_robust_fit_ignores_gross_errors_and_is_as_good_as_its_noise():
    truth, source, rng = world(3, 60)
    target = truth(source) + rng.normal(size=source.shape) * 0.1
    target[:15] += rng.normal(size=(15, 3)) * 30
    fit, inliers = robust_umeyama(source, target, 0.2)
    assert inliers[:15].sum() <= 1 and inliers[15:].sum() >= 42
    error = np.linalg.norm(fit(source) - truth(source), axis=1)
    assert 1e-3 < np.sqrt(np.mean(error**2)) < 0.1
    plain = np.linalg.norm(umeyama(source, target)(source) - truth(source), axis=1)
    assert np.mean(plain) > 10 * np.mean(error)


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
