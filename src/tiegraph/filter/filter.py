"""From verified matches of image pairs to pairs that agree with one motion of the rig and with loops of frames.

1. The rig against the images (rigcheck): refined if its cameras are turned, given up if its frames do not move as one.
2. Each two units (frames of the rig, or images): the motion most of their matches agree with (motion).
3. The rotations of all motions against each other by votes and loops (averaging).
4. A pair is refused only if closed loops predict another rotation, and neither its units under that rotation nor the
   pair for itself can be reconciled with it. What loops cannot tell is kept and counted as undecided.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tiegraph.filter import bearings
from tiegraph.filter.bearings import Calibration
from tiegraph.filter.cameraturns import RigCheck, check_rig
from tiegraph.filter.loops import Map, Motions, Work, decide, tasks_of
from tiegraph.filter.prior import Prior, agreement, held_by_rig
from tiegraph.filter.settings import FilterSettings
from tiegraph.filter.tuning import Tuning
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class Filtering:
    """The pair table with reason "repeat" and what was found on the way."""

    pairs: Pairs
    motions: Motions
    method: str  # rig, rig refined, images, rig does not hold (images, wider), off
    undecided: np.ndarray  # (P,) bool: kept, though its units contradict, because no loop tells
    counts: dict[str, float]
    notes: tuple[str, ...]
    tables: dict[str, dict]


def filter_pairs(
    database: Path,
    scene: Scene,
    pairs: Pairs,
    settings: FilterSettings,
    tuning: Tuning,
    run_map: Map,
    prior: Prior | None = None,
) -> Filtering:
    """Refuse ("repeat") the kept pairs that contradict the rig or loops of frames; the database is read only.

    Pairs of images that both are in the ``prior``, a rough model, are judged by it; all others by the rig and loops.
    ``run_map(function, items, *args)`` runs items anywhere. Raises InputError for a missing database or camera,
    SettingsError from the scene's rig.
    """
    kept = pairs.kept()
    work = Work(database=str(database), scene=scene, pairs=kept, settings=settings, tuning=tuning, run_map=run_map)
    if settings.method == "off" or len(kept) == 0:
        return _nothing(pairs)
    bearings.forget()
    asked, contradicts, said = _by_prior(work, prior)
    cameras = _calibrated(work, asked)
    others = decide(replace(work, pairs=kept.where(~asked)), cameras.calibration, cameras.method)
    bearings.forget()
    refused, undecided = contradicts, np.zeros(len(kept), bool)
    refused[~asked], undecided[~asked] = others.refused, others.undecided
    told = {"refused": int(refused.sum()), "undecided": int(undecided.sum()), "motions": len(others.motions.units)}
    return Filtering(
        pairs=pairs.drop(_in_table(pairs, refused), "repeat"),
        motions=others.motions,
        method=cameras.method,
        undecided=_in_table(pairs, undecided),
        counts={"pairs": len(kept), "kept": len(kept) - told["refused"], **told},
        notes=(*said, *cameras.notes, *others.notes),
        tables={"camera pairs": _table(scene, kept, refused), **cameras.tables()},
    )


def _in_table(pairs: Pairs, of_kept: np.ndarray) -> np.ndarray:
    """(P,) bool of all pairs, from that of the kept ones."""
    out = np.zeros(len(pairs), bool)
    out[np.flatnonzero(pairs.dropped == 0)[of_kept]] = True
    return out


def _by_prior(work: Work, prior: Prior | None) -> tuple[np.ndarray, np.ndarray, list[str]]:
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
    ends = np.stack([pairs.i[rows], pairs.j[rows]])
    asked_of, wrong_of = (np.bincount(e.ravel(), minlength=len(known)) for e in (ends, ends[:, wrong]))
    misplaced = wrong_of > work.tuning.prior.max_refused_image * asked_of
    if misplaced.any():
        figures += f"; it has {int(misplaced.sum())} images at the wrong place, whose pairs it is not asked about"
        placed = ~misplaced[ends].any(axis=0)
        rows, wrong = rows[placed], wrong[placed]
    asked, contradicts = nothing, nothing.copy()
    asked[rows] = True
    contradicts[rows[wrong]] = True
    return asked, contradicts, [figures]


def _nothing(pairs: Pairs) -> Filtering:
    empty = Motions(units=np.zeros((0, 2), int), n_from_m=np.zeros((0, 4, 4)), support=np.zeros(0), by_frame=False)
    kept = pairs.kept()
    counts: dict[str, float] = {"pairs": len(kept), "kept": len(kept), "refused": 0}
    none = np.zeros(len(pairs), bool)
    return Filtering(
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


@dataclass(frozen=True)
class _Cameras:
    """Cameras and extrinsics to test with, how (`Filtering.method`), why, and what the images say of the rig."""

    calibration: Calibration
    method: str
    notes: Sequence[str] = ()
    rows: Sequence[list] = ()

    def tables(self) -> dict[str, dict]:
        """The table of the rig, if it was checked."""
        columns = ["camera", "turned deg", "agrees", "turned, agrees"]
        return {"rig against images": {"columns": columns, "rows": list(self.rows)}} if self.rows else {}


def _calibrated(work: Work, asked: np.ndarray) -> _Cameras:
    """The rig, checked against the images, or single images; ``asked`` (P,): pairs that are judged already."""
    scene, settings, tuning = work.scene, work.settings, work.tuning.rig
    lone = _with_units(scene, by_frame=False)
    if asked.all():
        return _Cameras(lone, "images")
    several = [r for r in scene.rigs if sum(s.sensor_from_rig is not None for s in r.sensors) > 1]
    if settings.method == "images":
        return _Cameras(lone, "images")
    if not several:
        why = "no rig with known extrinsics: images are verified one by one, by loops of images"
        return _Cameras(lone, "images", [why])
    calibration = _with_units(scene, by_frame=True)
    tasks = sorted(tasks_of(work, calibration.unit)[0], key=lambda t: (-len(t[2]), t[:2]))[: tuning.frame_pairs]
    tasks = [t for t in tasks if len(t[2]) > 1]
    if len(tasks) < tuning.least_frame_pairs:
        note = (
            f"only {len(tasks)} frame pairs are tied by several cameras: the rig could not be checked, it is believed"
        )
        return _Cameras(calibration, "rig", [note])
    check = check_rig(tasks, work.database, calibration, settings.max_error_px / calibration.focal_px(), work.tuning)
    rows = [
        [s.name, round(float(d), 2), _share(b), _share(a)]
        for s, d, b, a in zip(scene.all_sensors, check.turn_deg, check.share_before, check.share_after)
    ]
    found, method, note = _choose(check, calibration, work)
    return _Cameras(
        calibration=lone if method == "rig does not hold" else found,
        method=method,
        notes=[note] if note else [],
        rows=rows,
    )


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


def _choose(check: RigCheck, given: Calibration, work: Work) -> tuple[Calibration, str, str]:
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
            f"{names[0]}. Extrinsics, focal lengths or synchronisation may be wrong: its images are verified one by "
            f"one, which refuses far less"
        )  # fmt: skip
    if better and not absurd:
        return given.turned(check.turns), "rig refined", f"rig refined from the matches: {turned}; {shares}"
    return given, "rig", ""


def _table(scene: Scene, kept: Pairs, refused: np.ndarray) -> dict:
    """Pairs and refused ones by camera pair."""
    names = [s.name for s in scene.all_sensors]
    keys = np.sort(np.stack([scene.sensor_key[kept.i], scene.sensor_key[kept.j]], axis=1), axis=1)
    found, place = np.unique(keys, axis=0, return_inverse=True)
    asked = np.bincount(place.ravel(), minlength=len(found))
    gone = np.bincount(place.ravel(), weights=refused, minlength=len(found)).astype(int)
    rows = [[names[a], names[b], int(n), int(g)] for (a, b), n, g in zip(found, asked, gone)]
    return {"columns": ["camera", "camera", "pairs", "refused"], "rows": rows}
