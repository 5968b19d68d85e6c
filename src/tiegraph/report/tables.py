"""Tables, facts and remarks of receipts for the page, each number marked with where it stands in its receipt."""

from __future__ import annotations

from tiegraph.report import formatting
from tiegraph.report.contradictions import EVIDENCE
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.texts import said


def receipt_tables(run: RunFolder, *stages: str) -> list[formatting.Table]:
    """The tables of stages, but those that are drawn or have a place of their own."""
    out = []
    for stage in stages:
        found = run.receipts.get(stage, {}).get("tables")
        # the funnel is drawn and printed from the pair table, up to the verified pairs
        for name, data in found.items() if isinstance(found, dict) else ():
            if name not in (EVIDENCE, "funnel"):
                title = said(name.replace("_", " "))
                table = formatting.table(data, title[:1].upper() + title[1:], f"receipts.{stage}.{name}")
                out += [table] if table is not None else []
    return out


def receipt_notes(run: RunFolder, *stages: str) -> list[str]:
    """The remarks of stages, each once, as the stages wrote them."""
    every = (str(n) for stage in stages for n in run.receipts.get(stage, {}).get("notes") or [])
    return list(dict.fromkeys(every))
