"""The part of the report on which images tie to which: pictures in the order a reader asks, one sentence each."""

from typing import Any

from tiegraph.report import charts, formatting
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.texts import said, t
from tiegraph.report.thumbnails import file_uri
from tiegraph.report.warnings import FEW_TIES

STAGES = ("preview", "candidates", "coarse", "network", "design", "features", "match", "filter")
TITLES = {
    "candidates": "Candidates", "coarse": "Coarse model", "network": "Network", "design": "Design",
    "match": "Matching", "filter": "View-graph filtering",
}  # fmt: skip
# Pictures of the network folder in the order they are shown; the first word found in the file's name decides.
CAPTIONS = {
    "matrix": "Correspondence matrix: images by pass, camera and frame along both sides; the colour says why a pair "
    "was dropped.",
    "map": "The tie graph on the map, by kind of tie, before the design: every pair that is thought to share surface.",
    "design": "The ties that the design chose to match: thick bundles hold the survey together, a red line is a place "
    "that hangs on one link.",
    "covered": "How well the surface is covered, seen from above: cells by what is weak about them; the numbers are "
    "rows of the table of places to go to again.",
    "surface": "What the frames of two passes share: the dark ridge is where both see the same place, the red path "
    "follows it although speed and direction differ.",
    "offset": "Frame-offset curves: preview matches of two cameras against the frame offset between them. A clear peak "
    "is the offset the pair range is laid around; a flat curve means the two never see the same place.",
    "section": "What the upward camera sees along the way, and the bridge and open sections cut from it.",
    "funnel": "How many pairs of images each filter of the network left.",
}
_SECTION_LINKS = "Are neighbouring sections tied to each other? Two pairs without a common image are what holds them."
_WEAK_LINKS = "Weak links: places where the survey falls apart, or hangs on very little, if one tie or frame is lost."
_SOUND = "No weak links: no place hangs on a single tie or frame."


def network_part(run: RunFolder) -> dict[str, Any]:
    """Pictures, funnel, tables and remarks of the stages from preview to view-graph filtering."""
    out: dict[str, Any] = {"matrices": None, "funnel": None, "degrees": None, "table": None, "sound": None}
    pairs = run.pairs if run.pairs is not None else run.network
    if pairs is not None and run.scene is not None and len(pairs):
        before = run.network if run.network is not None else pairs
        out["matrices"] = [charts.looked_at(before, run.scene), charts.holding(pairs, run.scene)]
        rows = charts.funnel_rows(pairs, run.network)
        out["funnel"] = charts.funnel(rows)
        out["table"] = _funnel_table(rows, len(run.scene))
        out["degrees"] = charts.degrees(pairs, len(run.scene), FEW_TIES)
    notes = {stage: [str(n) for n in run.receipts.get(stage, {}).get("notes") or []] for stage in STAGES}
    out["model"] = [_sentence(n) for n in notes.pop("coarse")]
    out["notes"] = [(t(TITLES.get(s, s.capitalize())), lines) for s, lines in notes.items() if lines]
    out["pictures"] = _pictures(run, drawn=out["matrices"] is not None)
    out["links"], out["tables"] = [], []
    for stage in STAGES:
        _sort_tables(stage, run.receipts.get(stage, {}), out)
    parts = ("matrices", "pictures", "tables", "links", "notes")
    return {**out, "there": any(out[name] for name in parts)}


def _sort_tables(stage: str, receipt: dict, out: dict[str, Any]) -> None:
    """Section links and weak links to the front, with a sentence; the rest under the name of its stage."""
    found = receipt.get("tables")
    for name, data in (found if isinstance(found, dict) else {}).items():
        plain = str(name).replace("_", " ")
        if plain == "funnel":
            continue  # drawn and printed from the pair table, up to the verified pairs
        if plain == "weak links" and isinstance(data, dict) and not data.get("rows"):
            out["sound"] = t(_SOUND)
        title = t(TITLES.get(stage, stage.capitalize()))
        table = formatting.table(data, f"{title}: {said(plain)}", f"receipts.{stage}.{name}")
        if table is None:
            continue
        sentence = {"section links": _SECTION_LINKS, "weak links": _WEAK_LINKS}.get(plain)
        if sentence is None:
            out["tables"].append(table)
        else:
            out["links"].append(
                formatting.Table(columns=table.columns, rows=table.rows, numeric=table.numeric, title=t(sentence))
            )


def _pictures(run: RunFolder, drawn: bool) -> list[tuple[str, str]]:
    """(data URI, caption) of the pictures that the network stage and the design left."""
    found = []
    order = list(CAPTIONS)
    paths = sorted(p for folder in ("candidates", "network", "design") for p in (run.path / folder).glob("*.png"))
    for path in paths:
        title = path.stem.replace("curve", "offset")
        if path.parent.name == "design":
            title = {"surface": "covered"}.get(path.stem, "design")
        kind = next((k for k in order if k in title), "")
        if drawn and kind in ("matrix", "funnel"):
            continue  # drawn above, with what was verified beside it
        uri = file_uri(path)
        if uri:
            caption = t(CAPTIONS.get(kind, path.stem.replace("_", " ")))
            found.append((order.index(kind) if kind else len(order), uri, caption))
    return [(uri, caption) for _, uri, caption in sorted(found, key=lambda f: f[0])]


def _funnel_table(rows: list[tuple[str, int, str]], images: int) -> formatting.Table | None:
    every = images * (images - 1) / 2
    body = [
        [charts.step_name(name), value if charts.is_loss(name) else None, left, 100 * left / every if every else None]
        for (name, value, _), left in zip(rows, charts.pairs_left(rows))
    ]
    return formatting.table({"columns": ["step", "dropped", "pairs left", "% of all possible"], "rows": body})


def _sentence(note: str) -> str:
    text = note[:1].upper() + note[1:]
    return text if text.endswith((".", "!", "?")) else f"{text}."
