"""Results as a markdown table, with ratios against one competitor: ``python -m benchmarks.table results/x.json``.

``python -m benchmarks.table --write`` puts the table of figures between its markers in README.md, docs/benchmarks.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

COLUMNS = (
    "competitor", "status", "CPU s", "ratio", "wall s", "ratio", "pairs matched", "verified", "registered",
    "largest model", "models", "points", "reproj. px", "ATE m", "ratio", "median of all m", "within 0.3 m",
)  # fmt: skip


_ROOT = Path(__file__).resolve().parents[1]
_FILES = ("small_sets", "large_sets", "real")
BEGIN, END = "<!-- python -m benchmarks.table --write -->", "<!-- end of the table -->"
_SHOWN = (
    ("canal_demo", "`canal_demo` (the example): boat, 6 cameras, out and back"),
    ("canal", "`canal`: the same, longer, two bridge passages"),
    ("Herz-Jesus-P25", "Strecha Herz-Jesus-P25"),
    ("brighton", "a drone over a beach, 8 megapixels (the truth is its EXIF GPS)"),
    ("monstree", "a tree by telephone, 12 megapixels (likewise)"),
)
"""Of five seeds."""
_MORE = (
    ("pandaset", "PandaSet: car, 6 cameras, calibrated rig"),
    ("kitti_stereo", "KITTI: stereo, calibrated"),
    ("park_gate", "a gate by DSLR, 2.5 megapixels"),
    ("fountain-P11", "Strecha fountain-P11"),
    ("Herz-Jesus-P8", "Strecha Herz-Jesus-P8"),
    ("copr", "a kite, 12 megapixels"),
    ("oppaiyama", "Oppaiyama: phone photographs with EXIF GPS (the truth is that GPS)"),
)
_OTHERS = (
    ("colmap_sequential", "COLMAP sequential, defaults"),
    ("colmap_rig", "COLMAP exhaustive with the rig"),
    ("openmvg", "openMVG"),
)
_DOCUMENTS = {"README.md": (_SHOWN, ()), "docs/benchmarks.md": ((*_SHOWN, *_MORE), _OTHERS)}


def figures(sets: Sequence[tuple[str, str]], others: Sequence[tuple[str, str]] = ()) -> str:
    """The table of figures: a row a set; tiegraph, exhaustive COLMAP with its defaults, and ``others``."""
    rows = [r for f in _FILES for r in json.loads((_ROOT / "benchmarks" / "results" / f"{f}.json").read_text())["runs"]]
    competitors = (("tiegraph", "tiegraph"), ("colmap_exhaustive", "COLMAP exhaustive, defaults"), *others)
    head = ["images", *(f"{title}: in its largest model, ATE, CPU s" if k == 0 else title
                        for k, (_, title) in enumerate(competitors))]  # fmt: skip
    lines = [line(head), line(["---"] * len(head))]
    for name, title in sets:
        mine = [r for r in rows if r["set"] == name]
        cells = [_figure([r for r in mine if r["competitor"] == c]) for c, _ in competitors]
        lines.append(line([f"{title}, {mine[0]['images']}", *cells]))
    return "\n".join(lines)


def _figure(rows: Sequence[dict[str, Any]]) -> str:
    """A competitor on a set; that it was given the calibration is said, of tiegraph it goes without saying. Of several
    seeds the medians, with the least and the most."""
    said = []
    for given in ("estimated", "given"):
        own = sorted((r for r in rows if r["calibration"] == given), key=lambda r: r["repeat"])
        row = dict(own[0]) if own else None
        if row is None:
            continue
        spread = {n: [r[n] for r in own if r[n] is not None] for n in ("largest", "ate_m", "cpu_s")}
        row |= {n: median(values) for n, values in spread.items() if values}
        word = "calibrated: " if given == "given" and row["competitor"] != "tiegraph" else ""
        more = f" of {row['registered']} in {row['components']} models" if row["registered"] > row["largest"] else ""
        more = f" + {row['placed_by_rig']} by the rig" if row.get("placed_by_rig") else more
        shown = {n: tuple(_PRINTED[n](v) for v in (row[n], *_ends(spread[n]))) for n in spread if row[n] is not None}
        images, *ends = shown["largest"]
        known = f" {_ranged(*shown['ate_m'])}," if "ate_m" in shown else ""
        error = known if row["largest"] else " no model,"
        said.append(f"{word}{_ranged(images + more, *ends)},{error} {_ranged(*shown['cpu_s'])} s")
    return "; ".join(said) or "not run"


def _ends(values: Sequence[float]) -> tuple[float, float]:
    return min(values), max(values)


def _ranged(value: str, least: str, most: str) -> str:
    return value if least == most else f"{value} ({least} to {most})"


def _metres(value: float) -> str:
    return f"{1000 * value:.0f} mm" if value < 0.1 else f"{value:.2g} m"


_PRINTED = {"largest": lambda v: f"{v:.0f}", "ate_m": _metres, "cpu_s": lambda v: f"{v:.0f}"}


def write(root: Path = _ROOT) -> None:
    """Put the table of figures between its markers in the documents."""
    for name, (sets, others) in _DOCUMENTS.items():
        put(root / name, BEGIN, END, figures(sets, others))


def put(document: Path, begin: str, end: str, text: str) -> None:
    """Write a text between two markers of a document."""
    before, _, rest = document.read_text().partition(begin)
    document.write_text(f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}")


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
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--write", action="store_true", help="the table of figures into README.md, docs/benchmarks.md")
    parser.add_argument("--against", default="colmap_exhaustive")
    parser.add_argument("--no-stages", action="store_true")
    args = parser.parse_args(argv)
    if args.write:
        write()
    for path in args.files:
        sys.stdout.write(markdown(json.loads(path.read_text()), args.against, not args.no_stages) + "\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
