"""report.html: one self-contained file made of receipts and artefacts only."""

from __future__ import annotations

import json
import re
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from tiegraph.report import accuracy, charts, formatting, plan, summary, viewer, warnings
from tiegraph.report.cloudview import standard_views, with_scale_bar
from tiegraph.report.contradictions import EVIDENCE, evidence_table
from tiegraph.report.formatting import marked
from tiegraph.report.networkpart import network_part
from tiegraph.report.rigdiagnostics import rig_diagnostics, rig_table
from tiegraph.report.runfolder import STAGES, RunFolder, read_run
from tiegraph.report.settings import ReportSettings
from tiegraph.report.thumbnails import CLASSES, file_uri, jpeg, mask_share, thumbnail
from tiegraph.scene.atomic import replacing
from tiegraph.scene.figures import plain_text
from tiegraph.scene.registered import BY_RIG
from tiegraph.scene.scene import Scene
from tiegraph.text import printable

_MASKS_READ = 25  # masks opened for a camera's mean share
_DROPPED_SHOWN = 200


def write_report(folder: Path, settings: ReportSettings, planned: formatting.Table | None = None) -> Path:
    """Write ``folder/report.html`` from what the folder holds; stages that have not run are left out.

    ``planned``: what was planned beside what was reached. Raises InputError if the folder holds no run, TiegraphError
    if the disk is full.
    """
    run = read_run(folder, settings.view_points)
    text = render(run, settings, planned)
    target = folder / "report.html"
    with replacing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return target


@plain_text()
def render(run: RunFolder, settings: ReportSettings, planned: formatting.Table | None = None) -> str:
    """The page as text."""
    context = {
        "title": settings.title or run.path.resolve().name,
        "made": datetime.now(timezone.utc).strftime("%d %B %Y, %H:%M UTC"),
        "verdict": summary.verdict(run),
        "tiles": summary.tiles(run),
        "sure": _how_sure(run),
        "scan": _scan(run),
        "masks": _masks(run, settings),
        "network": network_part(run),
        "model": _model(run),
        "planned": planned,
        "evaluation": _evaluation(run),
        "effort": _effort(run),
        **_three_d(run, settings),
    }
    return environment().get_template("template.html.jinja").render(context)


