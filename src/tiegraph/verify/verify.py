"""From verified matches of image pairs to pairs that agree with one motion of the rig and with loops of frames.

1. The rig against the images (rigcheck): refined if its cameras are turned, given up if its frames do not move as one.
2. Each two units (frames of the rig, or images): the motion most of their matches agree with (motion).
3. The rotations of all motions against each other by votes and loops (averaging).
4. A pair is refused only if closed loops predict another rotation, and neither its units under that rotation nor the
   pair for itself can be reconciled with it. What loops cannot tell is kept and counted as undecided.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.verify import bearings
from tiegraph.verify.averaging import Averaged, average
from tiegraph.verify.bearings import Calibration, Task
from tiegraph.verify.judge import Judged, Measured, judge, measure
from tiegraph.verify.motion import support as backed
from tiegraph.verify.prior import Prior, agreement, held_by_rig
from tiegraph.verify.rigcheck import RigCheck, check_rig
from tiegraph.verify.settings import VerifySettings
from tiegraph.verify.tuning import LoopTuning, Tuning

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
class Verification:
    """The pair table with reason "repeat" and what was found on the way."""

    pairs: Pairs
    motions: Motions
    method: str  # rig, rig refined, images, rig does not hold (images, wider), off
    undecided: np.ndarray  # (P,) bool: kept, though its units contradict, because no loop tells
    counts: dict[str, float]
    notes: tuple[str, ...]
    tables: dict[str, dict]


@dataclass(frozen=True)
class _Work:
    """What all steps share."""

    database: str
    scene: Scene
    pairs: Pairs  # kept ones only
    settings: VerifySettings
    tuning: Tuning
    run_map: Map


def verify_pairs(
    database: Path,
    scene: Scene,
    pairs: Pairs,
    settings: VerifySettings,
    tuning: Tuning,
    run_map: Map,
    prior: Prior | None = None,
) -> Verification:
    """Refuse ("repeat") the kept pairs that contradict the rig or loops of frames; the database is read only.

    Pairs of images that both are in the ``prior``, a rough model, are judged by it; all others by the rig and loops.
    ``run_map(function, items, *args)`` runs items anywhere. Raises InputError for a missing database or camera,
    SettingsError from the scene's rig.
    """
    kept = pairs.kept()
    work = _Work(database=str(database), scene=scene, pairs=kept, settings=settings, tuning=tuning, run_map=run_map)
    if settings.method == "off" or len(kept) == 0:
        return _nothing(pairs, scene)
    bearings.forget()
    asked, contradicts, said = _by_prior(work, prior)
    calibration, method, notes, rows = _calibrated(work, asked)
    rest = replace(work, pairs=kept.where(~asked))
    others, open_, motions, more = _decide(rest, calibration, method)
    bearings.forget()
    refused, undecided = contradicts, np.zeros(len(kept), bool)
    refused[~asked], undecided[~asked] = others, open_
    notes = [*said, *notes]
    table = np.zeros(len(pairs), bool)
    table[np.flatnonzero(pairs.dropped == 0)[refused]] = True
    flagged = np.zeros(len(pairs), bool)
    flagged[np.flatnonzero(pairs.dropped == 0)[undecided]] = True
    out = pairs.drop(table, "repeat")
    counts: dict[str, float] = {
        "pairs": len(kept),
        "kept": len(kept) - int(refused.sum()),
        "refused": int(refused.sum()),
    }
    counts |= {"undecided": int(undecided.sum()), "motions": len(motions.units)}
    tables = {"camera pairs": _table(scene, kept, refused)}
    if rows:
        tables["rig against images"] = {"columns": ["camera", "turned deg", "agrees", "turned, agrees"], "rows": rows}
    return Verification(
        pairs=out,
        motions=motions,
        method=method,
        undecided=flagged,
        counts=counts,
        notes=(*notes, *more),
        tables=tables,
    )


def _by_prior(work: _Work, prior: Prior | None) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(P,) judged by the prior, (P,) contradicted, notes. A prior that contradicts many pairs is not believed."""
    pairs, nothing = work.pairs, np.zeros(len(work.pairs), bool)
    if prior is None or work.settings.method != "auto":
        return nothing, nothing.copy(), []
    prior = held_by_rig(prior, work.scene, work.tuning.prior)
    known = prior.known()
    judged = known[pairs.i] & known[pairs.j]
    rows = np.flatnonzero(judged)
    if not len(rows):
        return nothing, nothing.copy(), []
    items = [(int(pairs.i[k]), int(pairs.j[k])) for k in rows]
    lone = Calibration.of(work.scene, by_frame=False)
    share = np.array(work.run_map(agreement, items, work.database, lone, prior, work.tuning))
    wrong = share < work.tuning.prior.min_share
    figures = f"the coarse model agrees with {len(rows) - int(wrong.sum())} of {len(rows)} pairs"
    if wrong.mean() > work.tuning.prior.max_refused:
        return nothing, nothing.copy(), [f"{figures}: too few, so it is not asked"]
    asked, contradicts = nothing, nothing.copy()
    asked[rows] = True
    contradicts[rows[wrong]] = True
    return asked, contradicts, [figures]


