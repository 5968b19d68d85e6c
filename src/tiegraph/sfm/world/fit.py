"""Robust least squares for the similarity from a model to the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from tiegraph.geometry.gravity import Up, roll_by_upward, roll_to_upright, to_upright, upright_by_upward
from tiegraph.geometry.transforms import (
    PlacementError,
    Similarity,
    robust_umeyama,
    skew,
    turn_by_vector,
    umeyama,
    vector_by_turn,
)
from tiegraph.scene.evidence import LIMIT
from tiegraph.sfm.model import ROUNDS
from tiegraph.sfm.tuning.world import FitTuning, WorldTuning
from tiegraph.sfm.world.positionerrors import PositionErrors, Stated

ANTENNA, CLOCK = "antenna", "clock"
_COLUMNS = ("frame", "pose", "speed", "position", "sigma", "orientation", "modes")
_MAX_LOG_SCALE = 5.0  # from the start: keeps a step of the solver finite


@dataclass(frozen=True)
class Evidence:
    """K places known in the model and in the world.

    A pose may be a weighted sum of frames' poses. That of a control point has no rotation (zeros), so that it has no
    lever arm.
    """

    frame: np.ndarray  # (K,) -1 = control point
    pose: np.ndarray  # (K, 4, 4) in the model
    speed: np.ndarray  # (K, 4, 4) derivative of the pose by time
    position: np.ndarray  # (K, 3) metres
    sigma: np.ndarray  # (K, 3) metres
    orientation: np.ndarray  # (K, 3, 3) world_from_rig; NaN = unknown
    modes: np.ndarray  # (K, 3, M) movement by each mode of the model's shape, model units
    antenna: np.ndarray  # (3,) in the rig frame, metres, as given
    free: frozenset[str] = frozenset()  # unknowns beside the similarity: ANTENNA, CLOCK
    log_scale: tuple[float, float] | None = None  # logarithm of the metres per model unit by known lengths, its sigma

    @property
    def oriented(self) -> np.ndarray:
        """(K,) bool: the orientation is known."""
        return np.asarray(np.isfinite(self.orientation).all(axis=(1, 2)))

    def where(self, mask: np.ndarray) -> Evidence:
        """The rows of a mask (K,)."""
        return replace(self, **{n: getattr(self, n)[mask] for n in _COLUMNS})

    def joined(self, other: Evidence) -> Evidence:
        """The same with the rows of another one below."""
        return replace(self, **{n: np.concatenate([getattr(self, n), getattr(other, n)]) for n in _COLUMNS})

    def alone(self, mask: np.ndarray, free: frozenset[str]) -> Evidence:
        """The positions of a mask (K,) without orientations."""
        own = self.where(mask)
        return replace(own, orientation=np.full_like(own.orientation, np.nan), free=free)

    def position_residuals(self, similarity: Similarity, antenna: np.ndarray, offset_s: float) -> np.ndarray:
        """(K, 3) metres: antenna by the model minus the prior position, X + R l - p (ALGORITHMS section 4)."""
        pose = self.pose + offset_s * self.speed if offset_s else self.pose
        lever = pose[:, :3, :3] @ antenna @ similarity.rotation.T
        return similarity(pose[:, :3, 3]) + lever - self.position


@dataclass(frozen=True)
class Fit:
    """The similarity, the positions that agree with it, and its uncertainty."""

    similarity: Similarity
    antenna: np.ndarray  # (3,) in the rig frame, metres
    antenna_covariance: np.ndarray  # (3, 3); NaN = not estimated
    offset_s: float  # of the receiver's clock behind the cameras'; 0 = not estimated
    offset_sigma_s: float  # NaN = not estimated
    inlier: np.ndarray  # (K,)
    roll_sigma_deg: float  # about the direction in which the positions spread most
    error: PlacementError  # about the centroid of the positions
    levels: Sequence[tuple[float, float, int]] = ()  # sizes of the errors of the positions (``positionerrors``)
    bent: tuple[np.ndarray, np.ndarray] | None = None  # modes of the shape from images and positions: (M,), (M, M)

    @property
    def sigma(self) -> dict[str, float]:
        """position_m, height_m, yaw_deg, tilt_deg, scale."""
        return self.error.sigmas()

    def residuals(self, evidence: Evidence) -> np.ndarray:
        """(K, 3) metres."""
        return evidence.position_residuals(self.similarity, self.antenna, self.offset_s)


def fit_similarity(evidence: Evidence, up: Up | None, tuning: FitTuning, near: Similarity | None = None) -> Fit:
    """Best similarity from all evidence: robust first, then least squares on the rows within three sigmas.

    Started from the positions alone, and again after turning upright about the track, because a straight track has
    two minima; or from ``near`` only.
    """
    if near is not None:
        return _refine(evidence, up, near, tuning)[1]
    spread = evidence.pose[:, :3, 3]
    reach = np.linalg.norm(evidence.antenna)
    loose = np.linalg.norm(evidence.sigma, axis=1) + reach + (tuning.antenna_sigma_m if ANTENNA in evidence.free else 0)
    start = robust_umeyama(spread, evidence.position, loose)[0]
    starts = [start]
    points = evidence.frame < 0
    if points.sum() >= 3:  # a few accurate points among many poor ones are a better start alone
        starts.append(umeyama(spread[points], evidence.position[points], 1 / evidence.sigma[points, 0] ** 2))
    if up is not None:
        starts += [_turned(start, evidence, up, angle) for angle in (0.0, np.pi)]
    if evidence.oriented.any():
        starts.append(_by_orientation(evidence, start.scale))
    return min((_refine(evidence, up, s, tuning) for s in starts), key=lambda found: found[0])[1]


def _turned(start: Similarity, evidence: Evidence, up: Up, extra: float) -> Similarity:
    """The start turned about the track so that the cameras' upward direction is up."""
    axis, middle = _track(evidence, start)
    angle = roll_to_upright(start.rotation @ up.direction, axis) + extra
    turn = Rotation.from_rotvec(angle * axis).as_matrix()
    return Similarity(start.scale, turn @ start.rotation, turn @ (start.translation - middle) + middle)


