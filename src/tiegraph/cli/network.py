"""`tiegraph network OUT` (the stage) and `tiegraph network --coverage IMAGES|OUT` (is anything missing, on site)."""

import json
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from tiegraph.api import Project, open_project
from tiegraph.cli import run
from tiegraph.cli.output import say, show_table
from tiegraph.design.coverage import Coverage

_ROWS = 20  # weak links shown; the report has all


@dataclass(frozen=True)
class _Options(run.Common):
    coverage: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False  # main takes it
    """Say what the tie graph leaves weak, on site: images without ties, what hangs on a single tie, which camera, pass
    or section is tied to the others by fewer than two; of all candidate pairs and of those that the design chose; exit
    code 1 if anything is. And how the surface is covered: by how many images, from which angles, how precisely. A
    folder of images instead of OUT is run up to the design first, with the options of `tiegraph run`."""


def main(arguments: list[str]) -> int:
    """The stage for a run folder; with ``--coverage`` also what is weak: exit code 1 if anything is."""
    if "--coverage" not in arguments:
        return run.main_stage("network", arguments, _Options)
    rest = [a for a in arguments if a != "--coverage"]
    folder, known = run.preparsed(rest)
    if folder is None:
        return run.main_stage("network", rest, _Options)
    if (folder / "scene.json").exists():
        run.main_stage("design", rest)
        return _show(open_project(None, folder), "--json" in rest)
    run.main([*rest, "--until", "design"])
    return _show(open_project(folder, known.out), "--json" in rest)


def _show(project: Project, as_json: bool) -> int:
    found, chosen, surface = project.coverage(), project.coverage(chosen=True), project.surface()
    sound = found.sound and chosen.sound
    if as_json:
        covered = None if surface is None else {**surface.cells.shares(), "places": surface.table()}
        say(json.dumps({**_told(found), "sound": sound, "chosen": _told(chosen), "surface": covered}))
        return 0 if sound else 1
    _show_one("candidate pairs", found)
    _show_one("pairs that the design chose", chosen)
    if surface is not None:
        for line in surface.lines():
            say(line)
        table = surface.table()
        if table["rows"]:
            show_table(table["columns"], table["rows"][:_ROWS], "where to go again")
    return 0 if sound else 1


def _told(found: Coverage) -> dict[str, Any]:
    return {"sound": found.sound, **found.counts, "weak_links": found.table}


def _show_one(what: str, found: Coverage) -> None:
    for line in found.lines:
        say(f"{what}: {line}")
    rows = found.table["rows"]
    if rows:
        show_table(found.table["columns"], rows[:_ROWS], f"weak links of the {what}")
    if len(rows) > _ROWS:
        say(f"... and {len(rows) - _ROWS} more: the report has all")
