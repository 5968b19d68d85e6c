"""`tiegraph network OUT` (the stage) and `tiegraph network --coverage IMAGES|OUT` (is anything missing, on site)."""

from __future__ import annotations

import json
import sys

from rich.console import Console
from rich.table import Table

from tiegraph.api import Project, open_project
from tiegraph.cli import run

_ROWS = 20  # weak links shown; the report has all


def main(arguments: list[str]) -> int:
    """The stage for a run folder; with ``--coverage`` also what is weak: exit code 1 if anything is."""
    if "--coverage" not in arguments:
        return run.main_stage("network", arguments)
    rest = [a for a in arguments if a != "--coverage"]
    known = run.preparsed(rest)
    if known.folder is None:
        return run.main_stage("network", rest)
    if (known.folder / "scene.json").exists():
        run.main_stage("network", rest)
        return _show(open_project(None, known.folder), "--json" in rest)
    run.main([*rest, "--until", "network"])
    return _show(open_project(known.folder, known.out), "--json" in rest)


def _show(project: Project, as_json: bool) -> int:
    found = project.coverage()
    if as_json:
        sys.stdout.write(json.dumps({"sound": found.sound, **found.counts, "weak_links": found.table}) + "\n")
        return 0 if found.sound else 1
    console = Console(highlight=False)
    for line in found.lines:
        console.print(line)
    rows = found.table["rows"]
    if rows:
        table = Table(*found.table["columns"], title="weak links", box=None, title_justify="left")
        for row in rows[:_ROWS]:
            table.add_row(*(str(v) for v in row))
        console.print(table)
    if len(rows) > _ROWS:
        console.print(f"... and {len(rows) - _ROWS} more: the report has all")
    return 0 if found.sound else 1