def leaning_deg(evidence: Evidence, similarity: Similarity, up: Up) -> float:
    """Tilt of an upward direction or, if it determines the roll only, its roll about the track."""
    upward = similarity.rotation @ up.direction
    if up.tilt:
        return float(np.degrees(np.arccos(np.clip(upward[2], -1, 1))))
    return abs(float(np.degrees(roll_to_upright(upward, _track(evidence, similarity)[0]))))


def _by_orientation(evidence: Evidence, scale: float) -> Similarity:
    known = evidence.oriented
    turns = evidence.orientation[known] @ np.swapaxes(evidence.pose[known, :3, :3], 1, 2)
    rotation = Rotation.from_matrix(turns).mean().as_matrix()
    offset = np.median(evidence.position - scale * evidence.pose[:, :3, 3] @ rotation.T, axis=0)
    return Similarity(scale, rotation, offset)


def _track(evidence: Evidence, similarity: Similarity) -> tuple[np.ndarray, np.ndarray]:
    """Unit direction (3,) in which the positions spread most, in the world, and their centroid."""
    world = similarity(evidence.pose[:, :3, 3])
    middle = world.mean(axis=0)
    return np.linalg.svd(world - middle, full_matrices=False)[2][0], middle


def by_errors(
    evidence: Evidence, up: Up | None, fit: Fit, rows: Stated, tuning: WorldTuning, done: np.ndarray | None = None
) -> Fit:
    """The fit after its inlier positions were adjusted with their estimated errors (white, slow and common:
    ``positionerrors``) and the possible bend of the model, with the resulting covariance.

    This is the one block: the modes of the shape represent the images; their coefficients have the prior 0 with sigma
    1. ``done`` (M,): coefficients by which the model was bent already.
    """
    stated, seen, modes = rows.common, fit.inlier[: len(rows.level)], evidence.modes.shape[2]
    done = np.zeros(modes) if done is None else done
    fit, sizes = replace(fit, antenna=evidence.antenna, offset_s=0.0), None
    believed = dict.fromkeys((7, 8, 9), tuning.fit.antenna_sigma_m) if ANTENNA in evidence.free else {}
    believed |= {7 + len(believed): tuning.fit.offset_sigma_s} if CLOCK in evidence.free else {}
    for _ in range(3):  # rounds of linearising about the errors of the positions
        problem = _Problem(evidence, up, fit.similarity, tuning.fit)
        x = problem.at(fit)
        places, known = _linearised(problem, x, fit.inlier, rows, done)
        errors = PositionErrors(places[seen], rows.where(seen), known, tuning.noise, sizes)
        sizes = errors.sizes
        moved, covariance = errors.step(believed)
        rows = replace(rows, common=stated * max(1.0, errors.times_stated))  # receivers are optimistic in every part
        size, own = problem.size, slice(problem.size, problem.size + modes)
        fit = problem.fit(x + moved[:size], covariance[:size, :size], fit.inlier)
        fit = replace(fit, levels=errors.levels, bent=(moved[own], covariance[own, own]))
    return fit


