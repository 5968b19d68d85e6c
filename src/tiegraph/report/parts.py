"""Parts of the engineer's page: tables of receipts, each number marked with its place in its receipt; references; the
rig as adjusted; time and memory, settings, versions.
"""

import re
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from markupsafe import Markup

from tiegraph.geometry import transforms
from tiegraph.report import formatting
from tiegraph.report.drawing import LIGHT, USED, Series, file_uri, plot
from tiegraph.report.formatting import Table, is_number, marked
from tiegraph.report.runfolder import STAGES, RunFolder
from tiegraph.report.texts import capital, said, t
from tiegraph.scene.colmapmodel import BY_RIG
from tiegraph.scene.evidence import figures

EVIDENCE = "evidence"
_HEAD, _HEADS = 70, 3  # letters and number of contradictions in the headline


def receipt_tables(run: RunFolder, *stages: str) -> list[Table]:
    """The tables of stages, except the one that has a section of its own."""
    found = (
        formatting.table(data, capital(said(name.replace("_", " "))), f"receipts.{stage}.{name}")
        for stage in stages
        for name, data in run.tables(stage).items()
        if name != EVIDENCE
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
    firsts = (re.split(r"(?<!\b\d)(?<!\b\d\d):| differ by", text)[0] for text in found)
    heads = list(dict.fromkeys(said(shorten(first, _HEAD, placeholder=" ...")) for first in firsts))
    return "; ".join(heads[:_HEADS]) + (t(" and {} more", len(heads) - _HEADS) if len(heads) > _HEADS else "")


def evidence_table(run: RunFolder) -> Table | None:
    """The statements of all stages, those of one quantity one below the other; None without any."""
    rows, columns = [], None
    for stage in STAGES:
        data = run.tables(stage).get(EVIDENCE)
        if not isinstance(data, dict) or len(data.get("columns") or []) != 7:  # columns of that table
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


PASSES = "one pass against the other, M3C2"  # a table shown in the section on accuracy
_AGAINST = "cloud against reference"


def passes_part(run: RunFolder) -> dict[str, Any]:
    """Agreement of the clouds of two passes: table and map; both None if they were not compared."""
    data = ((run.metrics or {}).get("tables") or {}).get(PASSES)
    if not isinstance(data, dict):
        return {"table": None, "map": None}
    table = formatting.table(with_section_names(run, data), "", f"tables.{PASSES}")
    return {"table": table, "map": file_uri(run.path / "passes" / "differences.png")}


def evaluation(run: RunFolder) -> dict[str, Any]:
    """The content of metrics.json besides the layers of accuracy."""
    data = run.metrics or {}
    metrics = [m for m in data.get("metrics") or [] if isinstance(m, dict) and "name" in m]
    rows = tuple((said(t(metric_text(str(m["name"])))), *_value(run, m)) for m in metrics)
    columns = (t("figure"), t("value"), t("unit"))
    tables = data.get("tables") or {}
    named = (
        formatting.table(with_section_names(run, d), capital(said(n)), f"tables.{n}")
        for n, d in tables.items()
        if n != PASSES
    )
    against = (tables.get(_AGAINST) or {}).get("rows")
    return {
        "there": bool(data),
        "metrics": Table(columns, rows, (False, True, False)) if rows else None,
        "tables": [table for table in named if table is not None],
        "notes": [str(n) for n in data.get("notes") or []],
        "shares": _shares(against) if against else None,
        "map": file_uri(run.path / "evaluate" / "m3c2.png") if against else None,
    }


def _shares(rows: list[list[float]]) -> Markup:
    distance, *values = np.array(rows, float).T
    kinds = zip((t("accuracy"), t("completeness"), t("F-score")), (LIGHT, USED, "var(--dark)"), values)
    series = [Series(name=name, colour=colour, x=distance, y=np.nan_to_num(value)) for name, colour, value in kinds]
    return plot([(t("% of points"), series)], t("distance, m"), t("Cloud against reference"), whole=False)


def _value(run: RunFolder, metric: dict) -> tuple[Markup, str]:
    """A figure, marked, and its unit: the most readable one, in a model without scale the model's."""
    value, key, unit = metric.get("value"), f"metrics.{metric['name']}", metric.get("unit") or ""
    if unit == "m" and str(metric["name"]).startswith(("backprojection", "passes")) and not run.metric:
        unit = t("units")
    if unit == "m" and is_number(value):
        return marked(key, formatting.length(value)), ""
    return marked(key, formatting.cell(value)), unit


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
    text = _METRICS.get(name, name.replace("_", " "))
    if name not in _METRICS:
        text = text.replace("rpe ", "relative pose error over ").replace("fscore ", "F-score at ")
        text = re.sub(r"(\d)m\b", r"\1 m", text)
    return text.replace(" m translation", " m, translation").replace(" m rotation", " m, rotation")


def rig_table(run: RunFolder) -> Table | None:
    """Cameras: model, focal length, pose in the rig as refined, and its distance from the nominal one."""
    if run.scene is None or run.model is None:
        return None
    unit, factor = ("mm", 1000) if run.metric else ("units", 1)
    given = (run.scanned or run.scene).all_sensors
    rows = []
    for key, sensor in enumerate(run.scene.all_sensors):
        camera, pose = run.model.sensors.get(key, (None, None))
        row: list[Any] = [sensor.name, *[None] * 7]
        if camera is not None:
            row[1:4] = camera.model.name, f"{camera.width}\u00a0×\u00a0{camera.height}", camera.mean_focal_length()
        for column, other in ((4, np.eye(4)), (6, given[key].sensor_from_rig)):
            if pose is not None and other is not None:
                apart = float(np.linalg.norm(transforms.centre(pose) - transforms.centre(other)))
                row[column : column + 2] = factor * apart, float(transforms.angle_deg(pose[:3, :3], other[:3, :3]))
        rows.append(row)
    columns = ["camera", "model", "size px", "focal px", f"to first {unit}", "turned °"]
    columns += [f"moved from nominal {unit}", "turned from it °"]
    filled = [c for c in range(len(columns)) if any(r[c] is not None for r in rows)]
    data = {"columns": [columns[c] for c in filled], "rows": [[r[c] for c in filled] for r in rows]}
    return formatting.table(data, t("Cameras as adjusted"))


def effort(run: RunFolder) -> dict[str, Any]:
    """Table of the stages, settings of each, versions."""
    body = []
    for stage, wall, cpu, peak in stage_rows(run):
        whole = {k: v for k, v in run.counts(stage).items() if isinstance(v, int)}  # others are shown elsewhere
        text = t(", ").join(_counted(v, str(k).replace("_", " ")) for k, v in whole.items())
        body.append((stage, formatting.seconds(wall), formatting.seconds(cpu), formatting.count(peak), text))
    columns = (t("stage"), t("wall time"), t("CPU time"), t("peak MiB"), t("counts"))
    settings, software = [], {}
    for s in STAGES:
        receipt = run.receipts.get(s, {})
        software |= receipt.get("software") or {}
        if receipt.get("settings"):
            values = {**receipt["settings"], **_flat("tuning", receipt.get("tuning") or {})}
            settings.append((s, [(k, formatting.cell(_named(v))) for k, v in values.items()]))
    return {
        "table": Table(columns, tuple(body), (False, True, True, True, False)) if body else None,
        "settings": settings,
        "software": sorted(software.items()),
    }


def _counted(amount: int, things: str) -> str:
    """ "1 section", "2 sections"; the name is given in the plural."""
    word = said(things)
    if word != things:
        return f"{word} {formatting.count(amount)}"
    return f"{formatting.count(amount)} {things.removesuffix('s') if amount == 1 else things}"


def _named(value: Any) -> Any:
    """A setting that is a path reduced to its last name: folders of the maker's machine are private."""
    return Path(value).name if isinstance(value, str) and Path(value).is_absolute() else value


def _flat(name: str, values: dict) -> dict[str, Any]:
    """Nested tables as one, names joined by points."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        out |= _flat(f"{name}.{key}", value) if isinstance(value, dict) else {f"{name}.{key}": value}
    return out


def stage_rows(run: RunFolder) -> list[tuple[str, float, float, float]]:
    """(stage, wall s, CPU s, peak MiB) of the stages that have finished."""
    found = ((s, run.receipts.get(s, {})) for s in STAGES)
    return [
        (s, float(r["seconds"]), float(r.get("cpu_s") or 0), float(r.get("peak_mib") or 0))
        for s, r in found
        if is_number(r.get("seconds"))
    ]


def cloud_facts(run: RunFolder) -> dict[str, Any] | None:
    """Facts about the cloud."""
    c = run.cloud
    if c is None:
        return None
    rows = [(t("file"), f"cloud.laz, {formatting.size(c.bytes)}"), (t("points"), formatting.count(c.count))]
    if c.views.any():
        rows.append((t("images that saw a point, median"), formatting.number(float(np.median(c.views)), 2)))
    return {"facts": rows, "tables": receipt_tables(run, "dense", "cloud"), "notes": run.notes("dense", "cloud")}


def gsd(run: RunFolder) -> tuple[float, float, float] | None:
    """Size of a pixel on the surface, in units of the world: of the nearest tenth of the images, half, nine in ten."""
    known = run.model.gsd[np.isfinite(run.model.gsd)] if run.model is not None else np.zeros(0)
    if not len(known):
        return None
    low, middle, high = np.quantile(known, [0.1, 0.5, 0.9]).tolist()
    return low, middle, high


def product_views(run: RunFolder) -> list[tuple[str, str]]:
    """(name, data URI) of the orthophoto, the surface model and the terrain of each surface."""
    texts = {
        "overview.jpg": "True orthophoto: {}",
        "dsm.jpg": "Surface model: {}",
        "dtm.jpg": "Terrain and contour lines: {}",
    }
    folders = sorted(p for p in (run.path / "products").glob("*") if p.is_dir())
    found = [(t(text, p.name), file_uri(p / name)) for p in folders for name, text in texts.items()]
    return [(text, uri) for text, uri in found if uri is not None]
