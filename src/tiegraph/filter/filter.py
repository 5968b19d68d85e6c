"""Pairs that contradict the coarse model or loops of rotations are refused."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiegraph.filter.bearings import Matches, forget
from tiegraph.filter.loops import Map, by_loops
from tiegraph.filter.prior import Prior, agreement, held_by_rig
from tiegraph.filter.settings import FilterSettings
from tiegraph.filter.tuning import Tuning
from tiegraph.scene.graph import parts
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class Filtering:
    """The pair table with reason "repeat"; ``undecided`` (P,) bool: kept, though others contradict, because no loop
    tells; figures by name, notes and tables for people."""

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
    tuning: Tuning,
    run_map: Map,
    prior: Prior | None = None,
) -> Filtering:
    """Refuse ("repeat") the kept pairs that contradict the coarse model or loops; the database is read only.

    Pairs of images that both are in the ``prior``, a rough model, are judged by it; all others by loops.
    ``run_map(function, items, *args)`` runs items anywhere. Raises InputError for a missing database or camera.
    """
    kept = pairs.kept()
    if settings.method == "off" or not len(kept):
        counts = {"pairs": len(kept), "kept": len(kept), "refused": 0}
        return Filtering(pairs, np.zeros(len(pairs), bool), counts, notes=("no pair was tested",), tables={})
    forget()
    matches = Matches.of(database, scene, tuning.matches_a_pair)
    judged = Judged.none(len(kept)) if prior is None else _by_prior(scene, kept, matches, prior, tuning, run_map)
    others = np.flatnonzero(~judged.asked)
    loops = by_loops(scene, kept.where(others), matches, settings, tuning.loops, run_map)
    forget()
    refused, undecided = judged.refused.copy(), np.zeros(len(kept), bool)
    refused[others], undecided[others] = loops.refused, loops.undecided
    gone = int(refused.sum())
    return Filtering(
        pairs=pairs.drop(_in_table(pairs, refused), "repeat"),
        undecided=_in_table(pairs, undecided),
        counts={"pairs": len(kept), "kept": len(kept) - gone, "refused": gone, "undecided": int(undecided.sum())},
        notes=(*judged.notes, *loops.notes),
        tables={"camera pairs": _table(scene, kept, refused)},
    )


def _in_table(pairs: Pairs, of_kept: np.ndarray) -> np.ndarray:
    """(P,) bool of all pairs, from that of the kept ones."""
    out = np.zeros(len(pairs), bool)
    out[np.flatnonzero(pairs.dropped == 0)[of_kept]] = True
    return out


@dataclass(frozen=True)
class Judged:
    """Of each pair (P,) bool whether the coarse model judges it, and whether it refuses it; notes."""

    asked: np.ndarray
    refused: np.ndarray
    notes: tuple[str, ...] = ()

    @staticmethod
    def none(count: int, *notes: str) -> "Judged":
        """Of a model that is not asked."""
        return Judged(*np.zeros((2, count), bool), notes=notes)


def _by_prior(scene: Scene, pairs: Pairs, matches: Matches, prior: Prior, tuning: Tuning, run_map: Map) -> Judged:
    """What a rough model says of the pairs of its images; one that contradicts many of them is not believed, and how
    two parts of it stand to each other is not if it contradicts all pairs between them."""
    prior, own = held_by_rig(prior, scene, tuning.prior), tuning.prior
    known = prior.known()
    rows = np.flatnonzero(known[pairs.i] & known[pairs.j])
    if not len(rows):
        return Judged.none(len(pairs))
    ends = np.stack([pairs.i[rows], pairs.j[rows]])
    wrong = np.array(run_map(agreement, ends.T.tolist(), matches, prior, own)) < own.min_share
    said = f"the coarse model agrees with {len(rows) - int(wrong.sum())} of {len(rows)} pairs"
    if wrong.mean() > own.max_refused:
        return Judged.none(len(pairs), f"{said}: too few, so it is not asked")
    asked_of, wrong_of = (np.bincount(e.ravel(), minlength=len(known)) for e in (ends, ends[:, wrong]))
    misplaced = wrong_of > own.max_refused_image * asked_of
    if misplaced.any():
        said += f"; it has {int(misplaced.sum())} images at the wrong place, whose pairs it is not asked about"
        placed = ~misplaced[ends].any(axis=0)
        rows, wrong, ends = rows[placed], wrong[placed], ends[:, placed]
    part = parts(ends[0, ~wrong], ends[1, ~wrong], len(known))
    alone = wrong & (part[ends[0]] != part[ends[1]])
    if alone.any():
        said += f"; {int(alone.sum())} of the others are all that ties parts of it, and are not refused for it"
        rows, wrong = rows[~alone], wrong[~alone]
    asked, refused = np.zeros((2, len(pairs)), bool)
    asked[rows] = True
    refused[rows[wrong]] = True
    return Judged(asked, refused, (said,))


def _table(scene: Scene, kept: Pairs, refused: np.ndarray) -> dict:
    """Pairs and refused ones by camera pair."""
    names = [s.name for s in scene.all_sensors]
    keys = np.sort(np.stack([scene.sensor_key[kept.i], scene.sensor_key[kept.j]], axis=1), axis=1)
    found, place = np.unique(keys, axis=0, return_inverse=True)
    asked = np.bincount(place.ravel(), minlength=len(found))
    gone = np.bincount(place.ravel(), weights=refused, minlength=len(found)).astype(int)
    rows = [[names[a], names[b], int(n), int(g)] for (a, b), n, g in zip(found, asked, gone)]
    return {"columns": ["camera", "camera", "pairs", "refused"], "rows": rows}
