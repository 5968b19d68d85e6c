"""Which figures of README, docs and reports no longer hold: ``python -m benchmarks.check``.

Each figure has the command that makes it. The cheap ones are made again here: tables written from results, what the
planner says, and (``--runs``, a few minutes) the example by tiegraph and by the papers' recipes up to the world,
against their rows in ``results/papers.json``; results repeat bit by bit, so that a figure that differs by more than its
last digit was changed by the code. Of the dear ones the command is printed. 1 if any does not hold.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks import bands, lidar, table
from benchmarks.papers import measure, scenes
from benchmarks.papers.tables import planned

_ROOT = Path(__file__).resolve().parents[1]
_RESULTS = _ROOT / "benchmarks" / "results"
RECIPES = ("tiegraph", "meguro2024", "meguro2025")
_FIGURES = {"registered": 0.0, "in_world": 0.0, "ate_m": 0.01, "world_ate_m": 0.01}  # largest relative difference


@dataclass(frozen=True)
class Figure:
    """What stands where, the command that makes it, what it says there and what it is now."""

    where: str
    command: str
    stated: str
    now: str

    @property
    def holds(self) -> bool:
        """Whether both are the same."""
        return self.stated == self.now


def _between(path: Path, begin: str, end: str) -> str:
    return path.read_text().partition(begin)[2].partition(end)[0].strip()


def written() -> Iterator[Figure]:
    """The tables that are written from results."""
    for name, shown in table._DOCUMENTS.items():
        stated = _between(_ROOT / name, table.BEGIN, table.END)
        yield Figure(name, "python -m benchmarks.table --write", stated, table.figures(*shown))
    rows, sigma = (json.loads((_RESULTS / f"{n}.json").read_text())["rows"] for n in ("bands", "sigma"))
    stated = _between(bands._DOCUMENT, bands.BEGIN, bands.END)
    yield Figure("docs/benchmarks.md, bands", "python -m benchmarks.bands --write", stated, bands.table(rows, sigma))
    made = lidar.tables(json.loads((_RESULTS / "lidar.json").read_text())["rows"])
    stated = _between(lidar._DOCUMENT, lidar.BEGIN, lidar.END)
    yield Figure("docs/lidar.md", "python -m benchmarks.lidar --write", stated, made)


def planner() -> Iterator[Figure]:
    """Table 1 of paper 004 as docs/benchmarks.md has it."""
    text = (_ROOT / "docs" / "benchmarks.md").read_text()
    found = re.search(r"is what `tiegraph plan` says \((.*?) mm; (.*?) px/mm²", text)
    made = planned()
    now = "; ".join((", ".join(f"{1000 * s.precision_m[0]:.3f}" for s in made),
                     ", ".join(f"{s.points_mm2:.1f}" for s in made)))  # fmt: skip
    stated = "; ".join(found.groups()) if found else "not there"
    yield Figure("docs/benchmarks.md, paper 004", "python -m benchmarks.papers 004", stated, now)


def runs(work: Path) -> Iterator[Figure]:
    """The example by tiegraph and the recipes, against their rows."""
    rows = {(r["set"], r["method"]): r for r in measure.results()["runs"] if r["seed"] == 0}
    dataset = scenes.load("canal_demo", work / "inputs")
    for name in RECIPES:
        row = measure.one_run(dataset, measure._TO_WORLD[name], work / name)
        stated = rows.get(("canal_demo", name), {})
        command = f"python -m benchmarks.papers --run --work DIR  # canal_demo, {name}"
        for figure, most in _FIGURES.items():
            before, after = stated.get(figure), row.get(figure)
            same = before is not None and after is not None and abs(after - before) <= most * abs(before)
            shown = str(before), str(before if same else after)
            yield Figure(f"results/papers.json, canal_demo {name} {figure}", command, *shown)


def main(argv: list[str] | None = None) -> int:
    """Print what does not hold, and how many do."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", action="store_true", help="the example too (needs TIEGRAPH_DATA)")
    parser.add_argument("--work", type=Path, help="folder of the runs (default: a temporary one)")
    args = parser.parse_args(argv)
    parts: list[Callable[[], Iterator[Figure]]] = [written, planner]
    with tempfile.TemporaryDirectory(prefix="tiegraph-check-") as folder:
        if args.runs:
            parts.append(lambda: runs(args.work or Path(folder)))
        figures = [figure for part in parts for figure in part()]
    for figure in (f for f in figures if not f.holds):
        sys.stdout.write(f"{figure.where} no longer holds ({figure.command}):\n{_difference(figure)}\n")
    lost = sum(not f.holds for f in figures)
    sys.stdout.write(
        f"{len(figures) - lost} of {len(figures)} figures hold; the others' commands: benchmarks/README.md\n"
    )
    return 1 if lost else 0


def _difference(figure: Figure) -> str:
    stated, now = figure.stated.splitlines(), figure.now.splitlines()
    gone, new = ([line for line in a if line not in b] for a, b in ((stated, now), (now, stated)))
    return "\n".join([*(f"- {line}" for line in gone), *(f"+ {line}" for line in new)])


if __name__ == "__main__":
    sys.exit(main())
