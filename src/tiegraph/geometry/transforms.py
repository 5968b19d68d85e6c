"""Rigid transforms as float64 (..., 4, 4) matrices named ``target_from_source``, NaN = unknown; rays as unit
vectors in a camera's frame."""

from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

_SMALL_RAD = 1e-3  # below: series, whose next term is under 1e-14


def rigid(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(..., 4, 4) from rotation (..., 3, 3) and translation (..., 3)."""
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    shape = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    out = np.zeros((*shape, 4, 4))
    out[..., :3, :3] = rotation
    out[..., :3, 3] = translation
    out[..., 3, 3] = 1.0
    return out


def invert(target_from_source: np.ndarray) -> np.ndarray:
    """source_from_target of rigid transforms (..., 4, 4)."""
    transposed = np.swapaxes(target_from_source[..., :3, :3], -1, -2)
    return rigid(transposed, -np.einsum("...ij,...j->...i", transposed, target_from_source[..., :3, 3]))


def centre(sensor_from_world: np.ndarray) -> np.ndarray:
    """Projection centre (..., 3) in the world of sensor_from_world (..., 4, 4)."""
    return invert(sensor_from_world)[..., :3, 3]


def apply(target_from_source: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (N, 3) of the source frame in the target frame; target_from_source is (4, 4), a similarity is fine."""
    return points @ target_from_source[:3, :3].T + target_from_source[:3, 3]


def transformed(target_from_source: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) by a matrix (3, 4) f8: ``apply`` of many points in a fifth of the time, by OpenCV."""
    flat = np.ascontiguousarray(points, float).reshape(-1, 1, 3)
    return (cv2.transform(flat, target_from_source) if len(flat) else flat).reshape(points.shape)


def skew(v: np.ndarray) -> np.ndarray:
    """(..., 3, 3) with skew(v) @ x = v x x for vectors v (..., 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def are_rotations(turns: np.ndarray, play: float) -> np.ndarray:
    """(...) bool: matrices (..., 3, 3) that are rotations, products of whose rows miss 0 or 1 by ``play`` at most."""
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(turns @ np.swapaxes(turns, -1, -2) - np.eye(3)).max(axis=(-2, -1))
        return (off <= play) & (np.linalg.det(turns) > 0)


def finite_array(given: Any, *shapes: tuple[int, ...]) -> np.ndarray | None:
    """The array of finite numbers of one of some shapes that a value of a file is; None if it is none."""
    try:
        found = np.array(given, float)
    except (TypeError, ValueError, OverflowError):
        return None
    return found if found.shape in shapes and np.isfinite(found).all() else None


def motions(from_middle: np.ndarray) -> np.ndarray:
    """(N, 3, 7) what a turn (rad), a shift (m) and a change of scale do to places (N, 3) about the middle."""
    shift = np.broadcast_to(np.eye(3), (len(from_middle), 3, 3))
    return np.concatenate([-skew(from_middle), shift, from_middle[:, :, None]], axis=2)


def turn_by_vector(v: np.ndarray) -> np.ndarray:
    """(N, 3, 3) Jacobians J of rotation vectors v (N, 3): Exp(v + dv) = Exp(J dv) Exp(v), to the first order."""
    angle, cross = np.linalg.norm(v, axis=1)[:, None, None], skew(v)
    half = np.sinc(angle / (2 * np.pi))  # sin(a / 2) / (a / 2)
    small = angle < _SMALL_RAD
    cubic = np.where(small, 1 / 6 - angle**2 / 120, (angle - np.sin(angle)) / np.where(small, 1.0, angle) ** 3)
    return np.asarray(np.eye(3) + half**2 / 2 * cross + cubic * (cross @ cross))


def vector_by_turn(v: np.ndarray) -> np.ndarray:
    """(N, 3, 3) the inverses of ``turn_by_vector``, for rotation vectors (N, 3) of at most half a turn."""
    angle, cross = np.linalg.norm(v, axis=1)[:, None, None], skew(v)
    small = angle < _SMALL_RAD
    safe = np.where(small, 1.0, angle)
    square = np.where(small, 1 / 12 + angle**2 / 720, (1 - safe / 2 / np.tan(safe / 2)) / safe**2)
    return np.asarray(np.eye(3) - cross / 2 + square * (cross @ cross))


def from_quaternion_wxyz(q_wxyz: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(..., 4, 4) from a quaternion (..., 4), w first, and a translation (..., 3)."""
    q = np.asarray(q_wxyz, float)
    return rigid(Rotation.from_quat(np.roll(q, -1, axis=-1)).as_matrix(), translation)


def quaternion_xyzw(rotation: np.ndarray) -> np.ndarray:
    """Quaternion (..., 4), w last and >= 0, of rotation (..., 3, 3)."""
    return Rotation.from_matrix(rotation).as_quat(canonical=True)


def angle_deg(rotation_a: np.ndarray, rotation_b: np.ndarray) -> np.ndarray:
    """Angle between two rotations (..., 3, 3) in degrees."""
    trace = np.einsum("...ij,...ij->...", rotation_a, rotation_b)
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def interpolate(time_s: np.ndarray, transforms: np.ndarray, at_s: np.ndarray, max_gap_s: float = np.inf) -> np.ndarray:
    """Rigid transforms (T, 4, 4) at sorted times (T,), slerped/lerped to times (K,): (K, 4, 4), NaN outside or across a
    gap wider than ``max_gap_s``; at one of the times (to a microsecond) its own."""
    out = np.full((len(at_s), 4, 4), np.nan)
    if len(time_s) == 0:
        return out
    known = np.isfinite(at_s)
    first = np.searchsorted(time_s, np.where(known, at_s, 0.0) - 1e-6, side="right")
    exact = np.minimum(first, len(time_s) - 1)
    same = known & (np.abs(time_s[exact] - at_s) < 1e-6)
    out[same] = transforms[exact[same]]
    if len(time_s) < 2:
        return out
    b = np.clip(np.searchsorted(time_s, at_s), 1, len(time_s) - 1)
    gap = time_s[b] - time_s[b - 1]
    inside = known & ~same & (time_s[b - 1] <= at_s) & (at_s <= time_s[b]) & (gap <= max_gap_s)
    if not inside.any():
        return out
    before, after = transforms[b[inside] - 1], transforms[b[inside]]
    u = ((at_s - time_s[b - 1])[inside] / gap[inside])[:, None]
    step = Rotation.from_matrix(np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]).as_rotvec()
    turn = before[:, :3, :3] @ Rotation.from_rotvec(u * step).as_matrix()
    out[inside] = rigid(turn, (1 - u) * before[:, :3, 3] + u * after[:, :3, 3])
    return out


def unit_rays(plane: np.ndarray) -> np.ndarray:
    """(K, 3) unit vectors of places (K, 2) on the plane z = 1 in front of a camera; NaN stays."""
    rays = np.column_stack([plane, np.ones(len(plane))])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def off_plane(way: np.ndarray, ray: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(K,) sine of the angle between a second ray and the epipolar plane of a first one and of the way to its camera.

    way, ray (K, 3): from the first centre to the second, and the first ray; normal (K, 3): first ray x second ray, both
    of unit length in the axes of ``way``.
    """
    across = np.maximum(np.linalg.norm(cross(way, ray), axis=1), 1e-12)
    return np.abs(np.sum(way * normal, axis=1)) / across


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Row-wise cross product (K, 3); several times faster than NumPy's."""
    out = np.empty(a.shape)
    out[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    out[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    out[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return out


def normal_matrices(ray: np.ndarray, weight: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """(G, 3, 3) normal matrices of points that rays meet at: the sum of weight (I - ray rayT) over each point's rays.

    ray (K, 3) unit; weight (K,): one over the squared sigma across the ray, at the point; group (K,): the ray's point.
    The inverse is the point's covariance.
    """
    products = np.bincount(group, weight, groups)[:, None, None] * np.eye(3)
    for a in range(3):
        for b in range(a, 3):
            off = np.bincount(group, weight * ray[:, a] * ray[:, b], groups)
            products[:, a, b] -= off
            if a != b:
                products[:, b, a] -= off
    return np.asarray(products)
