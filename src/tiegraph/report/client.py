"""Page one, for the client: object, place, time, accuracy, tolerance, deliverables, and the three worst problems; on
one sheet of paper, with a line to sign. And report.json, the same for programs, as ``report.schema.json`` describes it;
English, figures in metres."""

import json
from dataclasses import asdict
from datetime import datetime, timezone
from typing import Any

import numpy as np
from markupsafe import escape

from tiegraph.geometry.geodesy import Origin, geodetic_from_world
from tiegraph.report import accuracy, formatting, summary
from tiegraph.report.cloudview import inliers
from tiegraph.report.maps import Scenery, scenery, survey_map
from tiegraph.report.parts import gsd, stage_rows
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.settings import ReportSettings
from tiegraph.report.summary import Verdict
from tiegraph.report.texts import capital, said, t
from tiegraph.text import finite

FORMAT = 1
_FILES = {
    "cloud.copc.laz": "point cloud for viewers (COPC), colours, sigma of each point",
    "cloud.laz": "point cloud as LAZ, colours, sigma of each point",
    "cloud.ply": "point cloud as PLY, with normals",
    "products": "surface models and true orthophotos (GeoTIFF)",
    "sparse/world": "camera positions and sparse points (COLMAP)",
    "metrics.json": "accuracy, all figures",
    "accuracy.csv": "accuracy, as a table",
}
_EPOCH_S = 3e8  # larger times count from 1970, smaller ones from a start of their own


def client_page(run: RunFolder, settings: ReportSettings, seen: Scenery | None, verdict: Verdict) -> dict[str, Any]:
    """The parts of the page, for the template."""
    about, known = settings.about, run.accuracy
    return {
        "fields": [(t(name.capitalize()), value) for name, value in about.model_dump().items()],
        "surveyor": about.surveyor,
        "what": summary.what_was_done(run),
        "where": where(run, seen),
        "when": when(run),
        "map": survey_map(seen) if seen is not None else None,
        "answer": accuracy.answer(known) if known is not None else None,
        "layers": accuracy.layers(known) if known is not None else [],
        "held_by": accuracy.holding(known) if known is not None else "",
        "files": [(name, words, formatting.size(size)) for name, words, size in deliverables(run)],
        "problems": [capital(said(text)) for text in worst(verdict)],
    }


def worst(verdict: Verdict) -> list[str]:
    """The worst problems, the worst first: contradictions come before warnings, which are ranked already."""
    return [*verdict.contradictions, *verdict.warnings][:3]


def deliverables(run: RunFolder) -> list[tuple[str, str, int]]:
    """(name, description, bytes) of each existing one."""
    out = []
    for name, words in _FILES.items():
        path = run.path / name
        files = [f for f in path.rglob("*") if f.is_file()] if path.is_dir() else [path]
        if path.exists():
            out.append((name, t(words), sum(f.stat().st_size for f in files)))
    return out


def middle(run: RunFolder, seen: Scenery | None) -> tuple[float, float, float] | None:
    """Latitude and longitude in degrees and height in metres of the middle of the images; None if not on the Earth."""
    origin = (run.world or {}).get("origin")
    if seen is None or not run.georeferenced or origin is None:
        return None
    lat, lon, height = geodetic_from_world(np.median(seen.path, axis=0)[None], Origin.from_dict(origin))[0].tolist()
    return lat, lon, height


def where(run: RunFolder, seen: Scenery | None) -> list[tuple[str, str]]:
    """(name, value): middle, system of coordinates, extent, length of the passes."""
    if seen is None:
        return []
    at, world = middle(run, seen), run.world or {}
    own = t("of its own, not on the Earth")
    crs = summary.crs_text(world.get("crs"), world.get("origin")) if run.georeferenced else own
    size = [formatting.number(v) for v in np.ptp(seen.path, axis=0)[:2]]
    ways = [track.seen for track in seen.tracks if track.name != "images"]
    length = sum(float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) for way in ways)
    return [
        *([] if at is None else [(t("middle"), f"{at[0]:.5f}°, {at[1]:.5f}°")]),
        (t("coordinates"), crs),
        (t("extent of the camera positions"), f"{size[0]} \N{MULTIPLICATION SIGN} {size[1]} {seen.unit}"),
        *([(t("length of the passes"), f"{formatting.number(length)} {seen.unit} ({len(ways)})")] if ways else []),
    ]


