"""The part of the report on what a run took: time and memory, settings, versions."""

from pathlib import Path
from typing import Any

from markupsafe import Markup

from tiegraph.report import formatting, summary
from tiegraph.report.runfolder import STAGES, RunFolder
from tiegraph.report.svg.charts import LIGHT, SOFT, USED, bars
from tiegraph.report.texts import said, t


def effort(run: RunFolder) -> dict[str, Any]:
    """Charts and table of the stages, settings of each, versions."""
    rows = summary.stage_rows(run)
    body = []
    for stage, wall, cpu, peak in rows:
        counts = run.counts(stage)
        whole = {k: v for k, v in counts.items() if isinstance(v, int)}  # what is no number of things stands elsewhere
        text = t(", ").join(_counted(v, str(k).replace("_", " ")) for k, v in whole.items())
        body.append((stage, formatting.seconds(wall), formatting.seconds(cpu), formatting.count(peak), text))
    columns = (t("stage"), t("wall time"), t("CPU time"), t("peak MiB"), t("counts"))
    table = formatting.Table(columns, tuple(body), (False, True, True, True, False)) if body else None
    receipts = {s: run.receipts[s] for s in STAGES if run.receipts.get(s, {}).get("settings")}
    settings = [(s, {**r["settings"], **_flat("tuning", r.get("tuning") or {})}) for s, r in receipts.items()]
    software: dict[str, str] = {}
    for s in STAGES:
        software.update(run.receipts.get(s, {}).get("software") or {})
    return {
        "charts": _charts(rows) if rows else [],
        "table": table,
        "settings": [(s, [(k, formatting.cell(_named(v))) for k, v in values.items()]) for s, values in settings],
        "software": sorted(software.items()),
    }


def _counted(amount: int, things: str) -> str:
    """ "1 section", "2 sections"; what is counted has its name in the plural."""
    word = said(things)
    if word != things:
        return f"{word} {formatting.count(amount)}"
    return f"{formatting.count(amount)} {things.removesuffix('s') if amount == 1 else things}"


def _charts(rows: list[tuple[str, float, float, float]]) -> list[Markup]:
    """Wall and CPU time, and memory, of each stage."""
    times = []
    for name, wall, cpu, _ in rows:
        end = f"{formatting.seconds(wall)} ({formatting.seconds(cpu)})"
        times.append((name, ((wall, USED), (max(cpu - wall, 0), LIGHT)), end))
    memory = [(name, ((peak, SOFT),), f"{formatting.count(peak)} MiB") for name, _, _, peak in rows]
    return [bars(times, t("Wall time (CPU time)")), bars(memory, t("Peak memory"))]


def _named(value: Any) -> Any:
    """A setting that is a path by the name of what it names: where it lies on the maker's machine is nobody's."""
    return Path(value).name if isinstance(value, str) and Path(value).is_absolute() else value


def _flat(name: str, values: dict) -> dict[str, Any]:
    """Nested tables as one, names joined by points."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        out |= _flat(f"{name}.{key}", value) if isinstance(value, dict) else {f"{name}.{key}": value}
    return out
