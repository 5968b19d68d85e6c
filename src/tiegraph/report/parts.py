"""Parts of the engineer's page: which images tie to which (pictures in the order a reader asks, one sentence each);
references; the rig, its cameras as adjusted and along the run; time and memory, settings, versions.
"""

import csv
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
from tiegraph.report.svg import LIGHT, SOFT, USED, along, bars, shares
from tiegraph.report.tables import with_section_names
from tiegraph.report.texts import said, t
from tiegraph.report.thumbnails import file_uri
from tiegraph.report.warnings import FEW_TIES
from tiegraph.scene.registered import BY_RIG

_NETWORK_STAGES = ("preview", "candidates", "coarse", "network", "design", "features", "match", "filter")
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
    "offset": "Frame-offset curves: preview matches of two cameras against the frame offset between them. A clear peak "
    "is the offset the pair range is laid around; a flat curve means the two never see the same place.",
    "section": "What the upward camera sees along the way, and the bridge and open sections cut from it.",
    "funnel": "How many pairs of images each filter of the network left.",
}
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
    notes = {stage: [str(n) for n in run.receipts.get(stage, {}).get("notes") or []] for stage in _NETWORK_STAGES}
    out["model"] = [_sentence(n) for n in notes.pop("coarse")]
    out["notes"] = [(t(TITLES.get(s, s.capitalize())), lines) for s, lines in notes.items() if lines]
    out["pictures"] = _pictures(run, drawn=out["matrices"] is not None)
    out["links"], out["tables"] = [], []
    for stage in _NETWORK_STAGES:
        _sort_tables(stage, run.receipts.get(stage, {}), out)
    parts = ("matrices", "pictures", "tables", "links", "notes")
    return {**out, "there": any(out[name] for name in parts)}


def _sort_tables(stage: str, receipt: dict, out: dict[str, Any]) -> None:
    """Weak links to the front, with a sentence; the rest under the name of its stage."""
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
        if plain == "weak links":
            out["links"].append(replace(table, title=t(_WEAK_LINKS)))
        else:
            out["tables"].append(table)


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


# --- references -----------------------------------------------------------------------------------------------------


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


# --- the rig --------------------------------------------------------------------------------------------------------


FILE = ("sparse", "0", "rig_diagnostics.csv")
CAPTION = (
    "Every camera placed by the points that the other cameras made, against its place in the rig, frame by frame. A "
    "rigid, synchronised rig scatters about zero within its band (twice the expected sigma). A constant offset is an "
    "error of the given geometry; one that grows with speed is a camera that fires at another time; scatter beyond the "
    "band is a loose camera."
)
_NUMBERS = ("frame", "right_m", "down_m", "forward_m", "turn_x_deg", "turn_y_deg", "turn_z_deg", "sigma_m", "sigma_deg")


def rig_table(run: RunFolder) -> Table | None:
    """Cameras: model, focal length, place on the rig as refined, and how far that is from the nominal one."""
    if run.scene is None or run.model is None:
        return None
    unit = "mm" if run.metric else "units"
    given = (run.scanned or run.scene).all_sensors
    factor = 1000 if unit == "mm" else 1
    rows = []
    for key, sensor in enumerate(run.scene.all_sensors):
        camera = run.model.cameras.get(key)
        pose, nominal = run.model.sensor_from_rig.get(key), given[key].sensor_from_rig
        from_first = turn = moved = bent = None
        if pose is not None:
            from_first = factor * float(np.linalg.norm(transforms.centre(pose)))
            turn = float(transforms.angle_deg(pose[:3, :3], np.eye(3)))
            if nominal is not None:
                moved = factor * float(np.linalg.norm(transforms.centre(pose) - transforms.centre(nominal)))
                bent = float(transforms.angle_deg(pose[:3, :3], nominal[:3, :3]))
        rows.append([
            sensor.name, camera["model"] if camera else None, camera["size"] if camera else None,
            camera["focal_px"] if camera else None, from_first, turn, moved, bent,
        ])  # fmt: skip
    columns = ["camera", "model", "size px", "focal px", f"to first {unit}", "turned °"]
    columns += [f"moved from nominal {unit}", "turned from it °"]
    filled = [c for c in range(len(columns)) if any(r[c] is not None for r in rows)]
    data = {"columns": [columns[c] for c in filled], "rows": [[r[c] for c in filled] for r in rows]}
    return formatting.table(data, t("Cameras as adjusted"))


def rig_diagnostics(run: RunFolder) -> dict[str, Any] | None:
    """Charts and caption, None without a file of at least two rows."""
    rows = _read(run.path.joinpath(*FILE))
    if len(rows) < 2:
        return None
    kinds = (
        (("right_m", "down_m", "forward_m"), "sigma_m", t("place, m")),
        (("turn_x_deg", "turn_y_deg", "turn_z_deg"), "sigma_deg", t("rotation, degrees")),
    )
    drawn = [along(_series(rows, names, sigma), label, t("Rig diagnostics")) for names, sigma, label in kinds]
    return {"charts": drawn, "caption": t(CAPTION)}


def _read(path: Path) -> list[dict[str, Any]]:
    try:
        with path.open(newline="") as stream:
            return [{**row, **{k: float(row[k]) for k in _NUMBERS}} for row in csv.DictReader(stream)]
    except (OSError, KeyError, ValueError):
        return []


def _series(
    rows: list[dict[str, Any]], names: tuple[str, ...], sigma: str
) -> list[tuple[str, np.ndarray, np.ndarray, float]]:
    """(camera, frames, how far it is off, half width of its band) of each camera."""
    out = []
    for camera in dict.fromkeys(r["camera"] for r in rows):
        own = sorted((r for r in rows if r["camera"] == camera), key=lambda r: r["frame"])
        off = np.array([[r[k] for k in names] for r in own])
        # of the three directions, the one that this camera is off most in
        worst = off[:, int(np.argmax(np.median(np.abs(off), axis=0)))]
        frames = np.array([r["frame"] for r in own])
        out.append((camera, frames, worst, 2 * float(np.median([r[sigma] for r in own]))))
    return out


# --- time and memory, settings, versions ----------------------------------------------------------------------------


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
