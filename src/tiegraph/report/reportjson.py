"""report.json: the report for programs, as ``report.schema.json`` describes it; English, figures in metres."""

import json
import math
from datetime import datetime, timezone
from importlib.resources import files
from typing import Any

from markupsafe import escape

from tiegraph.report import formatting, spatial, summary, warnings
from tiegraph.report.client import deliverables, middle, times, worst
from tiegraph.report.runfolder import STAGES, RunFolder
from tiegraph.report.settings import ReportSettings
from tiegraph.report.spatial import Scenery, scenery
from tiegraph.text import printable

FORMAT = 1


def schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of report.json."""
    text = files("tiegraph.report").joinpath("report.schema.json").read_text(encoding="utf-8")
    return json.loads(text)  # type: ignore[no-any-return]


def json_text(run: RunFolder, settings: ReportSettings) -> str:
    """The file as text."""
    return json.dumps(_plain(content(run, settings)), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def content(run: RunFolder, settings: ReportSettings) -> dict[str, Any]:
    """What the file holds; texts may be Markup and figures NaN."""
    seen, verdict = scenery(run), summary.verdict(run)
    return {
        "format": FORMAT,
        "title": settings.title or run.path.resolve().name,
        "made": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "about": settings.about.model_dump(),
        "verdict": {"level": verdict.level, "headline": verdict.headline, "sentences": list(verdict.sentences)},
        "contradictions": list(verdict.contradictions),
        "warnings": list(verdict.warnings),
        "worst_problems": worst(verdict),
        "accuracy": (run.metrics or {}).get("accuracy"),
        "metrics": [m for m in (run.metrics or {}).get("metrics") or [] if isinstance(m, dict)],
        "where": _where(run, seen),
        "when": dict(zip(("first", "last", "seconds"), times(run))),
        "counts": _counts(run),
        "deliverables": [{"name": n, "what": w, "bytes": b} for n, w, b in deliverables(run)],
        "stages": [
            {"stage": s, "seconds": wall, "cpu_s": cpu, "peak_mib": peak}
            for s, wall, cpu, peak in summary.stage_rows(run)
            if s in STAGES
        ],
        "images": [
            {"name": r.name, "state": r.state, "reason": r.reason, "points": r.points, "ties": r.ties, "gsd": r.gsd}
            for r in warnings.image_rows(run)
        ],
    }


def _where(run: RunFolder, seen: Scenery | None) -> dict[str, Any]:
    at = middle(run, seen)
    world = run.world or {}
    return {
        "crs": world.get("crs"),
        "unit": "m" if run.metric else "units",
        "middle": None if at is None else dict(zip(("lat_deg", "lon_deg", "height_m"), at)),
        "size": None if seen is None else [float(v) for v in spatial.points_inside(seen)],
    }


def _counts(run: RunFolder) -> dict[str, Any]:
    m, c, scene = run.model, run.cloud, run.scene
    gsd = spatial.gsd(run)
    return {
        "images": None if scene is None else len(scene) + run.hanging[0],
        "frames": None if scene is None else scene.frames,
        "registered": None if m is None else int(m.registered.sum()),
        "placed_by_rig": None if m is None else int(m.by_rig.sum()) + run.hanging[1],
        "models": 0 if m is None else 1 + len(m.others),
        "sparse_points": None if m is None else m.figures.points,
        "cloud_points": None if c is None else c.count,
        "gsd": None if gsd is None else dict(zip(("tenth", "half", "nine_tenths"), gsd)),
    }


def _plain(value: Any) -> Any:
    """JSON-ready: marks taken off, no path of the maker's machine, NaN as null."""
    if hasattr(value, "__html__"):
        return _text(str(escape(value).striptags()))
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value


def _text(value: str) -> str:
    return printable(formatting.without_folders(value))
