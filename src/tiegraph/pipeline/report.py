"""Glue of report: receipts and artefacts become one page, and one file for programs."""

from tiegraph.errors import InputError
from tiegraph.pipeline.plan import PLAN, compare
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome
from tiegraph.report.formatting import Table
from tiegraph.report.html import write_report


def report(run: Run) -> Outcome:
    """One HTML page from receipts and artefacts, and from plan.json if the user put one into the run folder."""
    planned, notes = None, []
    if run.path(PLAN).is_file():
        try:
            found = compare(run.folder, None)
            planned = Table(found.columns, found.rows, (False, True, True, True), title=found.title)
            notes.append(f"planned and reached: {found.sentence}")
        except InputError as error:
            notes.append(str(error))
    path = write_report(run.folder, run.settings.report, planned)
    return Outcome({"bytes": path.stat().st_size}, notes=tuple(notes))
