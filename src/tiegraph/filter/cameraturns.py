"""The rig against the images: do its cameras move as one, and by how much is each of them turned?

Least squares over the epipolar residuals of many frame pairs at once: one motion each (eliminated, Schur) and one small
rotation for each camera. No points and no model are needed; a straight drive is enough where cameras see what others
saw.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.filter.bearings import Calibration, Task, load
from tiegraph.filter.motion import Rays, adjust, agreeing, counts, residuals, search
from tiegraph.filter.tuning import Tuning


@dataclass(frozen=True)
class RigCheck:
    """What the matches say of S sensors."""

    turns: np.ndarray  # (S, 3, 3) of the sensor's rays in the rig frame, of the first sensor none
    turn_deg: np.ndarray  # (S,)
    matches: np.ndarray  # (S,) that were looked at
    share_before: np.ndarray  # (S,) of its matches that agree with the common motions, as given
    share_after: np.ndarray  # (S,) the same with the turns
    total_before: float
    total_after: float


@dataclass(frozen=True)
class _Sample:
    rays: Rays
    sensor_m: np.ndarray  # (K,) of the matches
    sensor_n: np.ndarray
    pairs: int


def check_rig(tasks: list[Task], database: str, calibration: Calibration, bound_rad: float, tuning: Tuning) -> RigCheck:
    """Turn the sensors until the matches of the frame pairs agree best; two frame pairs or more."""
    sensors = len(calibration.cameras)
    samples = [_sample(task, database, calibration, tuning.motion.matches_a_pair) for task in tasks]
    size = calibration.size()
    first = [search(s.rays, bound_rad, size, tuning.motion) for s in samples]
    before = _shares(samples, first, bound_rad, sensors)
    motions = [search(s.rays, tuning.rig.bounds[0] * bound_rad, size, tuning.motion) for s in samples]
    turns, prior = np.tile(np.eye(3), (sensors, 1, 1)), np.full(sensors, tuning.rig.turn_prior_rad)
    steps = tuning.motion.steps
    for wide in tuning.rig.bounds:
        turned = [_turned(s, turns) for s in samples]
        motions = [m if m is None else adjust(r, m, wide * bound_rad, steps) for r, m in zip(turned, motions)]
        step = _step(samples, turned, motions, wide * bound_rad, prior)
        turns = Rotation.from_rotvec(step).as_matrix() @ turns
    turns = turns[0].T @ turns  # the first sensor is the rig frame
    final = [_turned(s, turns) for s in samples]
    again = [search(r, bound_rad, size, tuning.motion) for r in final]
    samples_after = [
        _Sample(rays=r, sensor_m=s.sensor_m, sensor_n=s.sensor_n, pairs=s.pairs) for r, s in zip(final, samples)
    ]
    after = _shares(samples_after, again, bound_rad, sensors)
    angle = np.degrees(Rotation.from_matrix(turns).magnitude())
    return RigCheck(
        turns=turns,
        turn_deg=angle,
        matches=after[1],
        share_before=before[0],
        share_after=after[0],
        total_before=before[2],
        total_after=after[2],
    )


def _sample(task: Task, database: str, calibration: Calibration, most: int) -> _Sample:
    rays = load(task, database, calibration, most)
    pair = np.array(task[2])
    keys = calibration.sensor[pair]
    return _Sample(rays=rays, sensor_m=keys[rays.pair, 0], sensor_n=keys[rays.pair, 1], pairs=len(pair))


def _turned(sample: _Sample, turns: np.ndarray) -> Rays:
    r = sample.rays
    m = np.einsum("kij,kj->ki", turns[sample.sensor_m], r.ray_m)
    n = np.einsum("kij,kj->ki", turns[sample.sensor_n], r.ray_n)
    return Rays(ray_m=m, ray_n=n, centre_m=r.centre_m, centre_n=r.centre_n, pair=r.pair)


def _step(
    samples: list[_Sample], turned: list[Rays], motions: list[np.ndarray | None], bound_rad: float, prior: np.ndarray
) -> np.ndarray:
    """(S, 3) rotation vectors of one Gauss-Newton step, the motions eliminated; ``prior`` (S,): sigmas in radians."""
    sensors = len(prior)
    normal, right = np.diag(np.repeat(1 / prior**2, 3)), np.zeros(3 * sensors)
    normal[:3, :3] += 1e12 * np.eye(3)  # gauge: the first sensor is the rig frame
    for sample, rays, motion in zip(samples, turned, motions):
        if motion is None:
            continue
        value = residuals(rays, motion)
        weight = 1 / (1 + (value / bound_rad) ** 2) ** 2 / bound_rad**2
        by_sensor, by_motion = _jacobians(sample, rays, motion, value, sensors)
        ws, wm = weight[:, None] * by_sensor, weight[:, None] * by_motion
        inner = by_motion.T @ wm
        inner += 1e-6 * np.trace(inner) * np.eye(6)
        mixed = by_motion.T @ ws
        normal += by_sensor.T @ ws - mixed.T @ np.linalg.solve(inner, mixed)
        right += by_sensor.T @ (weight * value) - mixed.T @ np.linalg.solve(inner, by_motion.T @ (weight * value))
    return np.linalg.solve(normal, -right).reshape(sensors, 3)


def _jacobians(
    sample: _Sample, rays: Rays, motion: np.ndarray, value: np.ndarray, sensors: int
) -> tuple[np.ndarray, np.ndarray]:
    """(K, 3 S) of the sensors' turns and (K, 6) of the motion, by forward differences."""
    small, rows = 1e-6, np.arange(len(value))
    by_sensor = np.zeros((len(value), 3 * sensors))
    by_motion = np.zeros((len(value), 6))
    length = max(float(np.linalg.norm(motion[:3, 3])), 1e-9)
    for axis in range(3):
        turn = Rotation.from_rotvec(small * np.eye(3)[axis]).as_matrix()
        m = Rays(
            ray_m=rays.ray_m @ turn.T, ray_n=rays.ray_n, centre_m=rays.centre_m, centre_n=rays.centre_n, pair=rays.pair
        )
        n = Rays(
            ray_m=rays.ray_m, ray_n=rays.ray_n @ turn.T, centre_m=rays.centre_m, centre_n=rays.centre_n, pair=rays.pair
        )
        by_sensor[rows, 3 * sample.sensor_m + axis] += (residuals(m, motion) - value) / small
        by_sensor[rows, 3 * sample.sensor_n + axis] += (residuals(n, motion) - value) / small
        rotated, moved = motion.copy(), motion.copy()
        rotated[:3, :3] = turn @ motion[:3, :3]
        moved[axis, 3] += small * length
        by_motion[:, axis] = (residuals(rays, rotated) - value) / small
        by_motion[:, 3 + axis] = (residuals(rays, moved) - value) / small
    return by_sensor, by_motion


def _shares(
    samples: list[_Sample], motions: list[np.ndarray | None], bound_rad: float, sensors: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """(S,) share that agrees, (S,) matches, and the share over camera pairs, each counted alike."""
    good, total, shares = np.zeros(sensors), np.zeros(sensors), []
    for sample, motion in zip(samples, motions):
        if len(sample.rays.pair) == 0:
            continue
        mask = np.zeros(len(sample.rays.pair), bool)
        if motion is not None:
            mask = agreeing(sample.rays, motion, bound_rad)
        for keys in (sample.sensor_m, sample.sensor_n):
            good += np.bincount(keys[mask], minlength=sensors)
            total += np.bincount(keys, minlength=sensors)
        every = np.bincount(sample.rays.pair, minlength=sample.pairs)
        shares += (counts(sample.rays, mask, sample.pairs) / np.maximum(every, 1))[every > 0].tolist()
    share = np.where(total > 0, good / np.maximum(total, 1), np.nan)
    return share, total, float(np.median(shares)) if shares else 0.0
