"""One task each for two units: their common motion, and whether their pairs agree with a predicted rotation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiegraph.filter.bearings import Calibration, Task, load
from tiegraph.filter.motion import Rays, agreeing, counts, search, support, with_rotation
from tiegraph.filter.tuning import MotionTuning, Tuning
from tiegraph.geometry import transforms


@dataclass(frozen=True)
class MeasuredMotion:
    """The motion n_from_m of two units, and the matches of each of their P image pairs that agree with it."""

    motion: np.ndarray | None  # (4, 4)
    agree: np.ndarray  # (P,)
    total: np.ndarray  # (P,) matches looked at

    def support(self, tuning: MotionTuning) -> float:
        """What the motion is backed by, 0 without one."""
        return 0.0 if self.motion is None else support(self.agree, tuning)


@dataclass(frozen=True)
class MotionTest:
    """What a predicted rotation finds: matches that agree with the best motion of that rotation, per image pair."""

    motion: np.ndarray | None
    agree: np.ndarray  # (P,)
    own_deg: np.ndarray  # (P,) angle of the pair's own five-point rotation to the prediction; NaN = not asked or none


def measure(
    task: Task, database: str, calibration: Calibration, bound_rad: float, tuning: MotionTuning
) -> MeasuredMotion:
    """The motion most matches of two units agree with."""
    rays = load(task, database, calibration, tuning.matches_a_pair)
    pairs = len(task[2])
    total = np.bincount(rays.pair, minlength=pairs)
    motion = search(rays, bound_rad, calibration.size(), tuning)
    if motion is None:
        return MeasuredMotion(None, np.zeros(pairs, int), total)
    return MeasuredMotion(motion, counts(rays, agreeing(rays, motion, bound_rad), pairs), total)


@dataclass(frozen=True)
class Predicted:
    """Two units, the rotation (3, 3) predicted between them, and which of their image pairs (P,) bool are doubtful."""

    task: Task
    rotation: np.ndarray
    doubtful: np.ndarray


def judge(
    item: Predicted,
    database: str,
    calibration: Calibration,
    bound_rad: float,
    turn_deg: float,
    tuning: Tuning,
) -> MotionTest:
    """Ask two units under their predicted rotation, and each doubtful image pair for its own rotation."""
    task, rotation, doubtful = item.task, item.rotation, item.doubtful
    rays, size = load(task, database, calibration, tuning.motion.matches_a_pair), calibration.size()
    pairs = len(task[2])
    motion = with_rotation(rays, rotation, bound_rad, size, turn_deg, tuning.motion)
    agree = np.zeros(pairs, int)
    if motion is not None:
        agree = counts(rays, agreeing(rays, motion, bound_rad), pairs)
    own = np.full(pairs, np.nan)
    for k in np.flatnonzero(doubtful):
        own[k] = _own_angle(rays.where(rays.pair == k), rotation, bound_rad, size, turn_deg, tuning)
    return MotionTest(motion, agree, own)


def _own_angle(
    rays: Rays, rotation: np.ndarray, bound_rad: float, size: float, turn_deg: float, tuning: Tuning
) -> float:
    """Degrees between a pair's own rotation and the prediction; of the two a plane allows, the better one counts."""
    free = search(rays, bound_rad, size, tuning.motion)
    held = with_rotation(rays, rotation, bound_rad, size, turn_deg, tuning.motion)
    if free is None:
        return float("nan")
    best = int(agreeing(rays, free, bound_rad).sum())
    if held is not None and int(agreeing(rays, held, bound_rad).sum()) >= tuning.as_good * best:
        return float(transforms.angle_deg(held[:3, :3], rotation))
    return float(transforms.angle_deg(free[:3, :3], rotation))
