"""Pairs that contradict the coarse model or loops of rotations are refused.

The coarse model, though rough, shows more than loops: a wall that repeats along the path gives false matches
with the right rotation and on the right epipolar lines, but at impossible distances.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiegraph.filter.loops import Map, Matches, by_loops, forget
from tiegraph.filter.settings import FilterSettings
from tiegraph.filter.tuning import PriorTuning, Tuning
from tiegraph.geometry import transforms
from tiegraph.scene.course import off_course_deg
from tiegraph.scene.graph import parts
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import CourseTuning


@dataclass(frozen=True)
class Prior:
    """A rough model: cam_from_world (N, 4, 4), NaN = not there or not trusted; reach (N, 2): nearest and farthest
    points each image sees, same units."""

    cam_from_world: np.ndarray
    reach: np.ndarray

    def known(self) -> np.ndarray:
        """(N,) bool: images it can judge."""
        return np.all(np.isfinite(self.cam_from_world), axis=(1, 2)) & np.all(np.isfinite(self.reach), axis=1)


def agreement(pair: tuple[int, int], matches: Matches, prior: Prior, tuning: CourseTuning) -> float:
    """Share of the verified matches of an image pair that a surface within reach explains; NaN without any."""
    i, j = pair
    a, b = matches.rays(i, j)
    if not len(a):
        return float("nan")
    j_from_i = prior.cam_from_world[j] @ transforms.invert(prior.cam_from_world[i])
    off = off_course_deg(a, b, j_from_i, (prior.reach[i], prior.reach[j]), tuning)
    return float(np.mean(off <= tuning.tolerance_deg))


@dataclass(frozen=True)
class Filtering:
    """The pair table with reason "repeat"; ``undecided`` (P,) bool: kept, though others contradict, because no loop
    decides; figures by name, notes and tables for people."""

    pairs: Pairs
    undecided: np.ndarray
    counts: dict[str, int]
    notes: tuple[str, ...]
    tables: dict[str, dict]


def filter_pairs(
    database: Path,
    scene: Scene,
    pairs: Pairs,
    settings: FilterSettings,
    tunings: tuple[Tuning, CourseTuning],
    run_map: Map,
    prior: Prior | None = None,
) -> Filtering:
    """Refuse ("repeat") the kept pairs that contradict the coarse model or loops; the database is read only.

    Pairs of images that both are in the ``prior``, a rough model, are judged by it; all others by loops.
    ``run_map(function, items, *args)`` runs items anywhere. Raises InputError for a missing database or camera.
    """
    kept, (tuning, course) = pairs.kept(), tunings
    if settings.method == "off" or not len(kept):
        counts = {"pairs": len(kept), "kept": len(kept), "refused": 0}
        return Filtering(pairs, np.zeros(len(pairs), bool), counts, notes=("no pair was tested",), tables={})
    forget()
    matches = Matches.of(database, scene, tuning.matches_a_pair)
    asked, refused, notes = np.zeros(len(kept), bool), np.zeros(len(kept), bool), ()
    if prior is not None:
        asked, refused, notes = _by_prior(scene, kept, matches, prior, (tuning.prior, course), run_map)
    others = np.flatnonzero(~asked)
    by_rotation = by_loops(scene, kept.where(others), matches, tuning.loops, run_map)
    forget()
    undecided = np.zeros(len(kept), bool)
    refused[others], undecided[others], said = by_rotation
    gone = int(refused.sum())
    return Filtering(
        pairs=pairs.drop(_in_table(pairs, refused), "repeat"),
        undecided=_in_table(pairs, undecided),
        counts={"pairs": len(kept), "kept": len(kept) - gone, "refused": gone, "undecided": int(undecided.sum())},
        notes=(*notes, *said),
        tables={"camera pairs": _table(scene, kept, refused)},
    )


def _in_table(pairs: Pairs, of_kept: np.ndarray) -> np.ndarray:
    """(P,) bool of all pairs, from that of the kept ones."""
    out = np.zeros(len(pairs), bool)
    out[np.flatnonzero(pairs.dropped == 0)[of_kept]] = True
    return out


def _by_prior(
    scene: Scene, pairs: Pairs, matches: Matches, prior: Prior, tunings: tuple[PriorTuning, CourseTuning], run_map: Map
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Of each pair (P,) bool whether a rough model judges it, and whether it refuses it; notes.

    A model that contradicts many pairs is not used, and neither is the relative pose of two parts of it if it
    contradicts all pairs between them.
    """
    tuning, course = tunings
    known = prior.known()
    asked, refused = np.zeros((2, len(pairs)), bool)
    rows = np.flatnonzero(known[pairs.i] & known[pairs.j])
    if not len(rows):
        return asked, refused, ()
    ends = np.stack([pairs.i[rows], pairs.j[rows]])
    wrong = np.array(run_map(agreement, ends.T.tolist(), matches, prior, course)) < course.min_share
    said = f"the coarse model agrees with {len(rows) - int(wrong.sum())} of {len(rows)} pairs"
    if wrong.mean() > tuning.max_refused:
        return asked, refused, (f"{said}: too few, so it is not used",)
    asked_of, wrong_of = (np.bincount(e.ravel(), minlength=len(known)) for e in (ends, ends[:, wrong]))
    misplaced = wrong_of > tuning.max_refused_image * asked_of
    if misplaced.any():
        said += f"; it has {int(misplaced.sum())} images at a wrong place, whose pairs it does not judge"
        placed = ~misplaced[ends].any(axis=0)
        rows, wrong, ends = rows[placed], wrong[placed], ends[:, placed]
    part = parts(ends[0, ~wrong], ends[1, ~wrong], len(known))
    alone = wrong & (part[ends[0]] != part[ends[1]])
    if alone.any():
        said += f"; {int(alone.sum())} of the others are the only ties of parts of it, and are not refused by it"
        rows, wrong = rows[~alone], wrong[~alone]
    asked[rows] = True
    refused[rows[wrong]] = True
    return asked, refused, (said,)


def _table(scene: Scene, kept: Pairs, refused: np.ndarray) -> dict:
    """Pairs and refused ones by camera pair."""
    names = [s.name for s in scene.all_sensors]
    keys = np.sort(np.stack([scene.sensor_key[kept.i], scene.sensor_key[kept.j]], axis=1), axis=1)
    found, place = np.unique(keys, axis=0, return_inverse=True)
    asked = np.bincount(place.ravel(), minlength=len(found))
    gone = np.bincount(place.ravel(), weights=refused, minlength=len(found)).astype(int)
    rows = [[names[a], names[b], int(n), int(g)] for (a, b), n, g in zip(found, asked, gone)]
    return {"columns": ["camera", "camera", "pairs", "refused"], "rows": rows}
