"""Least-squares alignment of point sets (Umeyama 1991), plain and robust; how well a placed world is known; the robust
mean of rotations."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry.transforms import angle_deg, motions, rigid

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