def _nothing(pairs: Pairs, scene: Scene) -> Verification:
    empty = Motions(units=np.zeros((0, 2), int), n_from_m=np.zeros((0, 4, 4)), support=np.zeros(0), by_frame=False)
    kept = pairs.kept()
    counts: dict[str, float] = {"pairs": len(kept), "kept": len(kept), "refused": 0}
    none = np.zeros(len(pairs), bool)
    return Verification(
        pairs=pairs,
        motions=empty,
        method="off",
        undecided=none,
        counts=counts,
        notes=("nothing was verified",),
        tables={},
    )


def _units(scene: Scene, by_frame: bool) -> np.ndarray:
    """(N,) what moves as one: the frame; an image for itself where its sensor has no extrinsics."""
    alone = scene.frames + np.arange(len(scene))
    if not by_frame:
        return alone
    known = np.array([s.sensor_from_rig is not None for s in scene.all_sensors])
    return np.where(known[scene.sensor_key] | (scene.sensor == 0), scene.frame, alone)


def _tasks(work: _Work, unit: np.ndarray) -> tuple[list[Task], list[np.ndarray]]:
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


def _calibrated(work: _Work, asked: np.ndarray) -> tuple[Calibration, str, list[str], list[list]]:
    """Cameras and extrinsics to verify with, how (`Verification.method`), and why; ``asked`` (P,): judged already."""
    scene, settings, tuning = work.scene, work.settings, work.tuning.rig
    lone = _with_units(scene, by_frame=False)
    if asked.all():
        return lone, "images", [], []
    several = [r for r in scene.rigs if sum(s.sensor_from_rig is not None for s in r.sensors) > 1]
    if settings.method == "images":
        return lone, "images", [], []
    if not several:
        why = "no rig with known extrinsics: images are verified one by one, by loops of images"
        return lone, "images", [why], []
    calibration = _with_units(scene, by_frame=True)
    tasks = sorted(_tasks(work, calibration.unit)[0], key=lambda t: (-len(t[2]), t[:2]))[: tuning.frame_pairs]
    tasks = [t for t in tasks if len(t[2]) > 1]
    if len(tasks) < tuning.least_frame_pairs:
        note = (
            f"only {len(tasks)} frame pairs are tied by several cameras: the rig could not be checked, it is believed"
        )
        return calibration, "rig", [note], []
    check = check_rig(tasks, work.database, calibration, settings.max_error_px / calibration.focal_px(), work.tuning)
    rows = [
        [s.name, round(float(d), 2), _share(b), _share(a)]
        for s, d, b, a in zip(scene.all_sensors, check.turn_deg, check.share_before, check.share_after)
    ]
    found, method, note = _choose(check, calibration, work)
    notes = [note] if note else []
    return (lone if method == "rig does not hold" else found), method, notes, rows


def _with_units(scene: Scene, by_frame: bool) -> Calibration:
    calibration = Calibration.of(scene, by_frame)
    return Calibration(
        cameras=calibration.cameras,
        rig_from_sensor=calibration.rig_from_sensor,
        sensor=calibration.sensor,
        unit=_units(scene, by_frame),
    )


def _share(value: float) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None


