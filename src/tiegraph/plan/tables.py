"""Plans as tables of text and as CSV; planned against reached, the same figures side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.plan.figures import Effort, Station
from tiegraph.plan.places import PathPlan
from tiegraph.text import csv_text

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


@dataclass(frozen=True)
class Table:
    """A title, columns and rows of text, and what they say in a sentence."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    sentence: str = ""


def station_csv(stations: Sequence[Station]) -> str:
    """One station a line, a column for each figure of any of them."""
    rows = [s.row() for s in stations]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    cells = ((row.get(name) for name in columns) for row in rows)
    return csv_text(columns, (["" if v is None else f"{v:.6g}" for v in row] for row in cells))


def station_table(stations: Sequence[Station]) -> Table:
    """The sweep: precision by the fewest and the most rays."""
    rows = []
    for s in stations:
        known = {n: p for n, p in enumerate(s.precision_m, 2) if n in (2, len(s.precision_m) + 1)}
        rows.append({
            "m": f"{s.distance_m:g}",
            "GSD mm": f"{1000 * s.gsd_m:.3g}",
            "px/mm²": f"{s.points_mm2:.3g}",
            "footprint m": f"{s.footprint_m[0]:.3g} x {s.footprint_m[1]:.3g}",
            "base m": f"{s.base_m:.3g}",
            "overlap": f"{100 * s.overlap:.0f} %",
            "σ depth mm (rays)": " ".join(f"{1000 * p:.3f} ({n})" for n, p in known.items()) or "no overlap",
            "σ across": f"{1000 * s.across_m:.3f}",
            "expose ms": _text(None if s.exposure_s is None else 1000 * s.exposure_s),
            "reaches m": _text(s.farthest_m),
        })  # fmt: skip
    columns = tuple(c for c in rows[0] if any(row[c] != "-" for row in rows))
    return Table("images at these distances", columns, tuple(tuple(row[c] for c in columns) for row in rows))


def path_tables(plan: PathPlan, cost: Effort) -> list[Table]:
    """Sigmas by place, and what the survey costs."""
    rows = []
    for p in plan.places:
        sigma = (p.shape_m, p.world_m, p.point_shape_m, p.point_world_m)
        rows.append((p.leg, f"{p.from_m:.0f} - {p.to_m:.0f}", str(p.frames), str(p.ties), *(_mm(v) for v in sigma)))
    places = Table(
        "expected sigma by place, mm",
        ("leg", "m", "frames", "ties", "cameras, shape", "cameras, world", "points, shape", "points, world"),
        tuple(rows),
    )
    site = "-" if cost.site_s is None else f"{cost.site_s / 60:.1f}"
    effort = Table(
        "effort",
        ("images", "way m", "minutes", "images GB", "run folder GB", "CPU h, model", "CPU h, cloud"),
        ((str(cost.images), f"{cost.way_m:.0f}", site, _text(cost.image_bytes / 1e9), _text(cost.run_bytes / 1e9),
          _text(cost.sparse_cpu_s / 3600), _text(cost.dense_cpu_s / 3600)),),
    )  # fmt: skip
    return [places, effort]


def _mm(value: float) -> str:
    return "-" if value != value else f"{1000 * value:.3g}"


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"


def comparison(planned: Mapping[str, Any], reached: Mapping[str, float | None]) -> Table:
    """Rows: planned, reached, reached over planned. ``planned``: a plan.json with a path. Raises InputError without.

    An error measured against a reference stands beside the planned sigma in shape, which it is a sample of.
    """
    path, stations = planned.get("path"), planned.get("stations")
    if not isinstance(path, dict) or not isinstance(stations, list) or not stations:
        raise InputError("the plan has no path to compare with: make it with --shape, and -o for its plan.json")
    first = {**stations[0], **path}
    rows = [_row(name, first.get(key), reached.get(key), factor) for name, key, factor in _ROWS]
    if reached.get("ate_m") is not None:
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
    return " and ".join(parts)


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
