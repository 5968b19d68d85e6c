"""Parts of the engineer's page: the ties between images (pictures in the order of a reader's questions, one sentence
each); references; the rig, its cameras as adjusted and along the run; time and memory, settings, versions.
"""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from tiegraph.geometry import transforms
from tiegraph.report import charts, formatting, summary
from tiegraph.report.formatting import Table, marked
from tiegraph.report.runfolder import STAGES, RunFolder
from tiegraph.report.svg import LIGHT, SOFT, USED, Series, bars, plot
from tiegraph.report.tables import with_section_names
from tiegraph.report.texts import capital, said, t
from tiegraph.report.thumbnails import file_uri
from tiegraph.report.warnings import FEW_TIES
from tiegraph.scene.colmapmodel import BY_RIG

_NETWORK_STAGES = ("preview", "candidates", "coarse", "network", "design", "features", "match", "filter")
_TITLES = {
    "candidates": "Candidates", "coarse": "Coarse model", "network": "Network", "design": "Design",
    "match": "Matching", "filter": "View-graph filtering",
}  # fmt: skip
# Pictures of the network folder in order of display; the first word found in the file's name decides.
_CAPTIONS = {
    "matrix": "Correspondence matrix: images by pass, camera and frame along both sides; the colour says why a pair "
    "was dropped.",
    "map": "The tie graph on the map, by kind of tie, before the design: every pair that is expected to share surface.",
    "design": "The ties that the design chose to match: thick bundles hold the survey together, a red line is a place "
    "with only one link.",
    "covered": "How well the surface is covered, seen from above: cells by what is weak about them; the numbers are "
    "rows of the table of places to revisit.",
    "offset": "Frame-offset curves: preview matches of two cameras against the frame offset between them. The pair "
    "range is centred on a clear peak; a flat curve means the two never see the same place.",
    "section": "View of the upward camera along the path, and the bridge and open sections derived from it.",
    "funnel": "How many pairs of images each filter of the network left.",
}
_WEAK_LINKS = "Weak links: places where the survey is disconnected, or weakly connected, if one tie or frame is lost."
_SOUND = "No weak links: no place depends on a single tie or frame."


def network_part(run: RunFolder) -> dict[str, Any]:
    """Pictures, funnel, tables and remarks of the stages from preview to view-graph filtering."""
    out: dict[str, Any] = {"matrices": None, "funnel": None, "degrees": None, "table": None, "sound": None}
    pairs = run.pairs if run.pairs is not None else run.network
    if pairs is not None and run.scene is not None and len(pairs):
        before = run.network if run.network is not None else pairs
        out["matrices"] = [charts.looked_at(before, run.scene), charts.holding(pairs, run.scene)]
        rows = charts.funnel_rows(pairs, run.network)
        out["funnel"], out["table"] = charts.funnel(rows), _funnel_table(rows, len(run.scene))
        out["degrees"] = charts.degrees(pairs, len(run.scene), FEW_TIES)
    notes = {_title(s): lines for s in _NETWORK_STAGES if s != "coarse" and (lines := run.notes(s))}
    sentences = [note if note.endswith((".", "!", "?")) else f"{note}." for note in map(capital, run.notes("coarse"))]
    out |= {"model": sentences, "notes": list(notes.items()), "links": [], "tables": []}
    out["pictures"] = _pictures(run, drawn=out["matrices"] is not None)
    for stage in _NETWORK_STAGES:
        for name, data in run.tables(stage).items():
            plain = str(name).replace("_", " ")
            table = formatting.table(data, f"{_title(stage)}: {said(plain)}", f"receipts.{stage}.{name}")
            if plain == "weak links" and isinstance(data, dict) and not data.get("rows"):
                out["sound"] = t(_SOUND)
            elif table is not None and plain == "weak links":
                out["links"].append(replace(table, title=t(_WEAK_LINKS)))
            elif table is not None and plain != "funnel":  # that is drawn from the pair table
                out["tables"].append(table)
    return {**out, "there": any(out[name] for name in ("matrices", "pictures", "tables", "links", "notes"))}


def _title(stage: str) -> str:
    return t(_TITLES.get(stage, stage.capitalize()))


