"""The common motion of two rigs from bearing vectors: central five-point hypotheses, refined with all centres.

A match is two unit rays in their rig frames and the centres they start at. A motion is n_from_m: x_n = R x_m + t. With
centres that nearly coincide (a panoramic head: 6 cm of base against 15 m of range) the length of t is not observable;
it stays near where the search began, which changes no residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.filter.tuning import MotionTuning
from tiegraph.geometry import transforms
from tiegraph.geometry.rays import cross, sampson
from tiegraph.scene.sorting import Columns

_SEED = 0
_SMALL = 1e-6  # step of differences
_SMALL_TURNS = Rotation.from_rotvec(_SMALL * np.eye(3)).as_matrix()


@dataclass(frozen=True)
class Rays(Columns):
    """K matches of two rigs: unit rays (K, 3) and their centres (K, 3) in the frames of rig m and rig n."""

    ray_m: np.ndarray
    ray_n: np.ndarray
    centre_m: np.ndarray
    centre_n: np.ndarray
    pair: np.ndarray  # (K,) which camera pair


def residuals(rays: Rays, motion: np.ndarray) -> np.ndarray:
    """(K,) Sampson distance on the unit sphere, radians, of matches to the epipolar planes of a motion (4, 4)."""
    q = rays.ray_m @ motion[:3, :3].T
    p = rays.centre_m @ motion[:3, :3].T + motion[:3, 3] - rays.centre_n
    return sampson(rays.ray_n, q, p)


def agreeing(rays: Rays, motion: np.ndarray, bound_rad: float) -> np.ndarray:
    """(K,) bool: within the bound of the epipolar plane, and in front of both cameras (or too far away to tell)."""
    near = np.abs(residuals(rays, motion)) < bound_rad
    q = rays.ray_m @ motion[:3, :3].T
    p = rays.centre_m @ motion[:3, :3].T + motion[:3, 3] - rays.centre_n
    b = rays.ray_n
    qb = cross(q, b)
    far = (np.einsum("ij,ij->i", qb, qb) < bound_rad**2) & (np.einsum("ij,ij->i", q, b) > 0)
    depth_m = -np.einsum("ij,ij->i", cross(p, b), qb)
    depth_n = -np.einsum("ij,ij->i", cross(p, q), qb)
    return near & (far | ((depth_m > 0) & (depth_n > 0)))


def counts(rays: Rays, mask: np.ndarray, pairs: int) -> np.ndarray:
    """(pairs,) matches of each camera pair in a mask (K,)."""
    return np.bincount(rays.pair[mask], minlength=pairs)


def support(by_pair: np.ndarray, tuning: MotionTuning) -> float:
    """What a motion is backed by: matches, of each camera pair no more than ``votes_a_pair``."""
    return float(np.minimum(by_pair, tuning.votes_a_pair).sum())


def search(rays: Rays, bound_rad: float, size: float, tuning: MotionTuning) -> np.ndarray | None:
    """A motion (4, 4) that many matches agree with, by five-point RANSAC as if all centres were one; None if none."""
    if len(rays.pair) < tuning.least_matches:
        return None
    options = pycolmap.RANSACOptions(max_error=tuning.search_widens * bound_rad, random_seed=_SEED)
    options.max_num_trials, options.min_num_trials = tuning.trials, tuning.least_trials
    few = _thinned(rays, tuning.search_matches)
    found = pycolmap.estimate_relative_pose(few.ray_m, few.ray_n, options)
    if not found:
        return None
    pose = found["cam2_from_cam1"]
    return refine(rays, transforms.rigid(pose.rotation.matrix(), pose.translation), bound_rad, size, tuning)


def refine(
    rays: Rays, motion: np.ndarray, bound_rad: float, size: float, tuning: MotionTuning, turning: bool = True
) -> np.ndarray:
    """Least squares (Gauss-Newton, Cauchy weights) from a motion whose translation has the right direction only.

    ``size``: of the rig, in the unit of its centres; 0 = all centres are one.
    """
    direction = motion[:3, 3] / max(float(np.linalg.norm(motion[:3, 3])), 1e-12)
    lengths = [size * s for s in tuning.first_lengths] if size > 0 else [1.0]
    starts = [transforms.rigid(motion[:3, :3], direction * length) for length in lengths]
    rays = _thinned(rays, tuning.refine_matches)
    best = min(starts, key=lambda m: _cost(residuals(rays, m), bound_rad))
    return adjust(rays, best, bound_rad, tuning.steps, turning)


def adjust(rays: Rays, motion: np.ndarray, bound_rad: float, steps: int, turning: bool = True) -> np.ndarray:
    """Gauss-Newton with Cauchy weights from a whole motion; the kernel narrows to half the bound.

    ``turning`` False: the rotation stays.
    """
    value = residuals(rays, motion)
    cost = _cost(value, bound_rad)
    for k in range(steps):
        scale = bound_rad * max(0.5, 1.5 - 0.5 * k)
        jacobian = _jacobian(rays, motion, value)
        if not turning:
            jacobian[:, :3] = 0.0
        weight = 1 / (1 + (value / scale) ** 2)
        normal = jacobian.T @ (weight[:, None] * jacobian)
        damping = 1e-6 * np.trace(normal) * np.eye(6) + 1e-12 * np.eye(6)
        candidate = _moved(motion, np.linalg.solve(normal + damping, -jacobian.T @ (weight * value)))
        value = residuals(rays, candidate)
        lower = _cost(value, bound_rad)
        if not lower < cost:
            break
        motion, done = candidate, cost - lower < 1e-4 * cost
        cost = lower
        if done:
            break
    return motion


def with_rotation(
    rays: Rays, rotation: np.ndarray, bound_rad: float, size: float, turn_deg: float, tuning: MotionTuning
) -> np.ndarray | None:
    """The motion within ``turn_deg`` of a rotation (3, 3) that most matches agree with; None if no parallax tells.

    Its translation is sampled from two matches. Where refinement turns it away (a narrow view hardly tells a turn from
    a step aside), only the translation is refined.
    """
    normal = cross(rays.ray_m @ rotation.T, rays.ray_n)
    length = np.linalg.norm(normal, axis=1)
    usable = np.flatnonzero(length > bound_rad)  # nearly parallel rays do not tell where the other rig is
    if len(usable) < tuning.least_matches:
        return None
    unit = normal[usable] / length[usable, None]
    picks = np.random.default_rng(_SEED).integers(0, len(usable), (tuning.directions, 2))
    directions = cross(unit[picks[:, 0]], unit[picks[:, 1]])
    norm = np.linalg.norm(directions, axis=1)
    directions = directions[norm > 1e-6] / norm[norm > 1e-6, None]
    if len(directions) == 0:
        return None
    hits = (np.abs(unit @ directions.T) < tuning.direction_widens * bound_rad).sum(axis=0)
    best = directions[int(np.argmax(hits))]
    starts = [transforms.rigid(rotation, sign * best) for sign in (1.0, -1.0)]
    both = [_held(rays, start, bound_rad, size, turn_deg, tuning) for start in starts]
    return max(both, key=lambda m: int(agreeing(rays, m, bound_rad).sum()))


def _held(
    rays: Rays, motion: np.ndarray, bound_rad: float, size: float, turn_deg: float, tuning: MotionTuning
) -> np.ndarray:
    free = refine(rays, motion, bound_rad, size, tuning)
    if transforms.angle_deg(free[:3, :3], motion[:3, :3]) < turn_deg:
        return free
    return refine(rays, motion, bound_rad, size, tuning, turning=False)


def _thinned(rays: Rays, most: int) -> Rays:
    if len(rays.pair) <= most:
        return rays
    return rays.where(np.linspace(0, len(rays.pair) - 1, most).astype(int))


def _cost(value: np.ndarray, bound_rad: float) -> float:
    return float(np.log1p((value / bound_rad) ** 2).sum())


def _moved(motion: np.ndarray, step: np.ndarray) -> np.ndarray:
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    scale = max(float(np.linalg.norm(motion[:3, 3])), 1e-9)
    return transforms.rigid(turn @ motion[:3, :3], motion[:3, 3] + scale * step[3:])


def _jacobian(rays: Rays, motion: np.ndarray, value: np.ndarray) -> np.ndarray:
    """(K, 6) of rotation, then translation in parts of its length; by forward differences from residuals (K,)."""
    length = max(float(np.linalg.norm(motion[:3, 3])), 1e-9)
    columns = []
    for turn in _SMALL_TURNS:
        rotated = motion.copy()
        rotated[:3, :3] = turn @ motion[:3, :3]
        columns.append(residuals(rays, rotated) - value)
    turned, centre = rays.ray_m @ motion[:3, :3].T, rays.centre_m @ motion[:3, :3].T
    for axis in range(3):
        moved = motion[:3, 3].copy()
        moved[axis] += _SMALL * length
        columns.append(sampson(rays.ray_n, turned, centre + moved - rays.centre_n) - value)
    return np.stack(columns, axis=1) / _SMALL