def _linearised(
    problem: _Problem, x: np.ndarray, inlier: np.ndarray, rows: Stated, done: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The positions as rows (K, 3, D + 1), metres, and everything else as normal equations (D + 1, D + 1); the unknowns
    of the problem, then the modes of the shape, then the common error of the positions, then the residuals."""
    sigma, count, size = problem.evidence.sigma, len(rows.level), problem.size
    common = np.flatnonzero(np.isfinite(rows.common) & inlier[:count].any())
    (off, by_unknowns), (others, others_by_unknowns) = problem.positions(x), problem.others(x)
    weight = (inlier[:, None] / sigma)[:, :, None]
    bend = (problem.bend(x) * weight).reshape(off.size, len(done))
    every = np.zeros((off.size + len(others), size + len(done) + len(common) + 1))
    every[: off.size, :size], every[off.size :, :size] = (by_unknowns * weight).reshape(-1, size), others_by_unknowns
    every[: off.size, size : size + len(done)] = bend
    every[: off.size, -1], every[off.size :, -1] = off.ravel(), others
    places = every[: 3 * count].reshape(count, 3, every.shape[1]) * sigma[:count, :, None]
    at = -1 - len(common) + np.arange(len(common))
    places[:, common, at] = 1.0
    known = every[3 * count :].T @ every[3 * count :]
    known[range(size, len(known) - 1), range(size, len(known) - 1)] += 1.0  # of modes
    known[at, at] = rows.common[common] ** -2
    known[size : size + len(done), -1] = known[-1, size : size + len(done)] = done
    known[-1, -1] += done @ done
    return places, known


class _Problem:
    """Unknowns: rotation (3,) in the world about the middle, shift (3,), log scale, and if requested lever arm (3,),
    clock offset."""

    def __init__(self, evidence: Evidence, up: Up | None, start: Similarity, tuning: FitTuning) -> None:
        self.evidence, self.up, self.start, self.tuning = evidence, up, start, tuning
        self.middle = evidence.pose[:, :3, 3].mean(axis=0)
        self.axis = _track(evidence, start)[0]
        self.oriented = np.flatnonzero(evidence.oriented)
        self.orientation_sigma = np.radians(tuning.common_deg) * np.sqrt(max(4, len(self.oriented)))
        self.arm, self.clock = ANTENNA in evidence.free, CLOCK in evidence.free
        self.size = 7 + 3 * self.arm + self.clock

    def unpack(self, x: np.ndarray) -> tuple[Similarity, np.ndarray, float]:
        """The similarity, the antenna and the clock offset."""
        rotation = Rotation.from_rotvec(x[:3]).as_matrix() @ self.start.rotation
        scale = self.start.scale * np.exp(np.clip(x[6], -_MAX_LOG_SCALE, _MAX_LOG_SCALE))
        middle_world = self.start(self.middle) + x[3:6]
        antenna = self.evidence.antenna + (x[7:10] if self.arm else 0.0)
        shift = middle_world - scale * rotation @ self.middle
        return Similarity(float(scale), rotation, shift), antenna, float(x[-1]) if self.clock else 0.0

    def at(self, fit: Fit) -> np.ndarray:
        """(D,) the unknowns of a fit that started from this problem."""
        x = np.zeros(self.size)
        if self.arm:
            x[7:10] = fit.antenna - self.evidence.antenna
        if self.clock:
            x[-1] = fit.offset_s
        return x

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """(K, 3) of the positions, in sigmas."""
        return self.evidence.position_residuals(*self.unpack(x)) / self.evidence.sigma

    def positions(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``residuals``, and the derivatives (K, 3, D) of the antenna's places by the unknowns, metres."""
        evidence, (similarity, antenna, offset) = self.evidence, self.unpack(x)
        off = evidence.position_residuals(similarity, antenna, offset) / evidence.sigma
        pose = evidence.pose + offset * evidence.speed if offset else evidence.pose
        reach = similarity.scale * (pose[:, :3, 3] - self.middle) @ similarity.rotation.T
        out = np.zeros((len(pose), 3, self.size))
        out[:, :, :3] = (
            -skew(reach + pose[:, :3, :3] @ antenna @ similarity.rotation.T) @ turn_by_vector(x[None, :3])[0]
        )
        out[:, :, 3:6] = np.eye(3)
        out[:, :, 6] = self._free(x) * reach
        if self.arm:
            out[:, :, 7:10] = similarity.rotation @ pose[:, :3, :3]
        if self.clock:
            moved = similarity.scale * evidence.speed[:, :3, 3] + evidence.speed[:, :3, :3] @ antenna
            out[:, :, -1] = moved @ similarity.rotation.T
        return off, out

    @staticmethod
    def _free(x: np.ndarray) -> float:
        """1, or 0 where the scale is held at its limit."""
        return float(abs(x[6]) < _MAX_LOG_SCALE)

    def bend(self, x: np.ndarray) -> np.ndarray:
        """(K, 3, M) derivatives of the antenna's places by the modes of the model's shape, metres."""
        similarity = self.unpack(x)[0]
        return np.einsum("ij,kjm->kim", similarity.scale * similarity.rotation, self.evidence.modes)

    def others(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(R,) residuals of everything else, in sigmas, and their derivatives (R, D)."""
        similarity, up, unit = self.unpack(x)[0], self.up, np.eye(self.size)
        turn = turn_by_vector(x[None, :3])[0]
        parts = [(1e-3 * x[:3], 1e-3 * unit[:3])]  # keeps the system regular where a rotation is undetermined

        def turned(values: np.ndarray, by_turn: np.ndarray) -> None:
            parts.append((values, np.hstack([by_turn @ turn, np.zeros((len(by_turn), self.size - 3))])))

        if len(self.oriented):
            inverse = np.swapaxes(self.evidence.orientation[self.oriented], 1, 2)
            turns = similarity.rotation @ self.evidence.pose[self.oriented, :3, :3] @ inverse
            off = np.asarray(Rotation.from_matrix(turns).as_rotvec())
            turned(off.ravel() / self.orientation_sigma, vector_by_turn(off).reshape(-1, 3) / self.orientation_sigma)
        if up is not None:
            upward, sigma = similarity.rotation @ up.direction, np.radians(up.sigma_deg)
            if up.tilt:
                off, by_upward = to_upright(upward), upright_by_upward(upward)
            else:
                off = np.array([roll_to_upright(upward, self.axis)])
                by_upward = roll_by_upward(upward, self.axis)[None]
            turned(off / sigma, by_upward @ -skew(upward) / sigma)
        if self.evidence.log_scale is not None:
            value, sigma = self.evidence.log_scale
            parts.append((np.array([np.log(similarity.scale) - value]) / sigma, self._free(x) * unit[6:7] / sigma))
        if self.arm:
            parts.append((x[7:10] / self.tuning.antenna_sigma_m, unit[7:10] / self.tuning.antenna_sigma_m))
        if self.clock:
            parts.append((x[-1:] / self.tuning.offset_sigma_s, unit[-1:] / self.tuning.offset_sigma_s))
        return np.concatenate([value for value, _ in parts]), np.concatenate([rows for _, rows in parts])

    def solve(self, x: np.ndarray, weight: np.ndarray, tolerance: float = 1e-8) -> scipy.optimize.OptimizeResult:
        """Least squares from ``x``, with weights (K,) of the positions, to a tolerance as SciPy has it."""

        @lru_cache(maxsize=1)  # the solver asks for the derivatives where it asked for the residuals last
        def evaluated(key: bytes) -> tuple[np.ndarray, np.ndarray]:
            y = np.array(np.frombuffer(key))
            (off, places), (others, by_others) = self.positions(y), self.others(y)
            places = places * (weight[:, None] / self.evidence.sigma)[:, :, None]
            residuals = np.concatenate([(off * weight[:, None]).ravel(), others])
            return residuals, np.concatenate([places.reshape(-1, self.size), by_others])

        return scipy.optimize.least_squares(
            lambda y: evaluated(y.tobytes())[0],
            x,
            lambda y: evaluated(y.tobytes())[1],
            x_scale="jac",
            method="lm",
            ftol=tolerance,
            xtol=tolerance,
        )

    def fit(self, x: np.ndarray, covariance: np.ndarray, inlier: np.ndarray) -> Fit:
        """The fit at unknowns (D,) with this covariance."""
        similarity, antenna, offset = self.unpack(x)
        roll = self.axis @ covariance[:3, :3] @ self.axis
        return Fit(
            similarity=similarity,
            antenna=antenna,
            antenna_covariance=covariance[7:10, 7:10] if self.arm else np.full((3, 3), np.nan),
            offset_s=offset,
            offset_sigma_s=float(np.sqrt(max(covariance[-1, -1], 0.0))) if self.clock else float("nan"),
            inlier=inlier,
            roll_sigma_deg=float(np.degrees(np.sqrt(max(0.0, roll)))),
            error=PlacementError(similarity(self.middle), covariance[:7, :7]),
        )


def _refine(evidence: Evidence, up: Up | None, start: Similarity, tuning: FitTuning) -> tuple[float, Fit]:
    """The robust cost, in squared sigmas, and the fit."""
    problem = _Problem(evidence, up, start, tuning)
    x, small = np.zeros(problem.size), 1e-5  # radians, metres, log scale: a smaller step ends the rounds

    def distance(y: np.ndarray) -> np.ndarray:
        return np.linalg.norm(problem.residuals(y), axis=1)

    for scale in tuning.cauchy_scales:  # Cauchy over the whole vector: an outlier in height is one in plan too
        for _ in range(ROUNDS):
            weight = 1 / np.sqrt(1 + (distance(x) / (scale * LIMIT)) ** 2)
            before, x = x, problem.solve(x, weight, small).x
            if np.abs(x - before).max() < small:
                break
    inlier = distance(x) < LIMIT * np.sqrt(3)
    for _ in range(ROUNDS):
        if inlier.sum() < 3:
            inlier[:] = True
        x = problem.solve(x, inlier.astype(float), small).x
        again = distance(x) < LIMIT * np.sqrt(3)
        if np.array_equal(again, inlier):
            break
        inlier = again
    solution = problem.solve(x, inlier.astype(float))
    off, freedom = problem.residuals(solution.x), max(1, 3 * int(inlier.sum()) - problem.size)
    chi2 = max(1.0, float(np.sum(off[inlier] ** 2)) / freedom)
    covariance = np.linalg.pinv(solution.jac.T @ solution.jac) * chi2
    lost = np.sum(np.log1p((np.linalg.norm(off, axis=1) / LIMIT) ** 2)) * LIMIT**2
    return float(lost + 0.5 * np.sum(problem.others(x)[0] ** 2)), problem.fit(solution.x, covariance, inlier)
