import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms

vectors = arrays(float, 3, elements=st.floats(-100, 100))


def pose(rotvec, t):
    return transforms.rigid(Rotation.from_rotvec(rotvec / 50).as_matrix(), t)


@given(vectors, vectors)
@settings(max_examples=50, deadline=None)
def test_inverse_undoes(rotvec, t):
    a = pose(rotvec, t)
    np.testing.assert_allclose(transforms.invert(a) @ a, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(transforms.apply(a, transforms.centre(a)[None]), 0, atol=1e-9)


@given(vectors, vectors)
@settings(max_examples=50, deadline=None)
def test_quaternion_round_trip(rotvec, t):
    a = pose(rotvec, t)
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
