"""Data of the interactive 3-D view: a thinned cloud and the cameras' paths, packed for viewer.js."""

from __future__ import annotations

import base64
from importlib.resources import files
from typing import Any

import numpy as np

from tiegraph.report.cloudview import brightened, by_height, inliers
from tiegraph.report.plan import Track

# Okabe and Ito 2008: told apart by colour-blind readers too; as --pass0 ... of the style sheet
PASSES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5c99", "#5b6770")
_STEPS = 65535  # positions are stored as 16-bit steps of the box


def viewer_data(xyz: np.ndarray, rgb: np.ndarray, tracks: list[Track], most: int, unit: str) -> dict[str, Any] | None:
    """JSON-ready data of the view; None without points. Points far outside the others are left out and counted.

    A point takes nine bytes: three 16-bit coordinates within the box, three of colour.
    """
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
    return {
        "count": len(points),
        "low": low.tolist(),
        "step": float(step),
        "xyz": base64.b64encode(packed.tobytes()).decode(),
        "rgb": base64.b64encode(np.ascontiguousarray(colour, np.uint8).tobytes()).decode(),
        "tracks": [_track(t, PASSES[k % len(PASSES)]) for k, t in enumerate(tracks)],
        "unit": unit,
        **_focus(points),
    }


def _focus(points: np.ndarray) -> dict[str, Any]:
    """What the view shows first: the middle of the points, and how far most of them reach from it."""
    middle = np.median(points, axis=0)
    reach = float(np.quantile(np.linalg.norm(points - middle, axis=1), 0.85))
    return {"middle": middle.tolist(), "reach": max(reach, 1e-6)}


def _track(track: Track, colour: str) -> dict[str, Any]:
    seen = track.positions[np.isfinite(track.positions[:, 0])]
    line = track.name != "images"
    return {"name": track.name, "colour": colour, "line": line, "xyz": np.round(seen, 4).ravel().tolist()}


def viewer_script() -> str:
    """The viewer's JavaScript."""
    return files("tiegraph.report").joinpath("viewer.js").read_text(encoding="utf-8")
