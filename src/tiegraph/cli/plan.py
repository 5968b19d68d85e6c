"""`tiegraph plan`: what a survey will give, before it is taken."""

import json as json_text
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say, show_table
from tiegraph.pipeline.plan import compare
from tiegraph.pipeline.plan import plan as make_plan
from tiegraph.plan.planner import path_tables, station_table
from tiegraph.plan.request import PlanRequest
from tiegraph.project.verbtunings import read_tunings

_DEFAULT = PlanRequest()


def main(arguments: list[str]) -> int:
    """`tiegraph plan`."""

    def plan(
        request: Annotated[PlanRequest, tyro.conf.arg(name=""), tyro.conf.OmitArgPrefixes] = _DEFAULT,
        tuning: Path | None = None,
        json: bool = False,
    ) -> tuple[PlanRequest, Path | None, bool]:
        """What images at given distances give, and what a whole path is expected to give, before anyone goes there.

        Args:
            tuning: A file with other constants: tables [tuning.plan], [tuning.scan] and [tuning.sfm].
            json: One JSON object on standard output instead of tables.
        """
        return request, tuning, json

    request, tuning, json = options_of(plan, "tiegraph plan", arguments)
    if request.output.compare is not None:
        return _compare(request.output.compare, request.output.planned, json)
    made = make_plan(request, read_tunings(tuning))
    if json:
        say(json_text.dumps(made.to_dict(), indent=1))
        return 0
    tables = [station_table(made.stations)]
    if made.path is not None and made.effort is not None:
        tables += path_tables(made.path, made.effort)
    for table in tables:
        show_table(table.columns, table.rows, table.title)
    for text in (*(made.path.worst if made.path else ()), *made.advice):
        say(text)
    if request.output.out is not None:
        say(f"written: {request.output.out}")
    return 0


def _compare(run: Path, planned: Path | None, json: bool) -> int:
    table = compare(run, planned)
    if json:
        say(json_text.dumps({"columns": table.columns, "rows": table.rows, "sentence": table.sentence}, indent=1))
    else:
        show_table(table.columns, table.rows, table.title)
        say(table.sentence)
    return 0
