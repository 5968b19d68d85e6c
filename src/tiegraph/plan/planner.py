"""From what is asked to the plan: the sweep of stations, and the path with its accuracy and effort. Tables as text
and as CSV, planned against reached.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.plan.accuracy import PathPlan, Propagate, plan_path
from tiegraph.plan.figures import Effort, Lens, Station, advice, effort, station
from tiegraph.plan.network import MountedCamera
from tiegraph.plan.path import WAYS, Anchor, Course, make_path, read_anchor, waypoint_csv, waypoint_kml
from tiegraph.plan.request import PlanRequest, numbers
from tiegraph.text import csv_text

FORMAT = 1


@dataclass(frozen=True)
class Rigged:
    """The cameras of the rig; COLMAP ids of those that are calibrated; whether their places in the rig are."""

    cameras: list[MountedCamera]
    held: tuple[int, ...] = ()
    fixed: bool = False


@dataclass(frozen=True)
class Plan:
    """What `tiegraph plan` says."""

    lens: Lens
    stations: tuple[Station, ...]
    advice: tuple[str, ...]
    path: PathPlan | None = None
    effort: Effort | None = None
    anchor: Anchor | None = None
    shape: Mapping[str, object] = field(default_factory=dict)

    def to_dict(self) -> dict[str, object]:
        """JSON-ready: plan.json."""
        out: dict[str, object] = {
            "format": FORMAT,
            "camera": {"focal_px": self.lens.focal_px, "size": list(self.lens.size)},
            "stations": [s.row() for s in self.stations],
            "advice": list(self.advice),
        }
        if self.path is not None and self.effort is not None:
            out["path"] = {
                **self.shape, **self.path.summary(), "effort": self.effort.row(),
                "places": [p.row() for p in self.path.places], "worst": list(self.path.worst),
            }  # fmt: skip
        return out

    def files(self) -> dict[str, str]:
        """name -> content of what is written beside plan.json."""
        rows = [s.row() for s in self.stations]
        columns = list(dict.fromkeys(name for row in rows for name in row))  # a column for each figure of any station
        cells = ((row.get(name) for name in columns) for row in rows)
        out = {"stations.csv": csv_text(columns, (["" if v is None else f"{v:.6g}" for v in row] for row in cells))}
        if self.path is not None:
            out["waypoints.csv"] = waypoint_csv(self.path.path, self.anchor)
            if self.anchor is not None:
                out["waypoints.kml"] = waypoint_kml(self.path.path, self.anchor)
        return out


def make_plan(request: PlanRequest, rigged: Rigged, by: Propagate, most_features: int) -> Plan:
    """The plan. ``by``: the covariance of an adjusted model; an image keeps ``most_features``.

    Raises InputError for what makes no survey.
    """
    shape = request.path.shape
    camera = rigged.cameras[0].camera
    lens = Lens(camera.mean_focal_length(), (camera.width, camera.height), along=1 if shape == "grid" else 0)
    stations, said = _sweep(request, lens)
    plan = Plan(lens=lens, stations=stations, advice=said)
    if shape is None:
        return plan
    if len(stations) > 1:
        raise InputError(f"--shape {shape} is of one distance and base: {len(stations)} are given")
    return _with_path(plan, request, rigged, by, most_features)


def _sweep(request: PlanRequest, lens: Lens) -> tuple[tuple[Station, ...], tuple[str, ...]]:
    images, said, made = request.images, [], []
    for base, overlap in product(numbers("base", images.base), numbers("overlap", images.overlap)):
        wanted = images.wanted(base, overlap)
        for distance in images.distances():
            made.append(station(lens, distance, wanted))
            said += advice(made[-1], lens, wanted)
    return tuple(made), tuple(said)


def _with_path(plan: Plan, request: PlanRequest, rigged: Rigged, by: Propagate, most_features: int) -> Plan:
    asked, world, made = request.path, request.world, plan.stations[0]
    if asked.passes is not None and (asked.passes not in (1, 2) or asked.shape not in WAYS):
        raise InputError(f"--passes {asked.passes}: 1 or 2, of {', '.join(WAYS)}; other shapes have rows or rings")
    world.positions()  # what is wrong with them is said before the work
    anchor = None if world.origin is None else read_anchor(world.origin, world.heading)
    across = made.footprint_m[1 - plan.lens.along]
    course = Course(
        shape=str(asked.shape),
        distance_m=made.distance_m,
        length_m=asked.length,
        width_m=asked.length if asked.width is None else asked.width,
        height_m=2 * made.distance_m if asked.height is None else asked.height,
        base_m=made.base_m,
        row_m=(1 - request.images.sidelap) * across,
        passes=(2 if asked.shape == "canal" else 1) if asked.passes is None else asked.passes,
        turned_deg=(asked.yaw, asked.pitch),
    )
    # In parts of the distance: no wall is a plane, which would leave lenses open; a canal or road is lined by houses
    # behind quays and parked cars (canal: 0.25).
    uneven = 0.25 if asked.shape in ("canal", "road") else 0.1
    relief = uneven * made.distance_m if asked.relief is None else asked.relief
    path = make_path(course)
    found = plan_path(path, rigged.cameras, by, world, relief)
    sizes = [(c.camera.width, c.camera.height) for c in rigged.cameras]
    cost = effort(sizes, len(path), path.length_m, request.images.speed, most_features)
    facts = {"shape": course.shape, "distance_m": course.distance_m, "length_m": course.length_m}
    said = (*plan.advice, *found.advice)
    return replace(plan, advice=said, path=found, effort=cost, anchor=anchor, shape=facts)


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
    heads = ("leg", "m", "frames", "ties", "cameras, shape", "cameras, world", "points, shape", "points, world")
    places = Table("expected sigma by place, mm", heads, tuple(rows))
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