def _pictures(run: RunFolder, drawn: bool) -> list[tuple[str, str]]:
    """(data URI, caption) of the pictures of the network stage and the design."""
    found, order = [], list(_CAPTIONS)
    for path in sorted(p for folder in ("candidates", "network", "design") for p in (run.path / folder).glob("*.png")):
        title = path.stem.replace("curve", "offset")
        if path.parent.name == "design":
            title = {"surface": "covered"}.get(path.stem, "design")
        kind = next((k for k in order if k in title), "")
        uri = None if drawn and kind in ("matrix", "funnel") else file_uri(path)  # these have charts
        if uri:
            caption = t(_CAPTIONS.get(kind, path.stem.replace("_", " ")))
            found.append((order.index(kind) if kind else len(order), uri, caption))
    return [(uri, caption) for _, uri, caption in sorted(found, key=lambda f: f[0])]


def _funnel_table(rows: list[tuple[str, int, str]], images: int) -> formatting.Table | None:
    every = images * (images - 1) / 2
    body = [
        [charts.step_name(name), value if charts.is_loss(name) else None, left, 100 * left / every if every else None]
        for (name, value, _), left in zip(rows, charts.pairs_left(rows))
    ]
    return formatting.table({"columns": ["step", "dropped", "pairs left", "% of all possible"], "rows": body})


# --- references -----------------------------------------------------------------------------------------------------


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
        "metrics": formatting.Table(columns, rows, (False, True, False)) if rows else None,
        "tables": [table for table in named if table is not None],
        "notes": [str(n) for n in data.get("notes") or []],
        "shares": _shares(against) if against else None,
        "map": file_uri(run.path / "evaluate" / "m3c2.png") if against else None,
    }


def _shares(rows: list[list[float]]) -> Markup:
    """A curve each of accuracy, completeness and F-score over the distance."""
    distance, *values = np.array(rows, float).T
    kinds = zip((t("accuracy"), t("completeness"), t("F-score")), (LIGHT, USED, "var(--dark)"), values)
    series = [Series(name=name, colour=colour, x=distance, y=np.nan_to_num(value)) for name, colour, value in kinds]
    return plot([(t("% of points"), series)], t("distance, m"), t("Cloud against reference"), whole=False)


def _value(run: RunFolder, metric: dict) -> tuple[Markup, str]:
    """A figure, marked, and its unit: for lengths the most readable one, in a model without scale
    the model's."""
    value, key, unit = metric.get("value"), f"metrics.{metric['name']}", metric.get("unit") or ""
    if unit == "m" and str(metric["name"]).startswith(("backprojection", "passes")) and not run.metric:
        unit = t("units")
    if unit == "m" and formatting.is_number(value):
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


# --- the rig --------------------------------------------------------------------------------------------------------


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


# --- time and memory, settings, versions ----------------------------------------------------------------------------


def effort(run: RunFolder) -> dict[str, Any]:
    """Charts and table of the stages, settings of each, versions."""
    rows, body, times, memory = summary.stage_rows(run), [], [], []
    for stage, wall, cpu, peak in rows:
        whole = {k: v for k, v in run.counts(stage).items() if isinstance(v, int)}  # others are shown elsewhere
        text = t(", ").join(_counted(v, str(k).replace("_", " ")) for k, v in whole.items())
        wall_s, cpu_s, mib = formatting.seconds(wall), formatting.seconds(cpu), formatting.count(peak)
        body.append((stage, wall_s, cpu_s, mib, text))
        times.append((stage, ((wall, USED), (max(cpu - wall, 0), LIGHT)), f"{wall_s} ({cpu_s})"))
        memory.append((stage, ((peak, SOFT),), f"{mib} MiB"))
    columns = (t("stage"), t("wall time"), t("CPU time"), t("peak MiB"), t("counts"))
    settings, software = [], {}
    for s in STAGES:
        receipt = run.receipts.get(s, {})
        software |= receipt.get("software") or {}
        if receipt.get("settings"):
            values = {**receipt["settings"], **_flat("tuning", receipt.get("tuning") or {})}
            settings.append((s, [(k, formatting.cell(_named(v))) for k, v in values.items()]))
    return {
        "charts": [bars(times, t("Wall time (CPU time)")), bars(memory, t("Peak memory"))] if rows else [],
        "table": formatting.Table(columns, tuple(body), (False, True, True, True, False)) if rows else None,
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
