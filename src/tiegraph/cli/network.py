"""`tiegraph network OUT` (the stage) and `tiegraph network --coverage IMAGES|OUT` (is anything missing, on site)."""

from __future__ import annotations

import json

from tiegraph.api import Project, open_project
from tiegraph.cli import run
from tiegraph.cli.output import say, show_table

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
        say(json.dumps({"sound": found.sound, **found.counts, "weak_links": found.table}))
        return 0 if found.sound else 1
    for line in found.lines:
        say(line)
    rows = found.table["rows"]
    if rows:
        show_table(found.table["columns"], rows[:_ROWS], "weak links")
    if len(rows) > _ROWS:
        say(f"... and {len(rows) - _ROWS} more: the report has all")
    return 0 if found.sound else 1
