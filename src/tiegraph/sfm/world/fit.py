"""Robust least squares for the similarity from a model to the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from tiegraph.geometry.align import PlacementError, Similarity, robust_umeyama, umeyama
from tiegraph.geometry.gravity import Up, roll_by_upward, roll_to_upright, to_upright, upright_by_upward
from tiegraph.geometry.transforms import skew, turn_by_vector, vector_by_turn
from tiegraph.sfm.tuning.world import FitTuning, NoiseTuning
from tiegraph.sfm.world.positionerrors import Linear, PositionErrors, Stated
from tiegraph.sfm.world.unknowns import Bend, Clock, FittedArm, LeverArm, LogScale

_OPEN = 1e-6  # squared sine between an unknown and the residuals' directions, above which it is undetermined
_STEPS = 3  # of linearising about the errors of the positions
_MAX_LOG_SCALE = 5.0  # from the start: keeps a step of the solver finite


@dataclass(frozen=True)
class Evidence:
    """K places known in the model and in the world: model poses (K, 4, 4), positions (K, 3) and sigmas (K, 3).

    A pose may be a weighted sum of frames' poses. That of a control point has no rotation (zeros), so that it has no
    lever arm. ``frame`` (K,) -1 = control point; ``speed`` (K, 4, 4) derivative of the pose by time; ``orientation``
    (K, 3, 3) world_from_rig, NaN = unknown; ``log_scale`` None = the rig does not determine the scale.
    """

    frame: np.ndarray
    pose: np.ndarray
    position: np.ndarray
    sigma: np.ndarray
    orientation: np.ndarray
    arm: LeverArm
    log_scale: LogScale | None
    speed: np.ndarray | None = None
    estimate_offset: bool = False
    bend: Bend | None = None

    def without_orientations(self) -> Evidence:
        """The same without orientations."""
        return replace(self, orientation=np.full_like(self.orientation, np.nan))

    def with_arm(self, estimate: bool) -> Evidence:
        """The same with the lever arm as an unknown or not."""
        return replace(self, arm=replace(self.arm, estimate=estimate))

    def where(self, mask: np.ndarray) -> Evidence:
        """The rows of a mask (K,)."""
        columns = ("frame", "pose", "position", "sigma", "orientation", "speed")
        out = replace(self, **{n: getattr(self, n)[mask] for n in columns if getattr(self, n) is not None})
        return out if out.bend is None else replace(out, bend=replace(out.bend, modes=out.bend.modes[mask]))

    def position_residuals(self, similarity: Similarity, antenna: np.ndarray, offset_s: float = 0.0) -> np.ndarray:
        """(K, 3) metres: antenna by the model minus the prior position, X + R l - p (ALGORITHMS section 4)."""
        pose = self.pose if self.speed is None or not offset_s else self.pose + offset_s * self.speed
        lever = pose[:, :3, :3] @ antenna @ similarity.rotation.T
        return similarity(pose[:, :3, 3]) + lever - self.position


@dataclass(frozen=True)
class Fit:
    """The similarity, which positions agree with it, and its uncertainty."""

    similarity: Similarity
    arm: FittedArm
    clock: Clock  # of offset 0 where it is not estimated
    inlier: np.ndarray
    cost: float  # robust, in squared sigmas
    roll_sigma_deg: float  # about the direction in which the positions spread most
    sigma_positions_scale: float  # of the logarithm of the scale, from the positions alone
    error: PlacementError  # about the centroid of the positions
    levels: Sequence[tuple[float, float, int]] = ()  # sizes of the errors of the positions (``positionerrors``)
    bent: tuple[np.ndarray, np.ndarray] | None = None  # modes of the shape from images and positions: (M,), (M, M)

    @property
    def sigma(self) -> dict[str, float]:
        """position_m, height_m, yaw_deg, tilt_deg, scale."""
        return self.error.sigmas()


def fit_similarity(evidence: Evidence, up: Up | None, tuning: FitTuning, near: Similarity | None = None) -> Fit:
    """Best similarity from all evidence: robust first, then least squares on the rows within three sigmas.

    Started from the positions alone, and again after turning upright about the track, because a straight track has
    two minima; or from ``near`` only.
    """
    if near is not None:
        return _refine(evidence, up, near, tuning)[1]
    spread = evidence.pose[:, :3, 3]
    reach = np.linalg.norm(evidence.arm.place)
    loose = np.linalg.norm(evidence.sigma, axis=1) + reach + (tuning.antenna_sigma_m if evidence.arm.estimate else 0)
    start = robust_umeyama(spread, evidence.position, loose)[0]
    starts = [start]
    points = evidence.frame < 0
    if points.sum() >= 3:  # a few accurate points among many poor ones are a better start alone
        starts.append(umeyama(spread[points], evidence.position[points], 1 / evidence.sigma[points, 0] ** 2))
    if up is not None:
        starts += [_turned(start, evidence, up, angle) for angle in (0.0, np.pi)]
    if np.isfinite(evidence.orientation).all(axis=(1, 2)).any():
        starts.append(_by_orientation(evidence, start.scale))
    fits = [_refine(evidence, up, s, tuning) for s in starts]
    return min(fits, key=lambda f: f[0])[1]


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
    known = np.isfinite(evidence.orientation).all(axis=(1, 2))
    turns = evidence.orientation[known] @ np.swapaxes(evidence.pose[known, :3, :3], 1, 2)
    rotation = Rotation.from_matrix(turns).mean().as_matrix()
    offset = np.median(evidence.position - scale * evidence.pose[:, :3, 3] @ rotation.T, axis=0)
    return Similarity(scale, rotation, offset)


def _track(evidence: Evidence, similarity: Similarity) -> tuple[np.ndarray, np.ndarray]:
    """Unit direction (3,) in which the positions spread most, in the world, and their centroid."""
    world = similarity(evidence.pose[:, :3, 3])
    middle = world.mean(axis=0)
    return np.linalg.svd(world - middle, full_matrices=False)[2][0], middle


def by_errors(evidence: Evidence, up: Up | None, fit: Fit, rows: Stated, tuning: FitTuning, noise: NoiseTuning) -> Fit:
    """The fit after its inlier positions were adjusted with their estimated errors (white, slow and common:
    ``positionerrors``) and the possible bend of the model, with the resulting covariance.

    This is the one block: the modes of the shape represent the images; their coefficients have the prior 0 with sigma
    1."""
    stated, seen = rows.common, fit.inlier[: len(rows.level)]
    fit = replace(fit, arm=FittedArm(evidence.arm.place, fit.arm.covariance), clock=Clock(0.0, fit.clock.sigma_s))
    believed = dict.fromkeys((7, 8, 9), tuning.antenna_sigma_m) if evidence.arm.estimate else {}
    believed |= {7 + len(believed): tuning.offset_sigma_s} if evidence.estimate_offset else {}
    modes = 0 if evidence.bend is None else len(evidence.bend.done)
    sizes = None
    for _ in range(_STEPS):
        problem = _Problem(evidence, up, fit.similarity, tuning)
        x = problem.at(fit)
        errors = PositionErrors(_linearised(problem, x, fit.inlier, rows, seen), noise, sizes)
        sizes = errors.sizes
        moved, covariance = errors.step(believed)
        rows = replace(rows, common=stated * max(1.0, errors.times_stated))  # receivers are optimistic in every part
        size, held = problem.size, 0.0 if evidence.log_scale is None else evidence.log_scale.sigma**-2
        alone = 1 / max(1 / covariance[6, 6] - held, _OPEN)
        fit = _fit(problem, x + moved[:size], covariance[:size, :size], alone, fit.inlier, fit.cost)
        own = slice(size, size + modes)
        fit = replace(fit, levels=errors.levels, bent=(moved[own], covariance[own, own]))
    return fit


def _linearised(problem: _Problem, x: np.ndarray, inlier: np.ndarray, rows: Stated, seen: np.ndarray) -> Linear:
    """The positions ``seen`` (K,), and everything else as normal equations; the unknowns of the problem, then the
    modes of the shape, then the common error of the positions."""
    sigma, count = problem.evidence.sigma, len(seen)
    common = np.flatnonzero(np.isfinite(rows.common) & seen.any())
    derivatives, off = problem.derivatives(x, inlier.astype(float)), problem.positions(x).ravel()
    bend = (problem.bend(x) * (inlier[:, None] / sigma)[:, :, None]).reshape(len(off), -1)
    beside = np.zeros((len(derivatives), bend.shape[1] + len(common) + 1))  # the unknowns that ``problem`` has not
    beside[: len(off), : bend.shape[1]], beside[: len(off), -1] = bend, off
    beside[len(off) :, -1] = problem.others(x)
    every = np.hstack([derivatives, beside])
    places = every[: 3 * count].reshape(count, 3, every.shape[1]) * sigma[:count, :, None]
    at = -1 - len(common) + np.arange(len(common))
    places[:, common, at] = 1.0
    known = every[3 * count :].T @ every[3 * count :]
    known[range(problem.size, len(known) - 1), range(problem.size, len(known) - 1)] += 1.0  # of modes
    known[at, at] = rows.common[common] ** -2
    if problem.evidence.bend is not None:
        done = problem.evidence.bend.done
        known[problem.size : problem.size + len(done), -1] = known[-1, problem.size : problem.size + len(done)] = done
        known[-1, -1] += done @ done
    return Linear(rows=places[seen], stated=rows.where(seen), known=known)


class _Problem:
    """Unknowns: rotation (3,) in the world about the middle, shift (3,), log scale, and if requested lever arm (3,),
    clock offset."""

    def __init__(self, evidence: Evidence, up: Up | None, start: Similarity, tuning: FitTuning) -> None:
        self.evidence, self.up, self.start, self.tuning = evidence, up, start, tuning
        self.middle = evidence.pose[:, :3, 3].mean(axis=0)
        self.axis = _track(evidence, start)[0]
        known = np.isfinite(evidence.orientation).all(axis=(1, 2))
        self.oriented = np.flatnonzero(known)
        spread = np.sqrt(max(1.0, known.sum() / tuning.orientation_freedom))
        self.orientation_sigma = np.radians(tuning.orientation_sigma_deg) * spread
        self._unpacked: tuple[bytes, tuple[Similarity, np.ndarray]] | None = None

    def unpack(self, x: np.ndarray) -> tuple[Similarity, np.ndarray]:
        """The similarity and the antenna; cached for the next call, which is mostly about the same unknowns."""
        key = x.tobytes()
        if self._unpacked is None or self._unpacked[0] != key:
            self._unpacked = key, self._unpack(x)
        return self._unpacked[1]

    def _unpack(self, x: np.ndarray) -> tuple[Similarity, np.ndarray]:
        rotation = Rotation.from_rotvec(x[:3]).as_matrix() @ self.start.rotation
        scale = self.start.scale * np.exp(np.clip(x[6], -_MAX_LOG_SCALE, _MAX_LOG_SCALE))
        middle_world = self.start(self.middle) + x[3:6]
        antenna = self.evidence.arm.place + (x[7:10] if self.evidence.arm.estimate else 0.0)
        return Similarity(float(scale), rotation, middle_world - scale * rotation @ self.middle), antenna

    def at(self, fit: Fit) -> np.ndarray:
        """(D,) the unknowns of a fit that started from this problem."""
        x = np.zeros(self.size)
        if self.evidence.arm.estimate:
            x[7:10] = fit.arm.place - self.evidence.arm.place
        if self.evidence.estimate_offset:
            x[-1] = fit.clock.offset_s
        return x

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return 7 + 3 * self.evidence.arm.estimate + self.evidence.estimate_offset

    def offset(self, x: np.ndarray) -> float:
        """Seconds by which the receiver's clock is behind the cameras'."""
        return float(x[-1]) if self.evidence.estimate_offset else 0.0

    def positions(self, x: np.ndarray) -> np.ndarray:
        similarity, antenna = self.unpack(x)
        return self.evidence.position_residuals(similarity, antenna, self.offset(x)) / self.evidence.sigma

    def bend(self, x: np.ndarray) -> np.ndarray:
        """(K, 3, M) derivatives of the antenna's places by the modes of the model's shape, metres."""
        similarity, bend = self.unpack(x)[0], self.evidence.bend
        turn = similarity.scale * similarity.rotation
        return np.zeros((len(self.evidence.pose), 3, 0)) if bend is None else np.einsum("ij,kjm->kim", turn, bend.modes)

    def others(self, x: np.ndarray, with_scale: bool = True) -> np.ndarray:
        similarity, _ = self.unpack(x)
        parts = [1e-3 * x[:3]]  # keeps the system regular where a rotation is undetermined
        if len(self.oriented):
            parts.append(self._off(similarity).ravel() / self.orientation_sigma)
        if self.up is not None:
            upward = similarity.rotation @ self.up.direction
            if self.up.tilt:
                parts.append(to_upright(upward) / np.radians(self.up.sigma_deg))
            else:
                parts.append(np.array([roll_to_upright(upward, self.axis) / np.radians(self.up.sigma_deg)]))
        if self.evidence.log_scale is not None and with_scale:
            off = np.log(similarity.scale) - self.evidence.log_scale.value
            parts.append(np.array([off / self.evidence.log_scale.sigma]))
        if self.evidence.arm.estimate:
            parts.append(x[7:10] / self.tuning.antenna_sigma_m)
        if self.evidence.estimate_offset:
            parts.append(x[-1:] / self.tuning.offset_sigma_s)
        return np.concatenate(parts)

    def _off(self, similarity: Similarity) -> np.ndarray:
        """(O, 3) rotation vectors from the known orientations to those of the model, in the world."""
        inverse = np.swapaxes(self.evidence.orientation[self.oriented], 1, 2)
        turns = similarity.rotation @ self.evidence.pose[self.oriented, :3, :3] @ inverse
        return np.asarray(Rotation.from_matrix(turns).as_rotvec())

    def derivatives(self, x: np.ndarray, weight: np.ndarray, with_scale: bool = True) -> np.ndarray:
        """(M, D) of ``positions``, weighted (K,), and of ``others`` by the unknowns; tested against differences."""
        similarity, antenna = self.unpack(x)
        turn = turn_by_vector(x[None, :3])[0]
        free = float(abs(x[6]) < _MAX_LOG_SCALE)  # the scale is held within that
        places = (
            self._by_unknowns(x, similarity, antenna, turn, free) * (weight[:, None] / self.evidence.sigma)[:, :, None]
        )
        others = self._others_by_unknowns(x, similarity, turn, free, with_scale)
        return np.concatenate([places.reshape(-1, self.size), *others])

    def _by_unknowns(
        self, x: np.ndarray, similarity: Similarity, antenna: np.ndarray, turn: np.ndarray, free: float
    ) -> np.ndarray:
        """(K, 3, D) of the antenna's places, metres."""
        evidence, offset = self.evidence, self.offset(x)
        pose = evidence.pose if evidence.speed is None or not offset else evidence.pose + offset * evidence.speed
        reach = similarity.scale * (pose[:, :3, 3] - self.middle) @ similarity.rotation.T
        out = np.zeros((len(pose), 3, self.size))
        out[:, :, :3] = -skew(reach + pose[:, :3, :3] @ antenna @ similarity.rotation.T) @ turn
        out[:, :, 3:6] = np.eye(3)
        out[:, :, 6] = free * reach
        if evidence.arm.estimate:
            out[:, :, 7:10] = similarity.rotation @ pose[:, :3, :3]
        if evidence.estimate_offset and evidence.speed is not None:
            moved = similarity.scale * evidence.speed[:, :3, 3] + evidence.speed[:, :3, :3] @ antenna
            out[:, :, -1] = moved @ similarity.rotation.T
        return out

    def _others_by_unknowns(
        self, x: np.ndarray, similarity: Similarity, turn: np.ndarray, free: float, with_scale: bool
    ) -> list[np.ndarray]:
        """Rows (., D) in the order of ``others``."""
        evidence, unit = self.evidence, np.eye(self.size)
        parts = [1e-3 * unit[:3]]

        def turned(by_turn: np.ndarray) -> None:
            parts.append(np.hstack([by_turn @ turn, np.zeros((len(by_turn), self.size - 3))]))

        if len(self.oriented):
            turned(vector_by_turn(self._off(similarity)).reshape(-1, 3) / self.orientation_sigma)
        if self.up is not None:
            upward = similarity.rotation @ self.up.direction
            by_upward = upright_by_upward(upward) if self.up.tilt else roll_by_upward(upward, self.axis)[None]
            turned(by_upward @ -skew(upward) / np.radians(self.up.sigma_deg))
        if evidence.log_scale is not None and with_scale:
            parts.append(free * unit[6:7] / evidence.log_scale.sigma)
        if evidence.arm.estimate:
            parts.append(unit[7:10] / self.tuning.antenna_sigma_m)
        if evidence.estimate_offset:
            parts.append(unit[-1:] / self.tuning.offset_sigma_s)
        return parts


