"""Page one, for the client: what, where, when, how good, whether that is good enough, what is handed over, and the
three worst problems; on one sheet of paper, with a line to sign."""

from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.geometry.geodesy import Origin, geodetic_from_world
from tiegraph.report import accuracy, formatting, spatial, summary
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.settings import ReportSettings
from tiegraph.report.spatial import Scenery
from tiegraph.report.summary import Verdict, what_was_done
from tiegraph.report.texts import said, t

PROBLEMS = 3
_FILES = {
    "cloud.copc.laz": "point cloud for viewers (COPC), colours, sigma of each point",
    "cloud.laz": "point cloud as LAZ, colours, sigma of each point",
    "cloud.ply": "point cloud as PLY, with normals",
    "sparse/world": "camera positions and sparse points (COLMAP)",
    "metrics.json": "accuracy, all figures",
    "accuracy.csv": "accuracy, as a table",
}
_EPOCH_S = 3e8  # a time beyond is counted from 1970, one below from a start of its own


def client_page(
    run: RunFolder, settings: ReportSettings, seen: spatial.Scenery | None, verdict: Verdict
) -> dict[str, Any]:
    """The parts of the page, for the template."""
    about = settings.about
    fields = ((t("Client"), about.client), (t("Project"), about.project), (t("Equipment"), about.equipment))
    return {
        "fields": [*fields, (t("Surveyor"), about.surveyor)],
        "surveyor": about.surveyor,
        "what": what_was_done(run),
        "where": where(run, seen),
        "when": when(run),
        "map": spatial.survey_map(seen) if seen is not None else None,
        "north": seen is not None and seen.north,
        "answer": accuracy.answer(run.accuracy) if run.accuracy is not None else None,
        "layers": accuracy.layers(run.accuracy) if run.accuracy is not None else [],
        "held_by": accuracy.holding(run.accuracy) if run.accuracy is not None else "",
        "files": sizes(deliverables(run)),
        "problems": [text[:1].upper() + text[1:] for text in map(said, worst(verdict))],
    }


def worst(verdict: Verdict) -> list[str]:
    """The worst problems, the worst first: contradictions come before warnings, which are ranked already; [] if the
    run found nothing wrong."""
    return [*verdict.contradictions, *verdict.warnings][:PROBLEMS]


def deliverables(run: RunFolder) -> list[tuple[str, str, int]]:
    """(name, what it is, bytes) of each that is there."""
    there = [(name, run.path / name, words) for name, words in _FILES.items()]
    return [(name, t(words), _bytes(path)) for name, path, words in there if path.exists()]


def sizes(rows: list[tuple[str, str, int]]) -> list[tuple[str, str, str]]:
    """The same with sizes as text."""
    return [(name, words, formatting.size(amount)) for name, words, amount in rows]


def _bytes(path: Path) -> int:
    if path.is_dir():
        return sum(p.stat().st_size for p in path.iterdir() if p.is_file())
    return path.stat().st_size


def middle(run: RunFolder, seen: Scenery | None) -> tuple[float, float, float] | None:
    """Latitude and longitude in degrees and height in metres of the middle of the images; None if not on the Earth."""
    origin = (run.world or {}).get("origin")
    if seen is None or not run.georeferenced or origin is None:
        return None
    found = geodetic_from_world(np.median(seen.path, axis=0)[None], Origin.from_dict(origin))[0]
    lat, lon, height = (float(v) for v in found)
    return lat, lon, height


def where(run: RunFolder, seen: Scenery | None) -> list[tuple[str, str]]:
    """(name, value): middle, system of coordinates, extent, length of the passes."""
    if seen is None:
        return []
    out = []
    at = middle(run, seen)
    if at is not None:
        out.append((t("middle"), f"{at[0]:.5f}°, {at[1]:.5f}°"))
    if run.world is not None and run.georeferenced:
        out.append((t("coordinates"), summary.crs_text(run.world.get("crs"), run.world.get("origin"))))
    else:
        out.append((t("coordinates"), t("of its own, not on the Earth")))
    low, high = np.min(seen.path, axis=0), np.max(seen.path, axis=0)
    size = [formatting.number(v) for v in (high - low)[:2]]
    out.append((t("extent of the camera positions"), f"{size[0]} \N{MULTIPLICATION SIGN} {size[1]} {seen.unit}"))
    ways = [_length(track.positions) for track in seen.tracks if track.name != "images"]
    if ways:
        out.append((t("length of the passes"), f"{formatting.number(sum(ways))} {seen.unit} ({len(ways)})"))
    return out


def times(run: RunFolder) -> tuple[str | None, str | None, float | None]:
    """First and last exposure (ISO 8601, in UTC, or without a zone where none is known; None if the clock has no date)
    and the seconds between them."""
    known = run.scene.time_s[np.isfinite(run.scene.time_s)] if run.scene is not None else np.zeros(0)
    if not len(known):
        return None, None, None
    low, high = float(known.min()), float(known.max())
    if low < _EPOCH_S:
        return None, None, high - low
    zone = None if _without_zone(run) else timezone.utc
    dates = (datetime.fromtimestamp(v, timezone.utc).replace(tzinfo=zone) for v in (low, high))
    first, last = (date.isoformat(timespec="seconds") for date in dates)
    return first, last, high - low


def _without_zone(run: RunFolder) -> bool:
    """Whether times are those of a camera that does not write its time zone."""
    return any(str(n).endswith("(no time zone written)") for n in run.receipts.get("scan", {}).get("notes") or [])


def when(run: RunFolder) -> list[tuple[str, str]]:
    """(name, value): when the images were taken, how long that took, when they were processed."""
    first, last, length = times(run)
    out = []
    if first and last:
        end = last[11:16] if first[:10] == last[:10] else _date(last)
        zone = " UTC" if first.endswith("+00:00") else t(", the camera's clock")
        out.append((t("images taken"), f"{_date(first)} – {end}{zone}"))
    elif length is not None:
        out.append((t("images taken"), t("over {}; the clock has no date", formatting.seconds(length))))
    else:
        out.append((t("images taken"), t("not known: the images carry no times")))
    finished = sorted(str(r["finished"]) for s, r in run.receipts.items() if r.get("finished") and s != "report")
    if finished:
        out.append((t("processed"), finished[-1][:10]))
    return out


def _date(iso: str) -> str:
    return iso[:16].replace("T", " ")


def _length(positions: np.ndarray) -> float:
    seen = positions[np.isfinite(positions[:, 0])]
    return float(np.sum(np.linalg.norm(np.diff(seen, axis=0), axis=1)))
