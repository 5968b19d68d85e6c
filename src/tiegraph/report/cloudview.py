"""Views of a point cloud. Static ones: a z-buffer in NumPy with eye-dome lighting (Boucheny 2009), top and two
obliques. The interactive one: a thinned cloud, the cameras' paths and images, packed for viewer.js.
"""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np

from tiegraph.report.drawing import jpeg, shown_colours, thumbnail
from tiegraph.report.maps import Scenery
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.texts import t
from tiegraph.text import round_below

VIEW_PX = 1400  # width of the static views
_IMAGES, _PICTURES = 5000, 90  # that the interactive view names, and shows
_EDL_DEAD_PX = 0.7  # noise of a surface that is not shaded
_EDL_CLIP_PX = 8.0  # a deeper step is not darker
_MAX_RADIUS_PX = 3


def standard_views(
    xyz: np.ndarray, rgb: np.ndarray, path: np.ndarray, width: int, north_up: bool = True
) -> list[tuple[str, np.ndarray, float]]:
    """Top view and two obliques from either side of the path (K, 3) of the cameras; up is +z, +y is north if stated:
    caption, picture (H, W, 3) u1, and the scale of the drawing (orthographic), pixels a unit.

    Points (N, 3), colours (N, 3) u1. Views are cropped to the middle 98 % of the points.
    """
    keep = inliers(xyz)
    if not keep.any():
        return []
    xyz, rgb = xyz[keep], shown_colours(xyz[keep], rgb[keep])
    along = main_axis_deg(path if len(path) > 2 else xyz)
    asked = [("Top view, north up" if north_up else "Top view", 0.0, 90.0)]
    for k, side in enumerate((along + 60.0, along + 240.0)):
        asked.append((f"Oblique view from {compass(side)}" if north_up else f"Oblique view {k + 1}", side, 32.0))
    return [(name, *render(xyz, rgb, side, elevation, width)) for name, side, elevation in asked]


def inliers(xyz: np.ndarray, share: float = 0.99, margin: float = 0.15) -> np.ndarray:
    """(N,) bool: inside the box of the middle ``share`` of the points on each axis, widened by a margin of its size."""
    if not len(xyz):
        return np.zeros(0, bool)
    low, high = np.quantile(xyz, [(1 - share) / 2, (1 + share) / 2], axis=0)
    pad = margin * (high - low) + 1e-9
    return np.all((xyz >= low - pad) & (xyz <= high + pad), axis=1)


