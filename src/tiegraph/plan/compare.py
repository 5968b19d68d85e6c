"""Planned against reached: the same figures of a plan and of a finished run, side by side."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.plan.tables import Table

# What is compared: name, key in the plan and in what was reached, factor to the unit that is shown.
_ROWS = (
    ("images", "images", 1.0),
    ("frames apart, m", "base_m", 1.0),
    ("overlap along the way, %", "overlap", 100.0),
    ("pixel at the tie points, mm", "tie_gsd_m", 1000.0),
    ("tie points of an image", "ties_an_image", 1.0),
    ("images of a tie point", "track_length", 1.0),
    ("sigma of cameras in shape, mm", "position_shape_sigma_median_m", 1000.0),
    ("sigma of place in the world, mm", "place_world_sigma_median_m", 1000.0),
    ("sigma of height in the world, mm", "height_world_sigma_median_m", 1000.0),
)


def comparison(planned: Mapping[str, Any], reached: Mapping[str, float | None]) -> Table:
    """Rows: planned, reached, reached over planned. ``planned``: a plan.json with a path. Raises InputError without.

    An error measured against a reference stands beside the planned sigma in shape, which it is a sample of; not of a
    relaxed rig (``relaxed`` = 1 in ``reached``), where it is also of the places of the cameras in the rig.
    """
    path, stations = planned.get("path"), planned.get("stations")
    if not isinstance(path, dict) or not isinstance(stations, list) or not stations:
        raise InputError("the plan has no path to compare with: make it with --shape, and -o for its plan.json")
    first = {**stations[0], **path}
    rows = [_row(name, first.get(key), reached.get(key), factor) for name, key, factor in _ROWS]
    if reached.get("ate_m") is not None and not reached.get("relaxed"):
        sigma = first.get("position_shape_sigma_median_m")
        rows.append(_row("error of cameras in shape (ATE), mm", sigma, reached["ate_m"], 1000.0))
    columns = ("figure", "planned", "reached", "reached / planned")
    return Table("planned and reached", columns, tuple(rows), sentence=_sentence(first, reached))


def _sentence(planned: Mapping[str, Any], reached: Mapping[str, float | None]) -> str:
    """Shape and place, in words."""
    parts = []
    for name, what in (("position_shape", "the shape of the path"), ("place_world", "its place in the world")):
        plan, run = (found.get(f"{name}_sigma_median_m") for found in (planned, reached))
        if _known(plan) and _known(run) and plan and run:
            parts.append(f"{what} is known to {1000 * run:.3g} mm where {1000 * plan:.3g} mm were planned")
    if not parts:
        return "plan and run have no sigma in common: a run without scale or position has none in metres"
    alone = " (of each camera by itself, for they fired at different times)" if reached.get("relaxed") else ""
    return " and ".join(parts) + alone


def _row(name: str, planned: Any, reached: Any, factor: float) -> tuple[str, ...]:
    def shown(value: Any) -> str:
        return f"{factor * value:.4g}" if _known(value) else "-"

    ratio = f"{reached / planned:.2f}" if _known(planned) and _known(reached) and planned else "-"
    return name, shown(planned), shown(reached), ratio


def _known(value: Any) -> bool:
    return isinstance(value, (int, float)) and bool(np.isfinite(value))


def frames_apart(centres: np.ndarray, sequence: np.ndarray, index: np.ndarray) -> float | None:
    """Median distance of neighbours (places (F, 3), NaN = none) in their sequences (F,); None without sequences."""
    order = np.lexsort((index, sequence))
    step = np.linalg.norm(np.diff(centres[order], axis=0), axis=1)
    near = (np.diff(sequence[order]) == 0) & (sequence[order][1:] >= 0) & (np.diff(index[order]) == 1)
    known = step[near & np.isfinite(step)]
    return float(np.median(known)) if len(known) else None