def _refine(evidence: Evidence, up: Up | None, start: Similarity, tuning: FitTuning) -> tuple[float, Fit]:
    problem, sigmas = _Problem(evidence, up, start, tuning), tuning.inlier_sigmas
    x = np.zeros(problem.size)
    for scale in tuning.cauchy_scales:  # Cauchy over the whole vector: an outlier in height is one in plan too
        for _ in range(tuning.rounds):
            weight = 1 / np.sqrt(1 + (np.linalg.norm(problem.positions(x), axis=1) / (scale * sigmas)) ** 2)
            before, x = x, _solve(problem, x, weight).x
            if np.abs(x - before).max() < tuning.converged:
                break
    inlier = np.linalg.norm(problem.positions(x), axis=1) < sigmas * np.sqrt(3)
    for _ in range(tuning.rounds):
        if inlier.sum() < 3:
            inlier[:] = True
        x = _solve(problem, x, inlier.astype(float)).x
        again = np.linalg.norm(problem.positions(x), axis=1) < sigmas * np.sqrt(3)
        if np.array_equal(again, inlier):
            break
        inlier = again
    solution = _solve(problem, x, inlier.astype(float))
    distance = np.linalg.norm(problem.positions(solution.x), axis=1)
    cost = float(np.sum(np.log1p((distance / sigmas) ** 2)) * sigmas**2 + 0.5 * np.sum(problem.others(x) ** 2))
    return cost, _report(problem, solution, inlier, cost)


