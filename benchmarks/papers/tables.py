"""The papers' tables beside ours, as markdown, from the rows that ``measure`` keeps. Times are CPU seconds; the
papers' are wall time on their machines."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.papers.measure import RUNS, WITHOUT
from benchmarks.papers.printed import PRINTED, Printed
from benchmarks.papers.scenes import SIX
from benchmarks.table import line
from tiegraph.plan.figures import Lens, Station, Wanted, station

Row = Mapping[str, Any]
_RESULTS = Path(__file__).resolve().parents[1] / "results"
_LIST = ("preview", "candidates", "coarse", "network")
_SEEDED = ("registered", "largest", "components", "points", "ate_m", "in_world", "world_ate_m")
_COLMAP_IS = "COLMAP: pycolmap's defaults on every pair; its dense matching needs CUDA, so there is none here."


def tables(paper: str, rows: Sequence[Row]) -> str:
    """All of a paper: as printed, and ours in the same shape."""
    found = medians(rows)
    blocks = [_printed(p) for p in PRINTED[paper]]
    asked = [(name, m.name) for name, methods in RUNS[paper] for m in methods]
    lost = [f"{name}: {method}" for name, method in asked if (name, method) not in found]
    said = [f"Not measured (`--run`): {'; '.join(lost)}."] if lost else []
    notes = [f"{name}, {method}: {found[name, method]['note']}" for name, method in asked
             if found.get((name, method), {}).get("note")]  # fmt: skip
    said += [f"Rows of other sittings: {'; '.join(notes)}."] if notes else []
    return "\n\n".join([f"# Paper {paper}", "## As printed", *blocks, "## Here", *_HERE[paper](found), *said])


def colmap_rows() -> list[Row]:
    """COLMAP's rows of the table of figures (``benchmarks.run``) in the shape of these: measured once for both."""
    return [
        {**r, "method": "COLMAP", "seed": r["repeat"], "counts": r["pairs"],
         "stages": {s["stage"]: [s["cpu_s"], s["wall_s"]] for s in r["stages"]}}
        for file in ("small_sets", "large_sets")
        for r in json.loads((_RESULTS / f"{file}.json").read_text())["runs"]
        if r["set"] in _BOAT and r["competitor"] == "colmap_exhaustive" and r["calibration"] == "estimated"
    ]  # fmt: skip