def environment() -> jinja2.Environment:
    """Templates of this package, everything escaped, also what acts without being seen (``text.printable``)."""
    loader = jinja2.PackageLoader("tiegraph.report", ".")
    return jinja2.Environment(
        loader=loader,
        autoescape=True,
        finalize=lambda value: printable(value) if type(value) is str else value,  # not of Markup, which is ours
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _how_sure(run: RunFolder) -> dict[str, Any]:
    """Every accuracy with what it does not prove, and what each source says by itself."""
    out: dict[str, Any] = {"table": None, "placement": "", "evidence": evidence_table(run)}
    if run.accuracy is not None:
        out |= {"table": accuracy.table(run.accuracy), "placement": accuracy.placement(run.accuracy)}
    return out


def _scan(run: RunFolder) -> dict[str, Any]:
    scene, receipt = run.scene, run.receipts.get("scan", {})
    notes = list(dict.fromkeys([*(scene.notes if scene else ()), *map(str, receipt.get("notes") or [])]))
    dropped = warnings.dropped_images(run)
    facts_ = []
    if scene is not None:
        rigs = ", ".join(f"{r.name} ({len(r.sensors)} cameras)" if len(r.sensors) > 1 else r.name for r in scene.rigs)
        facts_ = [
            ("images", formatting.count(len(scene))),
            ("frames", formatting.count(scene.frames)),
            ("rig", rigs[:200] + (" …" if len(rigs) > 200 else "")),
            ("passes", ", ".join(scene.sequences[:12]) or "none: loose photographs"),
            ("prior poses", _prior(scene)),
        ]
    return {
        "facts": facts_,
        "notes": notes,
        "dropped": dropped[:_DROPPED_SHOWN],
        "more": max(0, len(dropped) - _DROPPED_SHOWN),
        "tables": _tables(receipt),
    }


def _masks(run: RunFolder, settings: ReportSettings) -> dict[str, Any]:
    receipt, final = run.receipts.get("masks", {}), run.receipts.get("refine", {})
    strips: list[dict[str, Any]] = []
    if run.scene is not None and (run.path / "images").is_dir():
        for key, sensor in enumerate(run.scene.all_sensors[:24]):
            strips.extend(_mask_strip(run, run.scene, key, sensor.name, settings.mask_images))
    return {
        "strips": strips,
        "any": any(s["share"] is not None for s in strips),
        "classes": CLASSES[1:] if any((run.path / "classes").rglob("*.png")) else [],
        "notes": [*(receipt.get("notes") or []), *(final.get("notes") or [])],
        "tables": [*_tables(receipt), *_tables(final)],
    }


def _mask_strip(run: RunFolder, scene: Scene, key: int, name: str, shown: int) -> list[dict[str, Any]]:
    images = np.flatnonzero(scene.sensor_key == key)
    if not len(images) or not shown:
        return []
    spread = images[np.unique(np.linspace(0, len(images) - 1, _MASKS_READ).astype(int))]
    shares = [s for k in spread if (s := mask_share(_mask_path(run, scene.names[k]))) is not None]
    out = []
    for place in (np.arange(shown) + 0.3) / shown:
        image = scene.names[images[int(place * len(images))]]
        mask = _mask_path(run, image)
        classes = mask.parents[len(Path(image).parts)] / "classes" / f"{image}.png"
        made = thumbnail(run.path / "images" / image, mask, classes)
        if made is not None:
            mean = float(np.mean(shares)) if shares else None
            text = formatting.percent(mean) if mean is not None else ""
            out.append({"picture": made[0], "camera": name, "image": image, "share": made[1], "mean": text})
    return out


def _mask_path(run: RunFolder, image: str) -> Path:
    """The final mask of an image, else the first one."""
    final = run.path / "refine" / "masks" / f"{image}.png"
    return final if final.exists() else run.path / "masks" / f"{image}.png"


def _model(run: RunFolder) -> dict[str, Any]:
    out: dict[str, Any] = {"there": run.model is not None, "facts": [], "tables": [], "notes": [], "residuals": None}
    out["more"], out["rig_diagnostics"] = [], rig_diagnostics(run)
    for stage, place in (("sparse", "more"), ("georef", "tables")):
        receipt = run.receipts.get(stage, {})
        out[place] += _tables(receipt)
        out["notes"] += [str(n) for n in receipt.get("notes") or []]
    out["notes"] = list(dict.fromkeys([*out["notes"], *map(str, (run.world or {}).get("notes") or [])]))
    if run.model is None:
        return out
    m = run.model
    out["facts"] = [
        ("registered images", f"{formatting.count(int(m.registered.sum()))} of {formatting.count(len(m.registered))}"),
        ("images " + BY_RIG, formatting.count(int(m.by_rig.sum()))),
        ("sparse points", formatting.count(m.figures.points)),
        ("observations of an image", formatting.number(m.figures.observations)),
        ("images of a point (track length)", formatting.number(m.figures.track_length)),
        ("mean reprojection error", f"{formatting.number(m.figures.reprojection_px)} px"),
        ("models", formatting.count(1 + len(m.others))),
    ]
    rig = rig_table(run)
    out["tables"] = [*out["tables"], *summary.registered_tables(run), *([rig] if rig else [])]
    out["residuals"] = _residuals(run)
    return out


def _residuals(run: RunFolder) -> str | None:
    rows = [r for r in (run.world or {}).get("frames") or [] if isinstance(r, dict) and _three(r.get("residual_m"))]
    if run.scene is None or len(rows) < 2:
        return None
    frames = np.array([int(r.get("frame", k)) for k, r in enumerate(rows)])
    track = np.array([run.scene.sequence[f] if 0 <= f < run.scene.frames else -1 for f in frames])
    used = np.array([bool(r.get("inlier", True)) for r in rows])
    return charts.residuals(frames, np.array([r["residual_m"] for r in rows], float), used, track, run.scene.sequences)


def _three(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) == 3 and all(isinstance(v, (int, float)) for v in value)


def _prior(scene: Scene) -> str:
    if not scene.started:
        return scene.prior
    return "start model" if scene.prior == "trajectory" else f"{scene.prior}, start model"


def _three_d(run: RunFolder, settings: ReportSettings) -> dict[str, Any]:
    """The plan, the static views and the interactive view."""
    out: dict[str, Any] = {"plan": None, "views": [], "viewer": None, "viewer_script": "", "cloud": None}
    if run.scene is None or run.model is None or not run.model.placed.any():
        return out
    upright = np.eye(3) if run.world else _upright(run.model.world_from_camera)
    unit = "m" if run.metric else "units"
    placed = run.georeferenced or bool((run.world or {}).get("placed"))
    seen = run.cloud or run.model.sample
    xyz, rgb = seen.xyz, seen.rgb
    xyz = xyz @ upright.T
    found = plan.tracks(run.scene, plan.frame_positions(run.scene, run.model.centres @ upright.T))
    prior = run.scene.world_from_rig[:, :3, 3]
    gnss = prior[np.isfinite(prior[:, 0])] if placed else np.zeros((0, 3))
    axes = ("east", "north") if run.georeferenced else ("x", "y")
    if not placed:  # prior positions are in another frame than the model
        found = [plan.Track(t.name, t.positions, t.missing[:0]) for t in found]
    out["plan"] = plan.plan_chart(found, gnss, xyz, unit, axes)
    if run.cloud is not None:
        path = run.model.centres[run.model.placed] @ upright.T
        views = standard_views(xyz, rgb, path, settings.view_px, run.georeferenced)
        out["views"] = [(v.name, jpeg(with_scale_bar(v, unit))) for v in views]
        out["cloud"] = _cloud_facts(run)
    data = viewer.viewer_data(xyz, rgb, found, settings.viewer_points, unit)
    if data is not None:
        out["viewer"] = json.dumps(data).replace("<", "\\u003c")
        out["viewer_script"] = viewer.viewer_script()
    return out


def _upright(world_from_camera: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) that stands a free model up: images are taken upright on the whole, so "up" is their mean -y."""
    up = -np.nanmean(world_from_camera[:, :3, 1], axis=0)
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    side = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(up, side), up])


def _cloud_facts(run: RunFolder) -> dict[str, Any]:
    c = run.cloud
    assert c is not None
    rows = [("file", f"{c.name}, {formatting.size(c.bytes)}"), ("points", formatting.count(c.count))]
    if c.views.any():
        rows.append(("images that saw a point, median", formatting.number(float(np.median(c.views)), 2)))
    tables, notes = [], []
    for stage in ("dense", "cloud"):
        receipt = run.receipts.get(stage, {})
        tables += _tables(receipt)
        notes += [str(n) for n in receipt.get("notes") or []]
    return {"facts": rows, "tables": tables, "notes": notes}


def _evaluation(run: RunFolder) -> dict[str, Any]:
    data = run.metrics or {}
    out: dict[str, Any] = {"there": bool(data), "metrics": None, "tables": [], "notes": data.get("notes") or []}
    rows = [
        [
            metric_text(str(m["name"])),
            marked(f"metrics.{m['name']}", formatting.cell(m.get("value"))),
            m.get("unit") or "",
        ]
        for m in data.get("metrics") or []
        if isinstance(m, dict) and "name" in m
    ]
    if rows:
        out["metrics"] = formatting.Table(("figure", "value", "unit"), tuple(map(tuple, rows)), (False, True, False))
    tables = data.get("tables") or {}
    # who is registered stands in the model section
    shown = {n: d for n, d in tables.items() if not n.startswith("registered by")}
    named = ((n, formatting.table(d, n.capitalize(), f"tables.{n}")) for n, d in shown.items())
    out["tables"] = [t for _, t in named if t is not None]
    against = (tables.get("cloud against reference") or {}).get("rows")
    out["shares"] = charts.shares(against) if against else None
    out["map"] = file_uri(run.path / "evaluate" / "m3c2.png") if against else None
    return out


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


def _effort(run: RunFolder) -> dict[str, Any]:
    rows = summary.stage_rows(run)
    body = []
    for stage, wall, cpu, peak in rows:
        counts = run.counts(stage)
        whole = {k: v for k, v in counts.items() if isinstance(v, int)}  # what is no number of things stands elsewhere
        text = ", ".join(f"{formatting.count(v)} {str(k).replace('_', ' ')}" for k, v in whole.items())
        body.append((stage, formatting.seconds(wall), formatting.seconds(cpu), formatting.count(peak), text))
    columns = ("stage", "wall time", "CPU time", "peak MiB", "counts")
    table = formatting.Table(columns, tuple(body), (False, True, True, True, False)) if body else None
    receipts = {s: run.receipts[s] for s in STAGES if run.receipts.get(s, {}).get("settings")}
    settings = [(s, {**r["settings"], **_flat("tuning", r.get("tuning") or {})}) for s, r in receipts.items()]
    software: dict[str, str] = {}
    for s in STAGES:
        software.update(run.receipts.get(s, {}).get("software") or {})
    return {
        "chart": charts.stage_times(rows) if rows else None,
        "table": table,
        "settings": [(s, [(k, formatting.cell(_named(v))) for k, v in values.items()]) for s, values in settings],
        "software": sorted(software.items()),
    }


def _named(value: Any) -> Any:
    """A setting that is a path by the name of what it names: where it lies on the maker's machine is nobody's."""
    return Path(value).name if isinstance(value, str) and Path(value).is_absolute() else value


def _flat(name: str, values: dict) -> dict[str, Any]:
    """Nested tables as one, names joined by points."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        out |= _flat(f"{name}.{key}", value) if isinstance(value, dict) else {f"{name}.{key}": value}
    return out


def _tables(receipt: dict, prefix: str = "") -> list[formatting.Table]:
    found = receipt.get("tables")
    if not isinstance(found, dict):
        return []
    found = {n: t for n, t in found.items() if n != EVIDENCE}
    # the funnel is drawn and printed from the pair table, up to the verified pairs
    named = {n: f"{prefix}: {n}" if prefix else n.capitalize() for n in found if n != "funnel"}
    key = f"receipts.{receipt.get('stage')}"
    tables = (formatting.table(found[n], title.replace("_", " "), f"{key}.{n}") for n, title in named.items())
    return [t for t in tables if t is not None]
