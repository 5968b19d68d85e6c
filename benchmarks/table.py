"""Results as a markdown table, with ratios against one competitor: ``python benchmarks/table.py results/x.json``."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from statistics import median
from typing import Any

COLUMNS = (
    "competitor", "status", "CPU s", "ratio", "wall s", "ratio", "pairs matched", "verified", "registered",
    "largest model", "models", "points", "reproj. px", "ATE m", "ratio", "median of all m", "within 0.3 m",
)  # fmt: skip


def markdown(results: dict[str, Any], against: str, stages: bool = True) -> str:
    """One table a data set (median over the repeats), ratios = value / value of ``against`` in the same file."""
    blocks = []
    for name in dict.fromkeys(row["set"] for row in results["runs"]):
        groups = _groups([row for row in results["runs"] if row["set"] == name])
        base = next((rows for (competitor, _), rows in groups.items() if competitor == against), None)
        lines = [f"### {name}", "", line(COLUMNS), line(["---"] * len(COLUMNS))]
        lines += [line(_cells(label, rows, base)) for label, rows in groups.items()]
        blocks.append("\n".join(lines))
        if stages:
            blocks.append(_stage_table(groups))
    machine = ", ".join(f"{key} {value}" for key, value in results["machine"].items())
    head = f"Machine: {machine}. {results.get('note', '')} Ratios against `{against}`; medians over repeats."
    return "\n\n".join([head, *blocks])


def _groups(rows: list[dict[str, Any]]) -> dict[tuple[str, str], list[dict[str, Any]]]:
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["competitor"], row["calibration"]), []).append(row)
    return groups


def _cells(label: tuple[str, str], rows: list[dict[str, Any]], base: list[dict[str, Any]] | None) -> list[str]:
    def value(key: str, of: list[dict[str, Any]] | None = rows) -> float | None:
        found = [v for v in (_get(row, key) for row in of or []) if v is not None]
        return median(found) if found else None

    def ratio(key: str) -> str:
        ours, theirs = value(key), value(key, base)
        return "" if ours is None or not theirs else f"{ours / theirs:.2f}"

    name = label[0] + (" (calibrated)" if label[1] == "given" and not label[0].startswith("tiegraph") else "")
    status = ", ".join(dict.fromkeys(row["status"] for row in rows))
    return [
        name, status, _text(value("cpu_s"), 0), ratio("cpu_s"), _text(value("wall_s"), 0), ratio("wall_s"),
        _text(value("pairs.matched"), 0), _text(value("pairs.verified"), 0),
        f"{_text(value('registered'), 0)}/{_text(value('images'), 0)}", _text(value("largest"), 0),
        _text(value("components"), 0),
        _text(value("points"), 0), _text(value("reprojection_px"), 3), _text(value("ate_m"), 3), ratio("ate_m"),
        _text(value("robust.median_of_all_m"), 3), _share(value("robust.within_m.0.3")),
    ]  # fmt: skip


def _get(row: dict[str, Any], key: str) -> float | None:
    """Nested value by dotted key; a key may itself hold a dot (0.3), so the rest is tried whole first."""
    if key in row:
        return row[key]
    head, _, tail = key.partition(".")
    return _get(row[head], tail) if tail and isinstance(row.get(head), dict) else None


def _stage_table(groups: dict[tuple[str, str], list[dict[str, Any]]]) -> str:
    names = list(dict.fromkeys(s["stage"] for rows in groups.values() for row in rows for s in row.get("stages", [])))
    lines = [line(["CPU s / wall s", *names]), line(["---"] * (len(names) + 1))]
    for (competitor, _), rows in groups.items():
        cells = []
        for name in names:
            found = [s for row in rows for s in row.get("stages", []) if s["stage"] == name]
            pair = [median(s[key] for s in found) for key in ("cpu_s", "wall_s")] if found else []
            cells.append(" / ".join(_text(v, 1) for v in pair))
        lines.append(line([competitor, *cells]))
    return "\n".join(lines)


def line(cells: Any) -> str:
    """A row of a markdown table."""
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def main(argv: list[str] | None = None) -> int:
    """Print the table of one or more result files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--against", default="colmap_exhaustive")
    parser.add_argument("--no-stages", action="store_true")
    args = parser.parse_args(argv)
    for path in args.files:
        sys.stdout.write(markdown(json.loads(path.read_text()), args.against, not args.no_stages) + "\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
