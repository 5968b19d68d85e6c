"""Motions of pairs of units, and what loops of them say of each image pair.

One task each for two units: their common motion, and whether their pairs agree with a predicted rotation.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.filter.averaging import RotationAverage, average
from tiegraph.filter.bearings import Calibration, Task, load
from tiegraph.filter.motion import Rays, agreeing, counts, search, support, with_rotation
from tiegraph.filter.motion import support as backed
from tiegraph.filter.settings import FilterSettings
from tiegraph.filter.tuning import LoopTuning, MotionTuning, Tuning
from tiegraph.geometry import transforms
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

_log = logging.getLogger(__name__)

Map = Callable[..., list[Any]]  # (function, items, *args) -> results in the order of the items


@dataclass(frozen=True)
class Motions:
    """Motions of M pairs of units that agree with the loops: n_from_m, lengths of t arbitrary for a coincident rig."""

    units: np.ndarray  # (M, 2) frames, or image indices with ``by_frame`` False
    n_from_m: np.ndarray  # (M, 4, 4)
    support: np.ndarray  # (M,) matches, at most 100 of an image pair
    by_frame: bool

    def to_npz(self) -> dict[str, np.ndarray]:
        """Columns for ``np.savez``."""
        return {
            "motion_units": self.units,
            "motion_n_from_m": self.n_from_m,
            "motion_support": self.support,
            "motion_by_frame": np.array(self.by_frame),
        }


@dataclass(frozen=True)
class Work:
    """What all steps share."""

    database: str
    scene: Scene
    pairs: Pairs  # kept ones only
    settings: FilterSettings
    tuning: Tuning
    run_map: Map


@dataclass(frozen=True)
class Decided:
    """Of each pair (P,) bool whether it is refused, or cannot be told of; the motions that agree, and notes."""

    refused: np.ndarray
    undecided: np.ndarray
    motions: Motions
    notes: list[str]


def tasks_of(work: Work, unit: np.ndarray) -> tuple[list[Task], list[np.ndarray]]:
    """Pairs of units with their image pairs (first image in the first unit), and the rows of the pair table of each."""
    i, j = work.pairs.i.astype(int), work.pairs.j.astype(int)
    swap = unit[i] > unit[j]
    i, j = np.where(swap, j, i), np.where(swap, i, j)
    rows = np.flatnonzero(unit[i] != unit[j])
    order = rows[np.lexsort((j[rows], i[rows], unit[j[rows]], unit[i[rows]]))]
    ends = np.stack([unit[i[order]], unit[j[order]]], axis=1)
    cuts = np.flatnonzero(np.any(np.diff(ends, axis=0) != 0, axis=1)) + 1
    groups = [g for g in np.split(order, cuts) if len(g)]
    tasks = [
        (int(unit[i[g[0]]]), int(unit[j[g[0]]]), tuple(zip(i[g].tolist(), j[g].tolist())))
        for g in groups
    ]  # fmt: skip
    return tasks, groups


def decide(work: Work, calibration: Calibration, method: str) -> Decided:
    """Measure the motions of all units, average their rotations, and ask again what contradicts them."""
    settings, by_frame = work.settings, method.startswith("rig") and method != "rig does not hold"
    bound = settings.max_error_px / calibration.focal_px()
    tasks, groups = tasks_of(work, calibration.unit)
    measured: list[MeasuredMotion] = work.run_map(measure, tasks, work.database, calibration, bound, work.tuning.motion)
    _log.info("%d pairs of units measured", len(tasks))
    wide = settings.max_loop_deg * _widened(method, work.tuning.loops)
    loops, tolerance, spread = _loops(work, tasks, measured, wide)
    noisy = work.tuning.loops.sigmas * spread > work.tuning.loops.noisy_deg
    notes = []
    if noisy:
        notes.append(
            f"loops of {'frames' if by_frame else 'images'} close no better than {spread:.1f} deg "
            f"(median): the cameras' focal lengths are probably wrong. No pair was refused"
        )
    items = [] if noisy else _doubts(measured, loops, tolerance, work.tuning)
    asked = [Predicted(tasks[k], rotation, doubtful) for k, rotation, doubtful in items]
    judged: list[MotionTest] = work.run_map(judge, asked, work.database, calibration, bound, tolerance, work.tuning)
    refused, undecided = np.zeros(len(work.pairs), bool), np.zeros(len(work.pairs), bool)
    motion = {k: m.motion for k, m in enumerate(measured) if m.motion is not None and loops.residual_deg[k] < tolerance}
    support = {k: measured[k].support(work.tuning.motion) for k in motion}
    for (k, _, doubtful), verdict in zip(items, judged):
        agrees = _agrees(verdict.agree, measured[k].total, work.tuning) | (verdict.own_deg < tolerance)
        refused[groups[k][doubtful & ~agrees]] = True
        if k not in motion and verdict.motion is not None and np.any(doubtful & agrees):
            motion[k], support[k] = verdict.motion, backed(verdict.agree, work.tuning.motion)
    for k in range(len(tasks)):
        if not loops.reliable[k] and not loops.residual_deg[k] < tolerance:
            undecided[groups[k]] = True
    if undecided.any():
        notes.append(f"{int(undecided.sum())} pairs have no loops to tell by and contradict others: kept")
    keys = sorted(motion)
    ends = np.array([tasks[k][:2] for k in keys], int).reshape(-1, 2)
    if not by_frame:
        ends = ends - work.scene.frames
    matrices = np.array([motion[k] for k in keys]).reshape(-1, 4, 4)
    agreed = Motions(units=ends, n_from_m=matrices, support=np.array([support[k] for k in keys]), by_frame=by_frame)
    return Decided(refused=refused, undecided=undecided, motions=agreed, notes=notes)


def _widened(method: str, tuning: LoopTuning) -> float:
    """By how much loops of a method close worse: single images have no rig to lean on."""
    return {"images": tuning.width_images, "rig does not hold": tuning.width_no_rig}.get(method, 1.0)


def _agrees(agree: np.ndarray, total: np.ndarray, tuning: Tuning) -> np.ndarray:
    """(P,) bool: enough matches agree with a motion, in number and in share. A pair of few matches needs their most."""
    most = np.maximum(np.ceil(tuning.min_agree_share * total), tuning.min_agree_few)
    return (agree >= np.minimum(tuning.min_agree, most)) & (agree >= tuning.min_share * total)


def _loops(
    work: Work, tasks: Sequence[Task], measured: Sequence[MeasuredMotion], wide: float
) -> tuple[RotationAverage, float, float]:
    """Rotations of all units by votes, how far a true tie may be off them, and how far half of them are; degrees."""
    tuning = work.tuning.loops
    ends = np.array([t[:2] for t in tasks], int).reshape(-1, 2)
    used, compact = np.unique(ends, return_inverse=True)
    compact = compact.reshape(-1, 2)
    rotations = np.array([np.eye(3) if m.motion is None else m.motion[:3, :3] for m in measured]).reshape(-1, 3, 3)
    weight = np.array([m.support(work.tuning.motion) for m in measured])
    near = _neighbours(work.scene, ends, tuning.neighbour_steps)
    weight = weight * np.where(near, tuning.neighbour_weight, 1.0)
    loops = average(len(used), compact, rotations, weight, wide, tuning)
    there = np.isfinite(loops.residual_deg) & loops.reliable
    basis = there & near if np.sum(there & near) >= tuning.neighbours_enough else there
    spread = float(np.median(loops.residual_deg[basis])) if basis.any() else 0.0
    tolerance = max(wide, tuning.sigmas * spread)
    return _Predictor.of(loops, compact), tolerance, spread


@dataclass(frozen=True)
class _Predictor(RotationAverage):
    """Averaged rotations with the ends of the edges they judge."""

    ends: np.ndarray

    @staticmethod
    def of(loops: RotationAverage, ends: np.ndarray) -> _Predictor:
        return _Predictor(
            unit_from_world=loops.unit_from_world,
            component=loops.component,
            residual_deg=loops.residual_deg,
            reliable=loops.reliable,
            ends=ends,
        )

    def of_edge(self, k: int) -> np.ndarray:
        """Predicted n_from_m (3, 3) of an edge."""
        return self.predicted(int(self.ends[k, 0]), int(self.ends[k, 1]))


def _neighbours(scene: Scene, ends: np.ndarray, steps: int) -> np.ndarray:
    """(E,) bool: units of one pass at most so many steps apart."""
    frame = np.concatenate([np.arange(scene.frames), scene.frame])[ends]
    sequence, step = scene.sequence[frame], scene.sequence_index[frame]
    close = np.abs(step[:, 0].astype(int) - step[:, 1]) <= steps
    return (sequence[:, 0] == sequence[:, 1]) & (sequence[:, 0] >= 0) & close


def _doubts(
    measured: Sequence[MeasuredMotion], loops: RotationAverage, tolerance: float, tuning: Tuning
) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """(task, predicted rotation, doubtful pairs) of everything that contradicts and can be decided."""
    assert isinstance(loops, _Predictor)
    items = []
    for k, found in enumerate(measured):
        if not loops.reliable[k]:
            continue
        fits = bool(loops.residual_deg[k] < tolerance)
        good = _agrees(found.agree, found.total, tuning) if fits else np.zeros(len(found.total), bool)
        doubtful = ~good & (found.total > 0)
        if doubtful.any():
            items.append((k, loops.of_edge(k), doubtful))
    return items


# --- one task each for two units -------------------------------------------------------------------------------------


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
    item: Predicted, database: str, calibration: Calibration, bound_rad: float, turn_deg: float, tuning: Tuning
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
