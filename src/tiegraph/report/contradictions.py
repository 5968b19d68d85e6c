"""What contradicts what, over all stages, and the table of what says what."""

from textwrap import shorten

from tiegraph.report import formatting
from tiegraph.report.runfolder import STAGES, RunFolder
from tiegraph.report.texts import said, t
from tiegraph.scene.evidence import figures

EVIDENCE = "evidence"  # the table that has a section of its own
_COLUMNS = 7
_HEAD, _HEADS = 70, 3  # letters and number of contradictions in the headline


def contradictions(run: RunFolder) -> tuple[str, ...]:
    """What contradicts what, of every stage that has finished."""
    every = (str(c) for stage in STAGES for c in run.receipts.get(stage, {}).get("contradictions") or [])
    return tuple(dict.fromkeys(every))


def about(found: tuple[str, ...]) -> str:
    """What contradictions are about, for a headline: the words before their first colon or figure; "" if none."""
    heads = dict.fromkeys(
        said(shorten(text.split(":")[0].split(" differ by")[0], _HEAD, placeholder=" ...")) for text in found
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