def _solve(
    problem: _Problem, x: np.ndarray, weight: np.ndarray, with_scale: bool = True
) -> scipy.optimize.OptimizeResult:
    def residuals(y: np.ndarray) -> np.ndarray:
        return np.concatenate([(problem.positions(y) * weight[:, None]).ravel(), problem.others(y, with_scale)])

    def jacobian(y: np.ndarray) -> np.ndarray:
        return problem.derivatives(y, weight, with_scale)

    return scipy.optimize.least_squares(residuals, x, jacobian, x_scale="jac", method="trf")


def _sigma(jacobian: np.ndarray, unknown: int) -> float:
    """Sigma of one unknown from the derivatives (R, U) of residuals in sigmas; infinite if it is undetermined."""
    _, size, directions = np.linalg.svd(jacobian, full_matrices=False)
    told = size > np.finfo(float).eps * max(jacobian.shape) * size[0]
    along = directions[told, unknown]
    return float(np.linalg.norm(along / size[told])) if 1.0 - along @ along < _OPEN else float("inf")


def _report(problem: _Problem, solution: scipy.optimize.OptimizeResult, inlier: np.ndarray, cost: float) -> Fit:
    freedom = max(1, 3 * int(inlier.sum()) - len(solution.x))
    chi2 = max(1.0, float(np.sum(problem.positions(solution.x)[inlier] ** 2)) / freedom)
    covariance = np.linalg.pinv(solution.jac.T @ solution.jac) * chi2
    alone = solution.jac
    if problem.evidence.log_scale is not None:
        alone = _solve(problem, solution.x, inlier.astype(float), with_scale=False).jac
    return _fit(problem, solution.x, covariance, chi2 * _sigma(alone, 6) ** 2, inlier, cost)


def _fit(
    problem: _Problem, x: np.ndarray, covariance: np.ndarray, alone: float, inlier: np.ndarray, cost: float
) -> Fit:
    """The fit at unknowns (D,) with this covariance; ``alone``: variance of the log scale from the positions."""
    similarity, antenna = problem.unpack(x)
    sd = np.sqrt(np.clip(np.diag(covariance), 0, None))
    arm, clock = problem.evidence.arm.estimate, problem.evidence.estimate_offset
    return Fit(
        similarity=similarity,
        arm=FittedArm(antenna, covariance[7:10, 7:10] if arm else np.full((3, 3), np.nan)),
        clock=Clock(problem.offset(x), float(sd[-1]) if clock else float("nan")),
        inlier=inlier,
        cost=cost,
        roll_sigma_deg=float(np.degrees(np.sqrt(max(0.0, problem.axis @ covariance[:3, :3] @ problem.axis)))),
        sigma_positions_scale=float(np.sqrt(alone)),
        error=PlacementError(similarity(problem.middle), covariance[:7, :7]),
    )