def _choose(check: RigCheck, given: Calibration, work: _Work) -> tuple[Calibration, str, str]:
    """Which rig to go on with, and a note."""
    names, tuning = [s.name for s in work.scene.all_sensors], work.tuning.rig
    worst = int(np.argmax(check.turn_deg))
    better = check.total_after > check.total_before + tuning.gain and check.turn_deg[worst] > tuning.turn_deg
    turned = f"{names[worst]} is turned by {check.turn_deg[worst]:.1f} deg"
    before, after = f"{check.total_before:.0%}", f"{check.total_after:.0%}"
    shares = f"{before} of a pair's matches (median) agree with common motions as given, {after} turned"
    best = check.total_after if better else check.total_before
    absurd = better and check.turn_deg[worst] > tuning.max_turn_deg
    if (best < tuning.min_share or absurd) and work.settings.method != "rig":
        low = int(np.nanargmin(np.where(check.matches > 0, check.share_after, np.nan)))
        return given, "rig does not hold", (
            f"the rig does not hold: {shares}; least {names[low]} ({check.share_after[low]:.0%}), and {turned} against "
            f"{names[0]}. Extrinsics, focal lengths or synchronisation are wrong: its images are verified one by one, "
            f"which refuses far less"
        )  # fmt: skip
    if better and not absurd:
        return given.turned(check.turns), "rig refined", f"rig refined from the matches: {turned}; {shares}"
    return given, "rig", ""


def _decide(work: _Work, calibration: Calibration, method: str) -> tuple[np.ndarray, np.ndarray, Motions, list[str]]:
    """(P,) refused, (P,) undecided, the motions, and notes."""
    settings, by_frame = work.settings, method.startswith("rig") and method != "rig does not hold"
    bound = settings.max_error_px / calibration.focal_px()
    tasks, groups = _tasks(work, calibration.unit)
    measured: list[Measured] = work.run_map(measure, tasks, work.database, calibration, bound, work.tuning.motion)
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
    items = [] if noisy else _doubts(tasks, measured, loops, tolerance, work.tuning)
    asked = [(tasks[k], rotation, doubtful) for k, rotation, doubtful in items]
    judged: list[Judged] = work.run_map(judge, asked, work.database, calibration, bound, tolerance, work.tuning)
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
    return (
        refused,
        undecided,
        Motions(units=ends, n_from_m=matrices, support=np.array([support[k] for k in keys]), by_frame=by_frame),
        notes,
    )


def _widened(method: str, tuning: LoopTuning) -> float:
    """By how much loops of a method close worse: single images have no rig to lean on."""
    return {"images": tuning.width_images, "rig does not hold": tuning.width_no_rig}.get(method, 1.0)


def _agrees(agree: np.ndarray, total: np.ndarray, tuning: Tuning) -> np.ndarray:
    """(P,) bool: enough matches agree with a motion, in number and in share. A pair of few matches needs their most."""
    most = np.maximum(np.ceil(tuning.min_agree_share * total), tuning.min_agree_few)
    return (agree >= np.minimum(tuning.min_agree, most)) & (agree >= tuning.min_share * total)


def _loops(
    work: _Work, tasks: Sequence[Task], measured: Sequence[Measured], wide: float
) -> tuple[Averaged, float, float]:
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
class _Predictor(Averaged):
    """Averaged rotations with the ends of the edges they judge."""

    ends: np.ndarray

    @staticmethod
    def of(loops: Averaged, ends: np.ndarray) -> _Predictor:
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
    track, step = scene.track[frame], scene.step[frame]
    close = np.abs(step[:, 0].astype(int) - step[:, 1]) <= steps
    return (track[:, 0] == track[:, 1]) & (track[:, 0] >= 0) & close


def _doubts(
    tasks: Sequence[Task], measured: Sequence[Measured], loops: Averaged, tolerance: float, tuning: Tuning
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


def _table(scene: Scene, kept: Pairs, refused: np.ndarray) -> dict:
    """Pairs and refused ones by camera pair."""
    names = [s.name for s in scene.all_sensors]
    keys = np.sort(np.stack([scene.sensor_key[kept.i], scene.sensor_key[kept.j]], axis=1), axis=1)
    found, place = np.unique(keys, axis=0, return_inverse=True)
    asked = np.bincount(place.ravel(), minlength=len(found))
    gone = np.bincount(place.ravel(), weights=refused, minlength=len(found)).astype(int)
    rows = [[names[a], names[b], int(n), int(g)] for (a, b), n, g in zip(found, asked, gone)]
    return {"columns": ["camera", "camera", "pairs", "refused"], "rows": rows}
