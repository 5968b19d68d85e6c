"""Tables, facts and remarks of receipts for the page, each number marked with its place in its receipt."""

import re
from textwrap import shorten
from typing import Any

from tiegraph.report import formatting
from tiegraph.report.runfolder import STAGES, RunFolder
from tiegraph.report.texts import capital, said, t
from tiegraph.scene.evidence import figures

EVIDENCE = "evidence"  # the table that has a section of its own
_COLUMNS = 7  # of that table
_HEAD, _HEADS = 70, 3  # letters and number of contradictions in the headline


def receipt_tables(run: RunFolder, *stages: str) -> list[formatting.Table]:
    """The tables of stages, except those shown elsewhere; the funnel is drawn from the pair table."""
    found = (
        formatting.table(data, capital(said(name.replace("_", " "))), f"receipts.{stage}.{name}")
        for stage in stages
        for name, data in run.tables(stage).items()
        if name not in (EVIDENCE, "funnel")
    )
    return [table for table in found if table is not None]


def section_name(run: RunFolder, number: int) -> str:
    """The name of a section in words, "bridge 1"; its number if the run does not name it."""
    told = next((n for n in run.notes("network") if n.startswith("sections: ")), "")
    names = re.findall(r"(\w+ \d+) \(\d+ frames?\)", told)
    if 0 <= number < len(names):
        return said(names[number]).replace(" ", "\N{NO-BREAK SPACE}")
    return t("(none)") if number < 0 else str(number)


def with_section_names(run: RunFolder, data: Any) -> Any:
    """A table whose first column numbers sections, with their names; any other unchanged."""
    if not isinstance(data, dict) or (data.get("columns") or [""])[0] != "section":
        return data
    rows = [[section_name(run, int(row[0])) if str(row[0]).isdigit() else row[0], *row[1:]] for row in data["rows"]]
    return {**data, "rows": rows}


def contradictions(run: RunFolder) -> tuple[str, ...]:
    """The contradictions of every finished stage."""
    every = (str(c) for stage in STAGES for c in run.receipts.get(stage, {}).get("contradictions") or [])
    return tuple(dict.fromkeys(every))


def about(found: tuple[str, ...]) -> str:
    """Subjects of contradictions, for a headline: the words before their first colon that is not part of a camera's
    name ("1: SONY DSC-H300") or figure; "" if none."""
    firsts = (re.split(r"(?<!\d):| differ by", text)[0] for text in found)
    heads = list(dict.fromkeys(said(shorten(first, _HEAD, placeholder=" ...")) for first in firsts))
    return "; ".join(heads[:_HEADS]) + (t(" and {} more", len(heads) - _HEADS) if len(heads) > _HEADS else "")


def evidence_table(run: RunFolder) -> formatting.Table | None:
    """The statements of all stages, those of one quantity one below the other; None without any."""
    rows, columns = [], None
    for stage in STAGES:
        data = run.tables(stage).get(EVIDENCE)
        if not isinstance(data, dict) or len(data.get("columns") or []) != _COLUMNS:
            continue
        columns = data["columns"]
        for k, row in enumerate(data.get("rows") or []):
            key = f"receipts.{stage}.{EVIDENCE}.{k}"
            value = formatting.marked(f"{key}.2", figures(row[2], row[3]))
            sigma = formatting.marked(f"{key}.3", formatting.number(row[3], 2))
            rest = [said(cell) if isinstance(cell, str) else cell for cell in row[4:]]
            rows.append([said(str(row[0])), said(str(row[1])), value, sigma, *rest])
    order = {q: k for k, q in enumerate(dict.fromkeys(r[0] for r in rows))}
    rows.sort(key=lambda r: order[r[0]])
    return formatting.table({"columns": columns, "rows": rows})
