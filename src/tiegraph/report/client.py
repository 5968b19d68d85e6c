"""What the first page shows."""

from typing import Any

from tiegraph.report import accuracy, spatial
from tiegraph.report.client.deliverables import deliverables, sizes
from tiegraph.report.client.where import when, where
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.settings import ReportSettings
from tiegraph.report.summary import Verdict, what_was_done
from tiegraph.report.texts import said, t

PROBLEMS = 3


def client_page(
    run: RunFolder, settings: ReportSettings, seen: spatial.Scenery | None, verdict: Verdict
) -> dict[str, Any]:
    """The parts of the page, for the template."""
    about = settings.about
    fields = ((t("Client"), about.client), (t("Project"), about.project), (t("Equipment"), about.equipment))
    return {
        "fields": [*fields, (t("Surveyor"), about.surveyor)],
        "surveyor": about.surveyor,
        "what": what_was_done(run),
        "where": where(run, seen),
        "when": when(run),
        "map": spatial.survey_map(seen) if seen is not None else None,
        "north": seen is not None and seen.north,
        "answer": accuracy.answer(run.accuracy) if run.accuracy is not None else None,
        "layers": accuracy.layers(run.accuracy) if run.accuracy is not None else [],
        "held_by": accuracy.holding(run.accuracy) if run.accuracy is not None else "",
        "files": sizes(deliverables(run)),
        "problems": [text[:1].upper() + text[1:] for text in map(said, worst(verdict))],
    }


def worst(verdict: Verdict) -> list[str]:
    """The worst problems, the worst first: contradictions come before warnings, which are ranked already; [] if the
    run found nothing wrong."""
    return [*verdict.contradictions, *verdict.warnings][:PROBLEMS]
