"""Tables, facts and remarks of receipts for the page, each number marked with where it stands in its receipt."""

import re
from textwrap import shorten
from typing import Any

from tiegraph.report import formatting
from tiegraph.report.runfolder import STAGES, RunFolder
from tiegraph.report.texts import said, t
from tiegraph.scene.evidence import figures

EVIDENCE = "evidence"  # the table that has a section of its own
_COLUMNS = 7
_HEAD, _HEADS = 70, 3  # letters and number of contradictions in the headline


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


def contradictions(run: RunFolder) -> tuple[str, ...]:
    """What contradicts what, of every stage that has finished."""
    every = (str(c) for stage in STAGES for c in run.receipts.get(stage, {}).get("contradictions") or [])
    return tuple(dict.fromkeys(every))


def about(found: tuple[str, ...]) -> str:
    """What contradictions are about, for a headline: the words before their first colon that is none of a camera's name
    ("1: SONY DSC-H300") or figure; "" if none."""
    heads = dict.fromkeys(
        said(shorten(re.split(r"(?<!\d):| differ by", text)[0], _HEAD, placeholder=" ...")) for text in found
    )
    short = list(heads)[:_HEADS]
    return "; ".join(short) + (t(" and {} more", len(heads) - len(short)) if len(heads) > len(short) else "")


def _said(value: object) -> object:
    return said(value) if isinstance(value, str) else value


def evidence_table(run: RunFolder) -> formatting.Table | None:
    """The statements of all stages, those of one quantity one below the other; None without any."""
    found = {s: (run.receipts.get(s, {}).get("tables") or {}).get(EVIDENCE) for s in STAGES}
    parts = {s: d for s, d in found.items() if isinstance(d, dict) and len(d.get("columns") or []) == _COLUMNS}
    rows = []
    for stage, data in parts.items():
        for k, row in enumerate(data.get("rows") or []):
            key = f"receipts.{stage}.{EVIDENCE}.{k}"
            value = formatting.marked(f"{key}.2", figures(row[2], row[3]))
            sigma = formatting.marked(f"{key}.3", formatting.number(row[3], 2))
            named = [said(str(name)) for name in row[:2]]
            rows.append([*named, value, sigma, *map(_said, row[4:])])
    order = {q: k for k, q in enumerate(dict.fromkeys(r[0] for r in rows))}
    rows.sort(key=lambda r: order[r[0]])
    return formatting.table({"columns": next(iter(parts.values()))["columns"], "rows": rows}) if rows else None
