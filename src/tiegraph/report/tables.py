"""Tables, facts and remarks of receipts for the page, each number marked with where it stands in its receipt."""

import re
from typing import Any

from tiegraph.report import formatting
from tiegraph.report.contradictions import EVIDENCE
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.texts import said, t


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


def section_name(run: RunFolder, number: int) -> str:
    """The name of a section in words, "bridge 1"; its number where the run does not name it."""
    notes = run.receipts.get("network", {}).get("notes") or []
    found = next((str(n) for n in notes if str(n).startswith("sections: ")), "")
    names = re.findall(r"(\w+ \d+) \(\d+ frames?\)", found)
    if 0 <= number < len(names):
        return said(names[number]).replace(" ", "\N{NO-BREAK SPACE}")
    return t("(none)") if number < 0 else str(number)


def with_section_names(run: RunFolder, data: Any) -> Any:
    """A table whose first column numbers sections, with their names; anything else as it is."""
    if not isinstance(data, dict) or (data.get("columns") or [""])[0] != "section":
        return data
    return {**data, "rows": [[_named(run, row[0]), *row[1:]] for row in data["rows"]]}


def _named(run: RunFolder, value: object) -> object:
    return section_name(run, int(str(value))) if str(value).isdigit() else value
