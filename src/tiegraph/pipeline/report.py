"""Glue of report: receipts and artefacts become one page."""

from __future__ import annotations

from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome
from tiegraph.report.html import write_report


def report(run: Run) -> Outcome:
    """One HTML page from receipts and artefacts."""
    path = write_report(run.folder, run.settings.report)
    return Outcome({"bytes": path.stat().st_size})