def main_axis_deg(path: np.ndarray) -> float:
    """Direction of the longest extent in plan, degrees from +x (east) counter-clockwise."""
    flat = path[:, :2] - path[:, :2].mean(axis=0)
    _, _, vt = np.linalg.svd(flat[:: max(1, len(flat) // 20000)], full_matrices=False)
    return float(np.degrees(np.arctan2(vt[0, 1], vt[0, 0])))


def compass(angle_deg: float) -> str:
    """Name of the direction of a viewer at this angle from +x counter-clockwise."""
    names = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")
    return "the " + names[round(angle_deg / 45) % 8]


def render(
    xyz: np.ndarray, rgb: np.ndarray, from_deg: float, elevation_deg: float, width: int
) -> tuple[np.ndarray, float]:
    """Orthographic picture (H, W, 3) u1 of points seen from a direction, and its scale in pixels per unit.

    ``from_deg``: where the viewer stands, counter-clockwise from +x; at 90 degrees of elevation north (+y) is up.
    """
    e, a = np.radians(elevation_deg), np.radians(-90.0 if elevation_deg >= 90 else from_deg)
    back = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    uvd = xyz @ np.column_stack([right, np.cross(back, right), -back])
    low, high = uvd[:, :2].min(axis=0), uvd[:, :2].max(axis=0)
    border = 0.02 * (high - low).max()
    low, high = low - border, high + border
    scale = width / max(high[0] - low[0], (high[1] - low[1]) / 0.8, 1e-9)
    columns, rows = np.maximum(np.ceil((high - low) * scale).astype(int) + 1, 8).tolist()
    uvd, rgb = (values[np.argsort(-uvd[:, 2], kind="stable")] for values in (uvd, rgb))  # the nearest is drawn last
    column, row = ((uvd[:, 0] - low[0]) * scale).astype(np.int32), ((high[1] - uvd[:, 1]) * scale).astype(np.int32)
    return _shaded(*_drawn(column, row, uvd[:, 2] * scale, rgb, (rows, columns))), float(scale)


def _drawn(
    column: np.ndarray, row: np.ndarray, depth: np.ndarray, colour: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Colour and depth (inf = empty) of each pixel; points come far first, so that the nearest is written last.

    A point is a disc as wide as the local spacing of the points (up to _MAX_RADIUS_PX), so that surfaces close.
    """
    picture = np.full((size[0] * size[1], 3), 247, np.uint8)
    buffer = np.full(size[0] * size[1], np.inf, np.float32)
    radius = _radius(column, row, size)
    reach = range(-_MAX_RADIUS_PX, _MAX_RADIUS_PX + 1)
    for away, dx, dy in sorted((np.hypot(dx, dy), dx, dy) for dx in reach for dy in reach):
        pick = np.flatnonzero(radius >= away)
        u, v = column[pick] + dx, row[pick] + dy
        inside = (u >= 0) & (u < size[1]) & (v >= 0) & (v < size[0])
        pick, cell = pick[inside], v[inside] * size[1] + u[inside]
        nearer = depth[pick] < buffer[cell] - away  # a disc's rim must not cover points of about the same depth
        pick, cell = pick[nearer], cell[nearer]
        picture[cell], buffer[cell] = colour[pick], depth[pick]
    return picture.reshape(*size, 3), buffer.reshape(size)


def _radius(column: np.ndarray, row: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(N,) half the mean distance of the points around each and half a pixel, by their number in 8 x 8 pixel cells."""
    cells = ((size[0] >> 3) + 1, (size[1] >> 3) + 1)
    cell = (row >> 3).astype(np.int64) * cells[1] + (column >> 3)
    count = np.bincount(cell, minlength=cells[0] * cells[1]).reshape(cells).astype(np.float32)
    smooth = cv2.blur(count, (3, 3)) / np.maximum(cv2.blur((count > 0).astype(np.float32), (3, 3)), 1e-6)
    return np.minimum(0.5 + 1.25 * np.sqrt(64 / np.maximum(smooth.ravel()[cell], 1.0)), _MAX_RADIUS_PX)


def _shaded(picture: np.ndarray, buffer: np.ndarray) -> np.ndarray:
    """Eye-dome lighting: a pixel is darkened by how far it lies behind the mean of opposite neighbours.

    Means of opposite pixels leave plane slopes, which fill the drawing, unchanged.
    """
    padded, (h, w) = np.pad(buffer, 2, mode="edge"), buffer.shape
    shade = np.zeros(buffer.shape, np.float32)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)):
        opposite = [padded[2 + s * dy : 2 + s * dy + h, 2 + s * dx : 2 + s * dx + w] for s in (1, -1)]
        with np.errstate(invalid="ignore"):
            behind = buffer - (opposite[0] + opposite[1]) / 2
        shade += np.clip(np.nan_to_num(behind, nan=0.0, posinf=0.0, neginf=0.0) - _EDL_DEAD_PX, 0, _EDL_CLIP_PX)
    light = np.exp(-2.0 * shade / (6 * _EDL_CLIP_PX))
    return (picture * np.where(np.isfinite(buffer), light, 1)[..., None]).astype(np.uint8)


def with_scale_bar(picture: np.ndarray, px_per_unit: float, unit: str) -> np.ndarray:
    """The picture with a scale bar at its lower left."""
    picture = picture.copy()
    length = round_below(0.14 * picture.shape[1] / px_per_unit)
    x, y, size = 18, picture.shape[0] - 18, round(length * px_per_unit)
    unit = unit if unit.isascii() else "units"  # the font of the picture has no other letters
    label, font = f"{length:g} {unit.removesuffix('s') if length == 1 else unit}", cv2.FONT_HERSHEY_SIMPLEX
    (wide, tall), _ = cv2.getTextSize(label, font, 0.6, 2)
    cv2.rectangle(picture, (x - 10, y - 18 - tall), (x + 10 + max(wide, size), y + 8), (255, 255, 255), cv2.FILLED)
    cv2.line(picture, (x, y), (x + size, y), (30, 30, 30), 2)
    cv2.putText(picture, label, (x, y - 10), font, 0.6, (30, 30, 30), 2, cv2.LINE_AA)
    return picture


# Okabe and Ito 2008: distinct for colour-blind readers too; as --pass0 ... of the style sheet
PASSES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5c99", "#5b6770")


def _packed(name: str, values: np.ndarray, unit: str) -> dict[str, Any]:
    """A colour scale of points (N,), NaN = not known, for the view: one byte a point, 255 = not known. The colours span
    94 % of the values."""
    known = np.isfinite(values)
    low, high = np.quantile(values[known], [0.03, 0.97]).tolist()
    level = np.round(254 * np.clip((np.nan_to_num(values) - low) / max(high - low, 1e-12), 0, 1))
    told = {"name": name, "unknown": not known.all(), "low": low, "high": high, "unit": unit}
    return {**told, "values": _text(np.where(known, level, 255).astype(np.uint8))}


def viewer_data(
    seen: Scenery,
    most: int,
    scales: Mapping[str, np.ndarray] = MappingProxyType({}),
    images: Sequence[tuple[str, np.ndarray, str]] = (),
    offset: Sequence[float] = (0.0, 0.0, 0.0),
) -> dict[str, Any] | None:
    """JSON-ready data of the view; None without points. Points far outside the others are left out and counted.

    ``scales``: values of the points (N,) by name; ``images``: name, place (3,), picture as data URI or ""; ``offset``
    (3,) of displayed coordinates. A point takes nine bytes, and one more for each scale.
    """
    keep = np.flatnonzero(inliers(seen.xyz, 0.998, 0.3))
    if not len(keep) or most < 1:
        return None
    if len(keep) > most:
        keep = np.sort(np.random.default_rng(0).choice(keep, most, replace=False))
    points = seen.xyz[keep]
    low = points.min(axis=0)
    step = max(float((points - low).max()), 1e-9) / 65535
    every = {t("height"): points[:, 2] + offset[2], **{n: values[keep] for n, values in scales.items()}}
    middle = np.median(points, axis=0)  # centre of the first view, and its distance to most points
    reach = float(np.quantile(np.linalg.norm(points - middle, axis=1), 0.85))
    return {
        "count": len(points),
        "low": low.tolist(),
        "step": step,
        "xyz": _text(np.round((points - low) / step).astype("<u2")),
        "rgb": _text(np.ascontiguousarray(shown_colours(points, seen.rgb[keep]), np.uint8)),
        "scales": [_packed(name, v, seen.unit) for name, v in every.items() if np.isfinite(v).any()],
        "tracks": [
            {"name": track.name, "colour": PASSES[k % len(PASSES)], "line": track.name != "images",
             "xyz": np.round(track.seen, 4).ravel().tolist()}
            for k, track in enumerate(seen.tracks)
        ],
        "images": [{"name": n, "at": np.round(at, 3).tolist(), "picture": p} for n, at, p in images],
        "offset": [float(v) for v in offset],
        "axes": ["E", "N", "H"] if seen.north else ["x", "y", "z"],
        "north": seen.north,
        "unit": seen.unit,
        "text": {name: t(words) for name, words in _SAID.items()},
        "middle": middle.tolist(),
        "reach": max(reach, 1e-6),
    }  # fmt: skip


_SAID = {  # by the script
    "hint": "Click a point to read its coordinates, a second one to measure; click a camera to see its image.",
    "distance": "distance",
    "difference": "height difference",
    "colour": "colour of the images",
    "unknown": "not known",
    "paths": "Camera paths",
}


def _text(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode()


def viewer_script() -> str:
    """The viewer's JavaScript."""
    return files("tiegraph.report").joinpath("viewer.js").read_text(encoding="utf-8")


def views(run: RunFolder, seen: Scenery) -> list[tuple[str, str]]:
    """(name, data URI) of the static views of the cloud."""
    if run.cloud is None:
        return []
    drawn = standard_views(seen.xyz, seen.rgb, seen.path, VIEW_PX, seen.north)
    return [(t(name), jpeg(with_scale_bar(rgb, scale, seen.unit))) for name, rgb, scale in drawn]


def viewer_part(run: RunFolder, seen: Scenery, most: int) -> dict[str, Any]:
    """Data and script of the interactive view."""
    rows = np.sort(np.random.default_rng(0).permutation(len(seen.xyz))[:most])
    some = replace(seen, xyz=seen.xyz[rows], rgb=seen.rgb[rows])
    scales = {} if run.cloud is None else {t("sigma of a point"): run.cloud.sigma_m[rows]}
    data = viewer_data(some, most, scales, _images(run, seen), run.shift.tolist())
    if data is None:
        return {"viewer": None, "viewer_script": ""}
    return {"viewer": json.dumps(data).replace("<", "\\u003c"), "viewer_script": viewer_script()}


def _images(run: RunFolder, seen: Scenery) -> list[tuple[str, np.ndarray, str]]:
    """The images with their places, an even part of them with a small picture."""
    assert run.scene is not None and run.model is not None
    placed = np.flatnonzero(run.model.images.placed)[:_IMAGES]
    pictured = set(placed[np.linspace(0, len(placed) - 1, min(len(placed), _PICTURES)).astype(int)].tolist())
    out = []
    for at, k in zip(seen.path, placed):
        made = thumbnail(run.path / "images" / run.scene.names[k], Path(), width=200) if int(k) in pictured else None
        out.append((run.scene.names[k], at, str(made[0]) if made else ""))
    return out
