"""report.json: the report for programs, as ``report.schema.json`` describes it; English, figures in metres."""

import json
from dataclasses import asdict
from datetime import datetime, timezone
from importlib.resources import files
from typing import Any

from markupsafe import escape

from tiegraph.report import formatting, spatial, summary, warnings
from tiegraph.report.client import deliverables, middle, times, worst
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.settings import ReportSettings
from tiegraph.text import finite, printable

FORMAT = 1


def schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of report.json."""
    text = files("tiegraph.report").joinpath("report.schema.json").read_text(encoding="utf-8")
    return json.loads(text)  # type: ignore[no-any-return]


def json_text(run: RunFolder, settings: ReportSettings) -> str:
    """The file as text."""
    return json.dumps(finite(_plain(content(run, settings))), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def content(run: RunFolder, settings: ReportSettings) -> dict[str, Any]:
    """What the file holds; texts may be Markup and figures NaN."""
    verdict, metrics, world = summary.verdict(run), run.metrics or {}, run.world or {}
    seen = spatial.scenery(run)
    at, stages = middle(run, seen), summary.stage_rows(run)
    return {
        "format": FORMAT,
        "title": settings.title or run.path.resolve().name,
        "made": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "about": settings.about.model_dump(),
        "verdict": {"level": verdict.level, "headline": verdict.headline, "sentences": list(verdict.sentences)},
        "contradictions": list(verdict.contradictions),
        "warnings": list(verdict.warnings),
        "worst_problems": worst(verdict),
        "accuracy": metrics.get("accuracy"),
        "metrics": [m for m in metrics.get("metrics") or [] if isinstance(m, dict)],
        "where": {
            "crs": world.get("crs"),
            "unit": "m" if run.metric else "units",
            "middle": None if at is None else dict(zip(("lat_deg", "lon_deg", "height_m"), at)),
            "size": None if seen is None else spatial.points_inside(seen).tolist(),
        },
        "when": dict(zip(("first", "last", "seconds"), times(run))),
        "counts": _counts(run),
        "deliverables": [dict(zip(("name", "what", "bytes"), row)) for row in deliverables(run)],
        "stages": [dict(zip(("stage", "seconds", "cpu_s", "peak_mib"), row)) for row in stages],
        "images": [asdict(row) for row in warnings.image_rows(run)],
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
        "sparse_points": None if m is None else m.points,
        "cloud_points": None if c is None else c.count,
        "gsd": None if gsd is None else dict(zip(("tenth", "half", "nine_tenths"), gsd)),
    }


def _plain(value: Any) -> Any:
    """Texts without marks and without paths of the maker's machine."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "__html__"):
        value = str(escape(value).striptags())
    return printable(formatting.without_folders(value)) if isinstance(value, str) else value
