"""Least-squares alignment of point sets (Umeyama 1991), plain and robust; how well a placed world is known; the robust
mean of rotations. And which way is up in a model: cameras are mounted upright, or held level, or look straight down.

Image tops point to the sky on average, which is as good as the cameras look all round: those of a ring, or a pair back
to back. Cameras to one side may all look up a facade or down at a find; but level they are from left to right, so that
their x axes lie in the horizon, and those of several headings span it (Brown and Lowe, Automatic panoramic image
stitching, 2007, section 5).

One least-squares fit of tops and x axes, instead of the choice between them, is no better at any weight: with 0.05 of
the tops Herz-Jesus-P8 stands 4.7 deg off instead of 0.1, with 0.001 one camera of the boat `canal_demo` 0.7 instead of
0.0 (``python -m benchmarks.sfm.upright``).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from tiegraph.geometry.transforms import angle_deg, centre, motions, rigid
from tiegraph.settings import Section

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
    mean_s, mean_t = w @ source, w @ target
    s, t = source - mean_s, target - mean_t
    u, d, vt = np.linalg.svd((w[:, None] * t).T @ s)
    sign = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:
        sign[2] = -1
    rotation = u @ np.diag(sign) @ vt
    variance = float(w @ np.sum(s**2, axis=1))
    scale = float(d @ sign) / variance if with_scale and variance > 0 else 1.0
    return Similarity(scale, rotation, mean_t - scale * rotation @ mean_s)


def robust_umeyama(source: np.ndarray, target: np.ndarray, sigma: np.ndarray | float) -> tuple[Similarity, np.ndarray]:
    """Similarity by RANSAC over triples, refined on the inliers; returns it and the inlier mask (N,).

    A point is an inlier below three of its sigmas (N,) (target units). All points are used when no triple does better
    than chance.
    """
    source, target = np.asarray(source, float), np.asarray(target, float)
    sigma = np.broadcast_to(np.asarray(sigma, float), (len(source),))
    rng = np.random.default_rng(0)
    best, inliers = -1.0, np.ones(len(source), bool)
    for _ in range(300 if len(source) > 3 else 1):
        pick = rng.choice(len(source), 3, replace=False)
        fit = umeyama(source[pick], target[pick])
        ratio = np.linalg.norm(fit(source) - target, axis=1) / (3 * sigma)
        score = float(np.sum(np.maximum(0.0, 1 - ratio**2)))
        if score > best and np.sum(ratio < 1) >= 3:
            best, inliers = score, ratio < 1
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


# --- which way is up --------------------------------------------------------------------------------------------------


class UpTuning(Section):
    """Which way is up in a model."""

    ring_sigma_deg: float = Field(3.0, gt=0)
    """Cameras all round a levelled platform: what trim and mounting leave."""
    lone_sigma_deg: float = Field(10.0, gt=0)
    """A person holding a camera, or cameras to one side."""
    agreement: float = Field(0.8, ge=0, le=1)
    """Length of the mean of the unit vectors at least; nadir photographs of many headings have about 0. 1: cameras tell
    nothing."""
    round: float = Field(0.5, ge=0, le=1)
    """Length of the mean viewing direction of a frame, below which its cameras look all round."""


@dataclass(frozen=True)
class Up:
    """Upward direction (3,) in the model, its sigma, whether cameras all round say so, and whether it holds the whole
    tilt (or only the roll about the track)."""

    direction: np.ndarray
    sigma_deg: float
    ring: bool
    tilt: bool
    cameras: str


def up_vector(cam_from_world: np.ndarray, frame: np.ndarray, tuning: UpTuning) -> Up | None:
    """By cameras (N, 4, 4; NaN = no pose) that look to the side, each of a frame (N,): of a ring their mean -y, of
    others the direction across their x axes, or again the mean -y where these do not span the horizon; None when they
    do not agree.

    The sigma of cameras all round is 3 deg, or more where the platform itself leans so much from frame to frame (a
    camera on a pole).
    """
    use = np.isfinite(cam_from_world).all(axis=(1, 2))
    if not use.any() or tuning.agreement == 1:
        return None
    turns = cam_from_world[use, :3, :3]
    count, (top, looking) = _of_frames(frame[use], (-turns[:, 1], turns[:, 2]))
    several = count > 1
    ring = several.any() and float(np.linalg.norm(looking[several], axis=1).mean()) < tuning.round
    horizon = None if ring else across_horizon(turns, tuning)
    if horizon is not None:
        return horizon
    mean = -turns[:, 1].mean(axis=0)
    if np.linalg.norm(mean) < tuning.agreement:
        return None
    mean /= np.linalg.norm(mean)
    if not ring:
        return Up(direction=mean, sigma_deg=tuning.lone_sigma_deg, ring=False, tilt=False, cameras="the images")
    leaning = np.degrees(np.arccos(np.clip(top[several] @ mean / np.linalg.norm(top[several], axis=1), -1, 1)))
    sigma = max(tuning.ring_sigma_deg, float(np.sqrt(np.mean(leaning**2))))
    return Up(direction=mean, sigma_deg=sigma, ring=True, tilt=True, cameras="the ring of side cameras")


def across_horizon(turns: np.ndarray, tuning: UpTuning) -> Up | None:
    """The direction across the x axes of cameras (N, 3, 3); None where it is not better known than by their tops, or
    where these do not tell its sense: cameras that look straight up and straight down see alike.

    Along the axes' second direction the sigma is that of one camera over their spread in it: 1 for headings all round.
    """
    x = turns[:, 0]
    spread, axes = np.linalg.eigh(x.T @ x / len(x))
    top = -float(np.mean(turns[:, 1] @ axes[:, 0]))
    if abs(top) < 1 - tuning.agreement:
        return None
    up = axes[:, 0] * np.sign(top)
    lean = np.degrees(np.sqrt(np.mean(np.arcsin(np.clip(x @ up, -1, 1)) ** 2)))
    sigma = max(tuning.ring_sigma_deg, float(lean)) / float(np.sqrt(max(2 * spread[1], 1e-12)))
    if sigma >= tuning.lone_sigma_deg:
        return None
    return Up(direction=up, sigma_deg=sigma, ring=False, tilt=True, cameras="the level images")


def _of_frames(frame: np.ndarray, values: Sequence[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """How many images (N,) each frame has (G,), and the means (G, 3) over them of each of the values (N, 3)."""
    frames, at, count = np.unique(frame, return_inverse=True, return_counts=True)
    means = []
    for v in values:
        total = np.zeros((len(frames), 3))
        np.add.at(total, at, v)
        means.append(total / count[:, None])
    return count, means


def levelled(cam_from_world: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """(4, 4) rigid transform of a world into one with z up, the path of the cameras (N, 4, 4; NaN = no pose) along x.

    ``frame`` (N,) of each camera. Up is what ``up_vector`` says; where it says nothing, they look straight down.
    """
    placed = np.isfinite(cam_from_world).all(axis=(1, 2))
    out = np.eye(4)
    if not placed.any():
        return out
    rotation, places = cam_from_world[placed, :3, :3], centre(cam_from_world[placed])
    found = up_vector(cam_from_world, frame, UpTuning())
    up = -rotation[:, 2].mean(axis=0) if found is None else found.direction
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    flat = places - places.mean(axis=0)
    flat = flat - np.outer(flat @ up, up)
    along = np.linalg.svd(flat, full_matrices=False)[2][0] if np.abs(flat).max() > 1e-9 else rotation[0, 0]
    along = along - (along @ up) * up
    along /= np.linalg.norm(along)
    out[:3, :3] = np.stack([along, np.cross(up, along), up])
    out[:3, 3] = -out[:3, :3] @ places.mean(axis=0)
    return out


def roll_to_upright(upward: np.ndarray, axis: np.ndarray) -> float:
    """Angle (rad) by which to turn about ``axis`` so that ``upward`` comes closest to the vertical."""
    a, b = upward - axis * (upward @ axis), np.array([0.0, 0.0, 1.0]) - axis * axis[2]
    return float(np.arctan2(axis @ np.cross(a, b), a @ b))


def roll_by_upward(upward: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(3,) derivative of ``roll_to_upright`` by ``upward``."""
    b = np.array([0.0, 0.0, 1.0]) - axis * axis[2]
    across = np.cross(b, axis)
    sine, cosine = across @ upward, b @ upward
    return np.asarray((cosine * across - sine * b) / max(sine**2 + cosine**2, 1e-300))


def to_upright(upward: np.ndarray) -> np.ndarray:
    """Rotation vector (east, north parts) that brings ``upward`` to the vertical."""
    cross = np.cross(upward, [0.0, 0.0, 1.0])[:2]
    sine = float(np.linalg.norm(cross))
    return cross * (np.arctan2(sine, upward[2]) / sine if sine > 1e-12 else 1.0)


def upright_by_upward(upward: np.ndarray) -> np.ndarray:
    """(2, 3) derivative of ``to_upright`` by ``upward``."""
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # from ``upward`` to its cross product with the vertical
    cross = turned @ upward
    sine = float(np.linalg.norm(cross))
    if sine <= 1e-12:
        return turned
    angle = np.arctan2(sine, upward[2])
    by_sine = cross @ turned / sine
    by_angle = (upward[2] * by_sine - sine * np.array([0.0, 0.0, 1.0])) / (sine**2 + upward[2] ** 2)
    return np.asarray(angle / sine * turned + np.outer(cross, by_angle / sine - angle / sine**2 * by_sine))
