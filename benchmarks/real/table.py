"""The ladder as a Markdown table: a row a set, tiegraph beside the others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.real.sets import Survey
from benchmarks.table import line, put

_SHOWN = {
    "in the largest model": ("largest", "{:.0f}"),
    "points": ("points", "{:.0f}"),
    "verified pairs": ("pairs.verified", "{:.0f}"),
    "inliers": ("pairs.inliers", "{:.0f}"),
    "error": ("error", "{:.2g}"),
    "CPU s": ("cpu_s", "{:.0f}"),
    "wall s": ("wall_s", "{:.0f}"),
    "peak MiB": ("peak_mib", "{:.0f}"),
}
DOCUMENT = Path(__file__).with_name("README.md")
MARKERS = (
    ("<!-- sets: python -m benchmarks.real --write -->", "<!-- end of sets -->"),
    ("<!-- figures: python -m benchmarks.real --write -->", "<!-- end of figures -->"),
)
_COMPETITORS = ("tiegraph", "colmap", "openmvg")


def table(results: dict[str, Any], surveys: Sequence[Survey]) -> str:
    """What is measured of each set: tiegraph / COLMAP / openMVG, then tiegraph's share of COLMAP's in brackets."""
    head = ["set", "images", *_SHOWN, "not done"]
    lines = [line(head), line(["---"] * len(head))]
    for survey in surveys:
        rows = [r for r in results["runs"] if r["set"] == survey.name]
        runs = [next((r for r in rows if r["competitor"].startswith(c)), None) for c in _COMPETITORS]
        if any(runs):
            cells = [_cell(runs, *asked) for asked in _SHOWN.values()]
            lines.append(line([f"`{survey.name}`", survey.count, *cells, _not_done(runs)]))
    machine = ", ".join(f"{key} {value}" for key, value in results["machine"].items())
    return "\n".join([f"Machine: {machine}. tiegraph / COLMAP / openMVG (tiegraph over COLMAP).", "", *lines])


def sources(surveys: Sequence[Survey]) -> str:
    """Where the sets are from."""
    head = ["set", "images", "size", "camera", "kind", "source", "licence", "compared with"]
    lines = [line(head), line(["---"] * len(head))]
    for s in surveys:
        known = {"exif": "positions in EXIF", "": "control points" if s.gcp else "-"}.get(s.truth, "published poses")
        link = f"[{s.repository}](https://github.com/{s.repository}) `{s.images}`"
        count = f"{s.count}" + (f" (below {s.below_mib:g} MiB)" if s.below_mib < float("inf") else "")
        lines.append(line([f"`{s.name}`", count, "{} x {}".format(*s.size), s.camera, s.kind, link, s.licence, known]))
    return "\n".join(lines)


def write(figures: str, surveys: Sequence[Survey], path: Path = DOCUMENT) -> None:
    """Put both tables between their markers in README.md."""
    for (begin, end), new in zip(MARKERS, (sources(surveys), figures)):
        put(path, begin, end, new)


def error_m(row: dict[str, Any]) -> float | None:
    """RMSE after a similarity, in the unit of what is known: of cameras, else of control points; None if unknown."""
    return row.get("ate_m") if row.get("ate_m") is not None else row.get("marks", {}).get("rmse_m")


def _value(row: dict[str, Any] | None, key: str) -> float | None:
    if row is None:
        return None
    if key == "error":
        return error_m(row)
    head, _, tail = key.partition(".")
    return row.get(head, {}).get(tail) if tail else row.get(head)


def _cell(runs: Sequence[dict[str, Any] | None], key: str, form: str) -> str:
    values = [_value(row, key) for row in runs]
    if all(v is None for v in values):
        return "-"
    text = " / ".join("-" if v is None else form.format(v) for v in values)
    ours, theirs = values[:2]
    return f"{text} ({ours / theirs:.2f})" if ours is not None and theirs else text


def _not_done(runs: Sequence[dict[str, Any] | None]) -> str:
    return "; ".join(f"{r['competitor']}: {r.get('reason', r['status'])}" for r in runs if r and r["status"] != "done")