def medians(rows: Sequence[Row]) -> dict[tuple[str, str], Row]:
    """A row for each set and method: that of its first seed, with the medians over all seeds of what they change, and
    under ``range`` the least and the most of these."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in sorted(rows, key=lambda r: r["seed"]):
        groups.setdefault((row["set"], row["method"]), []).append(row)
    out: dict[tuple[str, str], Row] = {}
    for key, group in groups.items():
        known = {n: [r[n] for r in group if r.get(n) is not None] for n in _SEEDED}
        known = {n: values for n, values in known.items() if values}
        middle = {n: type(values[0])(median(values)) for n, values in known.items()}
        ranges = {n: (min(v), max(v)) for n, v in known.items() if len(group) > 1}
        stages = {n: [float(median(r["stages"][n][k] for r in group if n in r["stages"])) for k in (0, 1)]
                  for n in group[0]["stages"]}  # fmt: skip
        out[key] = {**group[0], **middle, "stages": stages, "range": ranges, "seeds": len(group)}
    return out


def _spread(row: Row, name: str) -> str | float | None:
    """A figure, over several seeds the median with the least and the most."""
    value, ranges = row.get(name), row.get("range", {})
    if value is None or name not in ranges:
        return value
    low, high = ranges[name]
    return f"{_text(value)} ({_text(low)} to {_text(high)})"


def _printed(table: Printed) -> str:
    return _table(table.title, table.columns, table.rows)


def _table(title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    head = [f"**{title}**", "", line(columns), line(["---"] * len(columns))]
    return "\n".join([*head, *(line([_text(cell) for cell in row]) for row in rows)])


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, tuple | list):
        return " / ".join(_text(v) for v in value)
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 100 else f"{value:.0f}"
    return str(value)


# ------------------------------------------------------------------------------------------------- what a row says


def _cpu(row: Row, *stages: str) -> float | None:
    found = [row["stages"][s][0] for s in stages if s in row["stages"]]
    return float(sum(found)) if found else None


def _sfm(row: Row) -> float | None:
    return _cpu(row, *_LIST, "design", "features", "match", "filter", "sparse", "georef")


def _mvs(row: Row) -> float | None:
    return _cpu(row, "dense", "cloud")


def _total(row: Row) -> float | None:
    """None where a row does not go the whole way: part of the way is no total."""
    if "features" not in row["stages"] or "cloud" not in row["stages"]:
        return None
    return _cpu(row, *(s for s in row["stages"] if s not in ("scan", "evaluate", "report")))


def _masks(row: Row) -> float | None:
    return _cpu(row, "masks", "refine")


def _dense(row: Row) -> float | None:
    return row["counts"].get("dense_points")


def _by(found: Sequence[Row], rows: Sequence[tuple[str, Callable[[Row], Any]]]) -> list[list[Any]]:
    return [[name, *(of(row) for row in found)] for name, of in rows]


_SIZES: tuple[tuple[str, Callable[[Row], Any]], ...] = (
    ("Images", lambda r: r["images"]),
    ("Images used", lambda r: _spread(r, "largest")),
    ("Placed by the rig besides", lambda r: r.get("placed_by_rig")),
    ("Separate models", lambda r: _spread(r, "components")),
    ("Pairs matched", lambda r: r["counts"]["matched"]),
    ("Sparse points", lambda r: _spread(r, "points")),
)
_PER_IMAGE = ("CPU s of SfM an image used", lambda r: _ratio(_sfm(r), r.get("largest")))
_ATE = ("ATE, m", lambda r: _spread(r, "ate_m"))
_WORLD: tuple[tuple[str, Callable[[Row], Any]], ...] = (
    ("Images in the world", lambda r: _spread(r, "in_world")),
    ("ATE of these, m", lambda r: _spread(r, "world_ate_m")),
    ("Seeds: median (least to most)", lambda r: r.get("seeds")),
)


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or not b else a / b


def _columns(found: Mapping[tuple[str, str], Row], name: str, methods: Sequence[str]) -> list[Row]:
    return [found[name, m] for m in methods if (name, m) in found]


def _titled(rows: Sequence[Row]) -> list[str]:
    return ["", *(r["method"] for r in rows)]


# ---------------------------------------------------------------------------------------------------- each paper


_BOAT = ("canal_demo", "canal")
_ALIGNMENT: tuple[tuple[str, Callable[[Row], Any]], ...] = (
    ("Mask image creation", _masks),
    ("Inter-image range search", lambda r: _cpu(r, *_LIST)),
    ("Matching list creation", lambda r: _cpu(r, "design")),
    ("Feature extraction", lambda r: _cpu(r, "features")),
    ("Feature matching", lambda r: _cpu(r, "match")),
    ("Reconstruction", lambda r: _cpu(r, "filter", "sparse", "georef")),
    ("SfM, total", _sfm),
    *_SIZES,
)


def _parts(paper: str) -> list[str]:
    return [m.name for m in WITHOUT if m.name.startswith(paper)]


def _alignment(found: Mapping[tuple[str, str], Row], name: str, paper: str, title: str) -> list[str]:
    rows = _columns(found, name, ("COLMAP", "conventional", *_parts(paper), paper, "tiegraph"))
    more = () if name == "canal_demo" else (_ATE, _PER_IMAGE)  # of the other they stand in the next table
    return [_table(f"{title} on `{name}`, CPU s", _titled(rows), _by(rows, (*_ALIGNMENT, *more)))] if rows else []


def _paper000(found: Mapping[tuple[str, str], Row]) -> list[str]:
    rows = _columns(found, "canal_demo", ("COLMAP", "conventional", *_parts("meguro2024"), "meguro2024", "tiegraph"))
    two = _by(rows, (
        ("Mask image creation", _masks), ("SfM", _sfm), ("MVS", _mvs), ("Total", _total), ("Dense points", _dense),
        ("RMSE (the round trip of equation 6), m", lambda r: r.get("rmse_m")), _ATE, *_WORLD, _PER_IMAGE,
    ))  # fmt: skip
    return [
        *(table for name in _BOAT for table in _alignment(found, name, "meguro2024", "table 1")),
        _table("table 2 on `canal_demo`, CPU s", _titled(rows), two),
        f"{_COLMAP_IS} The round trip says nothing of the poses: beside it stands the ATE.",
    ]


def _paper001(found: Mapping[tuple[str, str], Row]) -> list[str]:
    rows = _columns(found, "canal_demo", ("COLMAP", "conventional", "meguro2025", "tiegraph"))
    whole = _by(rows, (
        ("Final mask processing", _masks), ("SfM", _sfm), ("MVS", _mvs), ("Overall processing", _total), *_SIZES,
        ("MVS points", _dense), ("RMSE (round trip), m", lambda r: r.get("rmse_m")), _ATE, *_WORLD, _PER_IMAGE,
    ))  # fmt: skip
    sections = [r for r in found.values() if r["set"].startswith("canal_demo section")]
    parts = _by(sections, (
        ("Final mask processing", _masks),
        ("Feature point extraction", lambda r: _cpu(r, "features")),
        ("Matching search", lambda r: _cpu(r, *_LIST, "design", "match", "filter")),
        ("SfM", lambda r: _cpu(r, "sparse", "georef")),
        ("MVS", _mvs), ("Overall processing", _total), *_SIZES, ("MVS points", _dense),
        ("RMSE (round trip), m", lambda r: r.get("rmse_m")), _ATE,
    ))  # fmt: skip
    names = ["", *(f"{r['set'].removeprefix('canal_demo ')}, {r['method']}" for r in sections)]
    return [
        _table("tables 1 and 5 on `canal_demo`, CPU s", _titled(rows), whole),
        *_alignment(found, "canal", "meguro2025", "tables 1 and 5 up to the world"),
        _table("table 2: agreement of masks with the truth, %", *_mask_table()),
        _table("tables 3 and 4: sections of `canal_demo` as surveys of their own, CPU s", names, parts),
        f"{_COLMAP_IS} Why the masks of the paper's recipe reach less here: docs/benchmarks.md.",
    ]


def _mask_table() -> tuple[list[str], list[list[Any]]]:
    measured = json.loads((_RESULTS / "masks.json").read_text())["rows"]
    rows, names = [], [f"cam{k}" for k in range(6)]
    for name in ("canal", "canal_demo"):
        for row in (r for r in measured if r["set"] == name and r["source"] in ("meguro2025", "learnt+model")):
            at = {c[0]: c[2] for c in row["cameras"]["rows"]}
            rows.append([f"{name}, {row['source']}", *(at.get(n) for n in names), round(100 * row["accuracy"], 1)])
    return ["", *names, "all"], rows


def _paper002(found: Mapping[tuple[str, str], Row]) -> list[str]:
    rows = _columns(found, "kitchen 40", ("COLMAP", "all pairs", "fuse2014", "fuse2014_safe", "tiegraph"))
    funnel: list[list[Any]] = []
    for row in rows:
        steps = row.get("funnel")
        if steps is None:
            funnel.append([row["method"], row["counts"]["matched"], None, None, None])
            continue
        left = steps["candidates"] - steps.get("weak", 0)
        similar = left - steps.get("similar", 0)
        funnel.append([row["method"], steps["candidates"], left, similar, row["counts"]["matched"]])
    out = [_table("table 1 on 40 frames of a hand-held camera: pairs after each stage",
                  ["", "initial", "not weak", "not similar", "matched"], funnel)]  # fmt: skip
    for what, title in (("points", "table 2: points"), ("cameras", "table 3: cameras")):
        cells = []
        for row in (r for r in rows if r.get("precision")):
            of = row["precision"][what]
            cells.append([row["method"], *(v for pair in zip(of["mean_m"], of["sd_m"]) for v in pair)])
        columns = ["", "X", "sd", "Y", "sd", "Z", "sd"]
        out.append(_table(f"{title}, mean and median standard deviation, m along the truth's axes", columns, cells))
    more = _by(rows, (*_SIZES[1:5], ("CPU s of matching and mapping", lambda r: _cpu(r, "match", "sparse")), _ATE))
    said = (
        "Each model has points of its own: means differ by which they are, and a far point by little parallax counts."
    )
    return [*out, _table("what it costs", _titled(rows), more), said]


def _paper003(found: Mapping[tuple[str, str], Row]) -> list[str]:
    rows, ratios = [], []
    for name, method in ((n, m) for n in SIX for m in ("by poses", "by odometry", "tiegraph")):
        both = _columns(found, name, ("all pairs", method))
        if len(both) < 2:
            continue
        colmap = found.get((name, "COLMAP"))
        rows.append([
            f"{name}, {both[0]['images']} images, {method}", *(_both(both, f) for f in _COSTS),
            None if colmap is None else (colmap["counts"]["matched"], _cpu(colmap, "match"), colmap.get("largest")),
        ])  # fmt: skip
        ratios.append([f"{name}, {method}", *(_quotient(_both(both, f)) for f in (*_COSTS[:4], _COSTS[6]))])
    (printed,) = PRINTED["003"]
    theirs = [[r[0], *(_quotient(r[k]) for k in (1, 2, 3, 4, 7))] for r in printed.rows]
    return [
        _table("the six scenes here, CPU s: all pairs / pairs by the trajectory",
               [*printed.columns, "images used", "COLMAP exhaustive: pairs, matching s, images"], rows),
        _table("all pairs over pairs by the trajectory: ours, then the paper's",
               ["scene", "pairs", "total", "feature detection", "image matching", "dense points"], [*ratios, *theirs]),
    ]  # fmt: skip


def _others(row: Row) -> float | None:
    total, named = _total(row), _cpu(row, "features", "match", "dense", "cloud")
    return None if total is None or named is None else total - named


_COSTS: tuple[Callable[[Row], Any], ...] = (
    lambda r: r["counts"]["matched"],
    _total,
    lambda r: _cpu(r, "features"),
    lambda r: _cpu(r, "match"),
    _mvs,
    _others,
    _dense,
    lambda r: r.get("largest"),
)


def _both(rows: Sequence[Row], of: Callable[[Row], Any]) -> tuple[Any, Any]:
    return of(rows[0]), of(rows[1])


def _quotient(pair: tuple[Any, Any]) -> float | None:
    return None if None in pair or not pair[1] else round(pair[0] / pair[1], 2)


_LENS = Lens(8 / 0.00345, (2448, 2048))  # 8 mm, 3.45 um, 5 MP
_BASE_M, _DISPARITY_PX = 0.075, 0.3
_DISTANCES_M = (0.5, 0.7, 1.0, 1.2)


def planned() -> list[Station]:
    """Paper 004's table 1 by the planner, a station for each of its distances."""
    wanted = Wanted(base_m=_BASE_M, match_px=_DISPARITY_PX)
    return [station(_LENS, d, wanted) for d in _DISTANCES_M]


