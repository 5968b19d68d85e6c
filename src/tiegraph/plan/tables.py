"""Plans as tables of text and as CSV."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

from tiegraph.plan.effort import Effort
from tiegraph.plan.figures import Station
from tiegraph.plan.places import PathPlan


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
    out = io.StringIO()
    writer = csv.DictWriter(out, columns, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({k: "" if v is None else f"{v:.6g}" for k, v in row.items()})
    return out.getvalue()


def station_table(stations: Sequence[Station]) -> Table:
    """The sweep: precision by the fewest and the most rays."""
    columns = ["m", "GSD mm", "px/mm²", "footprint m", "base m", "overlap", "σ depth mm (rays)", "σ across"]
    moving, wanted = any(s.exposure_s for s in stations), any(s.farthest_m for s in stations)
    columns += [*(["expose ms"] * moving), *(["reaches m"] * wanted)]
    rows = []
    for s in stations:
        known = {n: p for n, p in enumerate(s.precision_m, 2) if n in (2, len(s.precision_m) + 1)}
        deep = " ".join(f"{1000 * p:.3f} ({n})" for n, p in known.items()) or "no overlap"
        row = [f"{s.distance_m:g}", f"{1000 * s.gsd_m:.3g}", f"{s.points_mm2:.3g}"]
        row += [f"{s.footprint_m[0]:.3g} x {s.footprint_m[1]:.3g}", f"{s.base_m:.3g}", f"{100 * s.overlap:.0f} %", deep]
        row += [f"{1000 * s.across_m:.3f}"]
        row += [_text(None if s.exposure_s is None else 1000 * s.exposure_s)] * moving + [_text(s.farthest_m)] * wanted
        rows.append(tuple(row))
    return Table("images at these distances", tuple(columns), tuple(rows))


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
