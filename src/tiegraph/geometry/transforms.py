"""Rigid transforms as float64 (..., 4, 4) matrices named ``target_from_source``, NaN = unknown; rays as unit
vectors in a camera's frame; least-squares alignment of point sets (Umeyama 1991), plain and robust; how well a placed
world is known; the robust mean of rotations."""

from dataclasses import dataclass, field
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


# ---------------------------------------------------------------- alignment


LEAST_PLACES = 3  # that determine a similarity
MAD = 1.4826  # sigma of normal errors over the median of their absolute values
CAUCHY_SIGMAS = 2.385  # scale of a Cauchy loss: 95 % efficient for normal errors (Holland and Welsch 1977)


@dataclass(frozen=True)
class Similarity:
    """target = scale * rotation @ source + translation."""

    scale: float = 1.0
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def matrix(self) -> np.ndarray:
        """(4, 4) with the scale inside."""
        return rigid(self.scale * self.rotation, self.translation)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 3) of the source in the target frame."""
        return self.scale * np.asarray(points, float) @ self.rotation.T + self.translation

    def __matmul__(self, other: "Similarity") -> "Similarity":
        """Of two in a row, ``other`` first: target_from_source = target_from_middle @ middle_from_source."""
        turned = self.rotation @ other.rotation
        shift = self.scale * self.rotation @ other.translation + self.translation
        return Similarity(self.scale * other.scale, turned, shift)

    def stepped(self, step: np.ndarray, middle: np.ndarray) -> "Similarity":
        """Followed by a turn, a shift and the logarithm of a growth (7,) about a middle (3,)."""
        turn, scale = Rotation.from_rotvec(step[:3]).as_matrix(), float(np.exp(step[6]))
        shift = scale * turn @ (self.translation - middle) + middle + step[3:6]
        return Similarity(scale * self.scale, turn @ self.rotation, shift)

    def inverse(self) -> "Similarity":
        """source = scale * rotation @ target + translation."""
        turned = self.rotation.T / self.scale
        return Similarity(1 / self.scale, self.rotation.T, -turned @ self.translation)


def robust_sigma(residual: np.ndarray) -> float:
    """Sigma of normal errors around zero by the median of their absolute values: up to half may be wrong."""
    return MAD * float(np.median(np.abs(residual)))


def rms_length(vectors: np.ndarray) -> float:
    """Root mean square length of vectors (N, D), NaN of none."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1)))) if len(vectors) else float("nan")


def umeyama(
    source: np.ndarray, target: np.ndarray, weights: np.ndarray | None = None, with_scale: bool = True
) -> Similarity:
    """Similarity (or rigid, ``with_scale=False``) that takes source (N, 3) to target (N, 3) with least squared error.

    Umeyama 1991, eq. 40-42; ``weights`` (N,) are inverse variances. Raises ValueError below three points.
    """
    source, target = np.asarray(source, float), np.asarray(target, float)
    if len(source) < 3:
        raise ValueError(f"alignment needs at least 3 points, got {len(source)}")
    w = np.full(len(source), 1.0 / len(source)) if weights is None else np.asarray(weights, float) / np.sum(weights)
    scale, rotation, shift = _aligned(source, target, w, with_scale)
    return Similarity(float(scale), rotation, shift)