def _paper004(found: Mapping[tuple[str, str], Row]) -> list[str]:
    del found  # nothing is run
    made = planned()
    rows = [
        ["Precision, mm", *(round(1000 * s.precision_m[0], 3) for s in made)],
        ["Resolution, px/mm2", *(round(s.points_mm2, 1) for s in made)],
        ["Footprint of a camera, cm", *("*".join(f"{100 * v:.1f}" for v in s.footprint_m) for s in made)],
        [
            "Common to the square of four, cm",
            *("*".join(f"{100 * (v - _BASE_M):.1f}" for v in s.footprint_m) for s in made),
        ],
    ]
    shot = json.loads((_RESULTS / "dense_station.json").read_text())["0.7 m"]
    cells = [[name, s["points"], s["share_of_pixels_%"], s["robust_sigma_mm"], s["cpu_s"]] for name, s in shot.items()]
    return [
        _table("table 1 by `tiegraph plan`", ["", *(f"{100 * d:.0f} cm" for d in _DISTANCES_M)], rows),
        _table("a rendered shot at 70 cm (`benchmarks.dense.station`)",
               ["", "points", "% of the pixels", "sigma of a depth, mm", "CPU s"], cells),
    ]  # fmt: skip


_HERE = {"000": _paper000, "001": _paper001, "002": _paper002, "003": _paper003, "004": _paper004}