def times(run: RunFolder) -> tuple[str | None, str | None, float | None]:
    """First and last exposure (ISO 8601, in UTC, or without a zone if none is known; None if the clock has no date) and
    the seconds between them."""
    known = run.scene.time_s[np.isfinite(run.scene.time_s)] if run.scene is not None else np.zeros(0)
    if not len(known):
        return None, None, None
    low, high = float(known.min()), float(known.max())
    if low < _EPOCH_S:
        return None, None, high - low
    # a camera that writes no time zone has a clock of its own
    zone = None if any(n.endswith("(no time zone written)") for n in run.notes("scan")) else timezone.utc
    dates = (datetime.fromtimestamp(v, timezone.utc).replace(tzinfo=zone) for v in (low, high))
    first, last = (date.isoformat(timespec="seconds") for date in dates)
    return first, last, high - low


def when(run: RunFolder) -> list[tuple[str, str]]:
    """(name, value): when the images were taken, how long that took, when they were processed."""
    first, last, length = times(run)
    if first and last:
        begin, end = (iso[:16].replace("T", " ") for iso in (first, last))
        zone = " UTC" if first.endswith("+00:00") else t(", the camera's clock")
        taken = f"{begin} – {end[11:] if begin[:10] == end[:10] else end}{zone}"
    elif length is not None:
        taken = t("over {}; the clock has no date", formatting.seconds(length))
    else:
        taken = t("not known: the images carry no times")
    finished = [str(r["finished"]) for s, r in run.receipts.items() if r.get("finished") and s != "report"]
    return [(t("images taken"), taken), *([(t("processed"), max(finished)[:10])] if finished else [])]


def json_text(run: RunFolder, settings: ReportSettings) -> str:
    """The file as text."""
    return json.dumps(finite(_plain(content(run, settings))), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def content(run: RunFolder, settings: ReportSettings) -> dict[str, Any]:
    """The content of the file; texts may be Markup and figures NaN."""
    verdict, metrics, world = summary.verdict(run), run.metrics or {}, run.world or {}
    seen = scenery(run)
    at, stages = middle(run, seen), stage_rows(run)
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
            "size": None if seen is None else _extent(seen.xyz[inliers(seen.xyz)]),
        },
        "when": dict(zip(("first", "last", "seconds"), times(run))),
        "counts": _counts(run),
        "deliverables": [dict(zip(("name", "what", "bytes"), row)) for row in deliverables(run)],
        "stages": [dict(zip(("stage", "seconds", "cpu_s", "peak_mib"), row)) for row in stages],
        "images": [asdict(row) for row in summary.image_rows(run)],
    }


def _counts(run: RunFolder) -> dict[str, Any]:
    m, c, scene = run.model, run.cloud, run.scene
    size = gsd(run)
    return {
        "images": None if scene is None else len(scene) + run.hanging[0],
        "frames": None if scene is None else scene.frames,
        "registered": None if m is None else int(m.images.registered.sum()),
        "placed_by_rig": None if m is None else int(m.images.by_rig.sum()) + run.hanging[1],
        "models": 0 if m is None else 1 + len(m.others),
        "sparse_points": None if m is None else m.points,
        "cloud_points": None if c is None else c.count,
        "gsd": None if size is None else dict(zip(("tenth", "half", "nine_tenths"), size)),
    }


def _plain(value: Any) -> Any:
    """Texts without marks and without paths of the maker's machine."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "__html__"):
        value = str(escape(value).striptags())
    return formatting.shown(value) if isinstance(value, str) else value


def _extent(xyz: np.ndarray) -> list[float]:
    return np.ptp(xyz, axis=0).tolist() if len(xyz) else [0.0, 0.0, 0.0]  # type: ignore[no-any-return]