def _aligned(
    source: np.ndarray, target: np.ndarray, w: np.ndarray, with_scale: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scales (...), rotations (..., 3, 3) and translations (..., 3) from sources (..., N, 3) to targets, with weights
    (N,) whose sum is 1."""
    mean_s, mean_t = w @ source, w @ target
    s, t = source - mean_s[..., None, :], target - mean_t[..., None, :]
    u, d, vt = np.linalg.svd(np.swapaxes(w[:, None] * t, -1, -2) @ s)
    sign = np.ones_like(d)
    sign[..., 2] = np.where(np.linalg.det(u) * np.linalg.det(vt) < 0, -1, 1)
    rotation = (u * sign[..., None, :]) @ vt
    variance = np.sum(s**2, axis=-1) @ w
    scale = np.where(variance > 0, np.sum(d * sign, axis=-1) / np.where(variance > 0, variance, 1), 1.0)
    scale = scale if with_scale else np.ones_like(scale)
    return scale, rotation, mean_t - scale[..., None] * (rotation @ mean_s[..., None])[..., 0]


def robust_umeyama(source: np.ndarray, target: np.ndarray, sigma: np.ndarray | float) -> tuple[Similarity, np.ndarray]:
    """Similarity by RANSAC over triples, refined on the inliers; returns it and the inlier mask (N,).

    A point is an inlier below three of its sigmas (N,) (target units). All points are used when no triple does better
    than chance.
    """
    source, target = np.asarray(source, float), np.asarray(target, float)
    sigma = np.broadcast_to(np.asarray(sigma, float), (len(source),))
    rng = np.random.default_rng(0)
    best, inliers = -1.0, np.ones(len(source), bool)
    picks = np.array([rng.choice(len(source), 3, replace=False) for _ in range(300 if len(source) > 3 else 1)])
    for found in zip(*_aligned(source[picks], target[picks], np.full(3, 1 / 3)), strict=True):
        off = (Similarity(*found)(source) - target) / (3 * sigma[:, None])
        squared = np.einsum("ij,ij->i", off, off)
        score = float(np.sum(np.maximum(0.0, 1 - squared)))
        if score > best and np.sum(squared < 1) >= 3:
            best, inliers = score, squared < 1
    for _ in range(5):
        fit = umeyama(source[inliers], target[inliers], 1 / sigma[inliers] ** 2)
        again = np.linalg.norm(fit(source) - target, axis=1) < 3 * sigma
        if again.sum() < 3 or np.array_equal(again, inliers):
            break
        inliers = again
    return umeyama(source[inliers], target[inliers], 1 / sigma[inliers] ** 2), inliers


def level_umeyama(source: np.ndarray, target: np.ndarray, sigma: np.ndarray) -> tuple[Similarity, float]:
    """Similarity that keeps z up and takes source (N, 3) to target (N, 3) with sigmas (N, 3), and the weighted rms in
    plan: reweighted least squares with Cauchy weights in plan, then the weighted mean in height."""
    flat, goal = source[:, 0] + 1j * source[:, 1], target[:, 0] + 1j * target[:, 1]
    weight = 1 / sigma[:, 0] ** 2
    for _ in range(20):
        s0, g0 = np.average(flat, weights=weight), np.average(goal, weights=weight)
        a = np.sum(weight * np.conj(flat - s0) * (goal - g0)) / np.sum(weight * np.abs(flat - s0) ** 2)
        residual = np.abs(goal - g0 - a * (flat - s0))
        weight = 1 / (sigma[:, 0] ** 2 + residual**2)
    scale, shift = float(np.abs(a)), g0 - a * s0
    height = np.average(target[:, 2] - scale * source[:, 2], weights=1 / sigma[:, 2] ** 2)
    rms = float(np.sqrt(np.average(residual**2, weights=weight)))
    turn = Rotation.from_rotvec([0.0, 0.0, float(np.angle(a))]).as_matrix()
    return Similarity(scale, turn, np.array([shift.real, shift.imag, height])), rms


def l1_mean_rotation(rotations: np.ndarray) -> np.ndarray:
    """Geodesic L1 mean (3, 3) of rotations (K, 3, 3): Weiszfeld's algorithm (Hartley, Aftab, Trumpf 2011).

    Starts at the member with the least summed angle, so that up to half of them may be wrong.
    """
    sample = rotations[:: max(1, len(rotations) // 200)]
    sums = [np.sum(angle_deg(sample, candidate)) for candidate in sample]
    mean = sample[int(np.argmin(sums))]
    for _ in range(50):
        logs = Rotation.from_matrix(rotations @ mean.T).as_rotvec()
        weights = 1 / np.maximum(np.linalg.norm(logs, axis=1), 1e-9)
        step = np.sum(weights[:, None] * logs, axis=0) / np.sum(weights)
        mean = Rotation.from_rotvec(step).as_matrix() @ mean
        if np.linalg.norm(step) < 1e-10:
            break
    return mean


SIGMAS = ("position_m", "height_m", "yaw_deg", "tilt_deg", "scale")
_OF = ("tilt_deg", "tilt_deg", "yaw_deg", "position_m", "position_m", "height_m", "scale")


@dataclass(frozen=True)
class PlacementError:
    """Covariance (7, 7) of turn (rad, about east, north, up), shift (m) and log scale, all about ``middle`` (3,)."""

    middle: np.ndarray
    covariance: np.ndarray

    def sigma(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) sigmas of places in the world (N, 3), east, north, up, metres: what the placement leaves uncertain.

        The model's own errors (of poses, of the dense matching) come on top.
        """
        jacobian = self._jacobian(points)
        variance = np.einsum("nij,jk,nik->ni", jacobian, self.covariance, jacobian)
        return np.sqrt(np.clip(variance, 0, None))

    def covariances(self, points: np.ndarray) -> np.ndarray:
        """(N, 3, 3) covariances of places in the world (N, 3), east, north, up, square metres."""
        jacobian = self._jacobian(points)
        return np.einsum("nij,jk,nlk->nil", jacobian, self.covariance, jacobian)

    def _jacobian(self, points: np.ndarray) -> np.ndarray:
        """(N, 3, 7): how places (N, 3) move with turn, shift and log scale."""
        return motions(np.asarray(points, float).reshape(-1, 3) - self.middle)

    def sigmas(self) -> dict[str, float]:
        """position_m, height_m, yaw_deg, tilt_deg, scale."""
        sd = np.sqrt(np.clip(np.diag(self.covariance), 0, None))
        named = (np.hypot(sd[3], sd[4]), sd[5], np.degrees(sd[2]), np.degrees(np.hypot(sd[0], sd[1])), sd[6])
        return {n: round(float(v), 6) for n, v in zip(SIGMAS, named)}

    def widened_to(self, sigma: dict[str, float]) -> "PlacementError":
        """The same with sigmas at least those of ``sigma`` (position_m, ...), correlations kept."""
        factor = {n: max(1.0, sigma[n] / max(own, 1e-9)) for n, own in self.sigmas().items()}
        each = np.array([factor[n] for n in _OF])
        return PlacementError(self.middle, self.covariance * each[:, None] * each)

    def to_dict(self) -> dict:
        """JSON-ready."""
        return {"middle": self.middle.tolist(), "covariance": self.covariance.tolist()}

    @staticmethod
    def from_dict(data: dict) -> "PlacementError":
        """Inverse of ``to_dict``."""
        return PlacementError(np.array(data["middle"], float), np.array(data["covariance"], float))
