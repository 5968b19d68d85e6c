"""Data of the interactive 3-D view: a thinned cloud, the cameras' paths and images, packed for viewer.js."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import Any

import numpy as np

from tiegraph.report.cloudview import brightened, by_height, inliers
from tiegraph.report.plan import Track
from tiegraph.report.texts import t

# Okabe and Ito 2008: told apart by colour-blind readers too; as --pass0 ... of the style sheet
PASSES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5c99", "#5b6770")
_STEPS = 65535  # positions are stored as 16-bit steps of the box
_SHARE = 0.94  # of the values of a scale that its colours span


@dataclass(frozen=True, eq=False)
class Scale:
    """What points (N,) are coloured by, NaN = not known: a value, ``signed`` if its zero is the middle of the colours,
    or the number of one of ``names``."""

    values: np.ndarray
    signed: bool = False
    names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ViewerExtras:
    """What a view may show besides points and paths: scales of the points by name, what is added to coordinates
    that are read off (3,), the names of the axes, images (name, place (3,), picture as data URI or ""), north."""

    scales: dict[str, Scale] = field(default_factory=dict)
    offset: Sequence[float] = (0.0, 0.0, 0.0)
    axes: Sequence[str] = ("x", "y", "z")
    images: Sequence[tuple[str, np.ndarray, str]] = ()
    north: bool = False


def viewer_data(
    xyz: np.ndarray, rgb: np.ndarray, tracks: list[Track], most: int, unit: str, extras: ViewerExtras | None = None
) -> dict[str, Any] | None:
    """JSON-ready data of the view; None without points. Points far outside the others are left out and counted.

    A point takes nine bytes, three 16-bit coordinates within the box, three of colour, and one more for each scale.
    """
    extras = extras or ViewerExtras()
    keep = np.flatnonzero(inliers(xyz, 0.998, 0.3))
    if not len(keep) or most < 1:
        return None
    if len(keep) > most:
        keep = np.sort(np.random.default_rng(0).choice(keep, most, replace=False))
    points = xyz[keep]
    low, high = points.min(axis=0), points.max(axis=0)
    step = np.maximum((high - low).max(), 1e-9) / _STEPS
    packed = np.round((points - low) / step).astype("<u2")
    colour = brightened(rgb[keep]) if np.ptp(rgb[keep]) > 8 else by_height(points[:, 2])
    height = {t("height"): Scale(points[:, 2] + extras.offset[2])}
    scales = height | {n: replace(s, values=s.values[keep]) for n, s in extras.scales.items()}
    # What the view shows first: the middle of the points, and how far most of them reach from it
    middle = np.median(points, axis=0)
    reach = float(np.quantile(np.linalg.norm(points - middle, axis=1), 0.85))
    return {
        "count": len(points),
        "low": low.tolist(),
        "step": float(step),
        "xyz": _text(packed),
        "rgb": _text(np.ascontiguousarray(colour, np.uint8)),
        "scales": [_scale(name, s, unit) for name, s in scales.items() if np.isfinite(s.values).any()],
        "tracks": [_track(track, PASSES[k % len(PASSES)]) for k, track in enumerate(tracks)],
        "images": [{"name": n, "at": np.round(at, 3).tolist(), "picture": p} for n, at, p in extras.images],
        "offset": [float(v) for v in extras.offset],
        "axes": list(extras.axes),
        "north": extras.north,
        "unit": unit,
        "text": _texts(),
        "middle": middle.tolist(),
        "reach": max(reach, 1e-6),
    }


def _texts() -> dict[str, str]:
    """What the script says."""
    return {
        "hint": t("Click a point to read its coordinates, a second one to measure; click a camera to see its image."),
        "distance": t("distance"),
        "difference": t("height difference"),
        "colour": t("colour of the images"),
        "unknown": t("not known"),
        "paths": t("Camera paths"),
    }


def _text(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode()


def _scale(name: str, scale: Scale, unit: str) -> dict[str, Any]:
    """Values of the points as one byte each, between the ends of the scale or as they are numbered; 255 = not known."""
    values = scale.values
    unknown = not np.isfinite(values).all()
    if scale.names:
        packed = np.where(np.isfinite(values), np.nan_to_num(values) % 255, 255).astype(np.uint8)
        colours = [PASSES[k % len(PASSES)] for k in range(len(scale.names))]
        kinds = list(zip(scale.names, colours))
        return {"name": name, "kinds": kinds, "unknown": unknown, "values": _text(packed)}
    known = values[np.isfinite(values)]
    low, high = (float(v) for v in np.quantile(known, [(1 - _SHARE) / 2, (1 + _SHARE) / 2]))
    if scale.signed:
        high = max(abs(low), abs(high))
        low = -high
    share = np.clip((values - low) / max(high - low, 1e-12), 0, 1)
    packed = np.where(np.isfinite(share), np.round(254 * np.nan_to_num(share)), 255).astype(np.uint8)
    ends = {"low": low, "high": high, "unit": unit, "signed": scale.signed}
    return {"name": name, **ends, "unknown": unknown, "values": _text(packed)}


def _track(track: Track, colour: str) -> dict[str, Any]:
    seen = track.positions[np.isfinite(track.positions[:, 0])]
    line = track.name != "images"
    return {"name": track.name, "colour": colour, "line": line, "xyz": np.round(seen, 4).ravel().tolist()}


def viewer_script() -> str:
    """The viewer's JavaScript."""
    return files("tiegraph.report").joinpath("viewer.js").read_text(encoding="utf-8")
