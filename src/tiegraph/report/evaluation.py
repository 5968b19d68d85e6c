"""The part of the report on references: figures of merit, tables, shares of the cloud, the map of differences."""

import re
from typing import Any

from markupsafe import Markup

from tiegraph.report import formatting
from tiegraph.report.formatting import marked
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.svg.charts import shares
from tiegraph.report.tables import with_section_names
from tiegraph.report.texts import said, t
from tiegraph.report.thumbnails import file_uri
from tiegraph.scene.registered import BY_RIG

PASSES = "one pass against the other, M3C2"  # a table that stands where it is said how sure one can be


def passes_part(run: RunFolder) -> dict[str, Any]:
    """How well the clouds of two passes agree: table and map; both None where they were not compared."""
    data = ((run.metrics or {}).get("tables") or {}).get(PASSES)
    if not isinstance(data, dict):
        return {"table": None, "map": None}
    table = formatting.table(with_section_names(run, data), "", f"tables.{PASSES}")
    return {"table": table, "map": file_uri(run.path / "passes" / "differences.png")}


def evaluation(run: RunFolder) -> dict[str, Any]:
    """What metrics.json holds beside the layers of accuracy."""
    data = run.metrics or {}
    notes = [str(n) for n in data.get("notes") or []]
    out: dict[str, Any] = {"there": bool(data), "metrics": None, "tables": [], "notes": notes}
    rows = [
        (
            said(t(metric_text(str(m["name"])))),
            *_value(m, _unit(run, m)),
        )
        for m in data.get("metrics") or []
        if isinstance(m, dict) and "name" in m
    ]
    if rows:
        out["metrics"] = formatting.Table((t("figure"), t("value"), t("unit")), tuple(rows), (False, True, False))
    tables = data.get("tables") or {}
    # who is registered stands in the model section
    shown = {n: d for n, d in tables.items() if not n.startswith("registered by") and n != PASSES}
    named = (_titled(run, name, data) for name, data in shown.items())
    out["tables"] = [table for table in named if table is not None]
    against = (tables.get("cloud against reference") or {}).get("rows")
    out["shares"] = shares(against) if against else None
    out["map"] = file_uri(run.path / "evaluate" / "m3c2.png") if against else None
    return out


def _value(metric: dict, unit: str) -> tuple[Markup, str]:
    """A figure, marked, and its unit: of lengths the one that reads best."""
    value, key = metric.get("value"), f"metrics.{metric['name']}"
    if unit != "m" or not formatting.is_number(value):
        return marked(key, formatting.cell(value)), unit
    text = formatting.length(value)
    return marked(key, text), ""


def _unit(run: RunFolder, metric: dict) -> str:
    """The unit of a figure: of what is measured inside a model that nothing told the scale of, the model's."""
    unit, inside = metric.get("unit") or "", str(metric["name"]).startswith(("backprojection", "passes"))
    return t("units") if unit == "m" and inside and not run.metric else unit


def _titled(run: RunFolder, name: str, data: Any) -> formatting.Table | None:
    title = said(name)
    return formatting.table(with_section_names(run, data), title[:1].upper() + title[1:], f"tables.{name}")


_METRICS = {
    "registered_images": "registered images",
    "images_by_rig": "images " + BY_RIG,
    "backprojection_rmse": "back-projection RMSE (round trip, see the note)",
    "backprojection_rounding": "... of which rounding to the pixel alone",
    "ate_sim3_rmse": "camera positions after similarity alignment, RMSE (ATE Sim3)",
    "ate_sim3_median": "... median",
    "ate_sim3_max": "... largest",
    "ate_se3_rmse": "camera positions after rigid alignment, RMSE (ATE SE3)",
    "absolute_rmse": "camera positions without alignment, RMSE",
    "scale_error": "scale error",
    "yaw_drift": "heading drift",
    "cloud_to_cloud_median": "cloud to reference cloud, median distance",
    "cloud_to_cloud_90": "cloud to reference cloud, 90 % of points within",
    "ghosts": "ghost points",
    "m3c2_median": "cloud minus reference along the normal (M3C2), median",
    "m3c2_spread": "cloud minus reference along the normal (M3C2), spread",
    "passes_median": "one pass minus the other along the normal (M3C2), median",
    "passes_spread": "one pass minus the other along the normal (M3C2), spread",
    "passes_significant": "one pass against the other: differences beyond the level of detection",
}


def metric_text(name: str) -> str:
    """A figure of merit in words."""
    if name in _METRICS:
        return _METRICS[name]
    text = name.replace("_", " ")
    for short, full in (("rpe ", "relative pose error over "), ("fscore ", "F-score at ")):
        text = text.replace(short, full)
    text = re.sub(r"(\d)m\b", r"\1 m", text)
    return text.replace(" m translation", " m, translation").replace(" m rotation", " m, rotation")
