"""Views of a point cloud. Static ones: a z-buffer in NumPy with eye-dome lighting (Boucheny 2009), top and two
obliques.
The interactive one: a thinned cloud, the cameras' paths and images, packed for viewer.js.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import Any

import cv2
import numpy as np

from tiegraph.report.maps import Track
from tiegraph.report.texts import t
from tiegraph.text import round_below

_EDL_STRENGTH = 2.0
_EDL_DEAD_PX = 0.7  # noise of a surface that is not shaded
_EDL_CLIP_PX = 8.0  # a step deeper than this is not darker
_MAX_RADIUS_PX = 3
_MARGIN = 0.02  # empty border as a share of the longer side
_BACKGROUND = 247


@dataclass(frozen=True)
class CloudView:
    """A rendered view: rgb (H, W, 3) u1, its caption, and the scale of the drawing (orthographic)."""

    name: str
    rgb: np.ndarray
    px_per_m: float


def standard_views(
    xyz: np.ndarray, rgb: np.ndarray, path: np.ndarray, width: int, north_up: bool = True
) -> list[CloudView]:
    """Top view and two obliques from either side of the path (K, 3) of the cameras; up is +z, +y is north if so told.

    Points (N, 3), colours (N, 3) u1. Views are cropped to the middle 98 % of the points, so that a few strays do not
    shrink the rest.
    """
    keep = inliers(xyz)
    xyz, rgb = xyz[keep], rgb[keep]
    if not len(xyz):
        return []
    rgb = brightened(rgb) if np.ptp(rgb) > 8 else by_height(xyz[:, 2])
    along = main_axis_deg(path if len(path) > 2 else xyz)
    top = CloudView("Top view, north up" if north_up else "Top view", *render(xyz, rgb, 0.0, 90.0, width))
    sides = (along + 60.0, along + 240.0)
    names = [f"Oblique view from {compass(a)}" if north_up else f"Oblique view {k + 1}" for k, a in enumerate(sides)]
    return [top, *(CloudView(n, *render(xyz, rgb, a, 32.0, width)) for n, a in zip(names, sides))]


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
    """Name of the direction in which a viewer stands who is seen at this angle from +x counter-clockwise."""
    names = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")
    return "the " + names[round(angle_deg / 45) % 8]


def by_height(z: np.ndarray) -> np.ndarray:
    """Colours (N, 3) u1 by height, for clouds without colour."""
    low, high = np.quantile(z, [0.02, 0.98]) if len(z) else (0.0, 1.0)
    level = np.clip((z - low) / max(high - low, 1e-9), 0, 1)
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_VIRIDIS).reshape(256, 3)[:, ::-1]
    return table[(255 * level).astype(np.uint8)]


def render(
    xyz: np.ndarray, rgb: np.ndarray, from_deg: float, elevation_deg: float, width: int
) -> tuple[np.ndarray, float]:
    """Orthographic picture (H, W, 3) u1 of points seen from a direction, and its scale in pixels per unit.

    ``from_deg``: where the viewer stands, counter-clockwise from +x; at 90 degrees of elevation north (+y) is up.
    """
    uvd = _view_coordinates(xyz, from_deg, elevation_deg)
    low, high = uvd[:, :2].min(axis=0), uvd[:, :2].max(axis=0)
    low, high = low - _MARGIN * (high - low).max(), high + _MARGIN * (high - low).max()
    scale = width / max(high[0] - low[0], (high[1] - low[1]) / 0.8, 1e-9)
    size = np.maximum(np.ceil((high - low) * scale).astype(int) + 1, 8)
    column = ((uvd[:, 0] - low[0]) * scale).astype(np.int32)
    row = ((high[1] - uvd[:, 1]) * scale).astype(np.int32)
    far_first = np.argsort(-uvd[:, 2], kind="stable")
    column, row, depth = column[far_first], row[far_first], uvd[far_first, 2] * scale
    colour = rgb[far_first]
    picture, buffer = _draw(column, row, depth, colour, (int(size[1]), int(size[0])))
    return _shaded(picture, buffer), float(scale)


def _view_coordinates(xyz: np.ndarray, from_deg: float, elevation_deg: float) -> np.ndarray:
    """Right, up and depth (N, 3) of points."""
    e = np.radians(elevation_deg)
    a = np.radians(-90.0 if elevation_deg >= 90 else from_deg)
    back = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    up = np.cross(back, right)
    return np.column_stack([xyz @ right, xyz @ up, -(xyz @ back)])


def _draw(
    column: np.ndarray, row: np.ndarray, depth: np.ndarray, colour: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Colour and depth (inf = empty) of each pixel; points come far first, so that the nearest is written last.

    A point is a disc as wide as the local spacing of the points (up to _MAX_RADIUS_PX), so that surfaces close.
    """
    picture = np.full((size[0] * size[1], 3), _BACKGROUND, np.uint8)
    buffer = np.full(size[0] * size[1], np.inf, np.float32)
    radius = _splat_radius(column, row, size)
    reach = range(-_MAX_RADIUS_PX, _MAX_RADIUS_PX + 1)
    discs = sorted((np.hypot(dx, dy), dx, dy) for dx in reach for dy in reach)
    for away, dx, dy in discs:
        pick = np.flatnonzero(radius >= away)
        u, v = column[pick] + dx, row[pick] + dy
        inside = (u >= 0) & (u < size[1]) & (v >= 0) & (v < size[0])
        pick, cell = pick[inside], v[inside] * size[1] + u[inside]
        nearer = depth[pick] < buffer[cell] - away  # a disc's rim must not cover what is about as near
        pick, cell = pick[nearer], cell[nearer]
        picture[cell] = colour[pick]
        buffer[cell] = depth[pick]
    return picture.reshape(*size, 3), buffer.reshape(size)


def _splat_radius(column: np.ndarray, row: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(N,) half the mean distance of the points around each one and half a pixel, in pixels, from their number in 8 x 8
    pixel cells."""
    cell = (row >> 3).astype(np.int64) * ((size[1] >> 3) + 1) + (column >> 3)
    cells = ((size[0] >> 3) + 1, (size[1] >> 3) + 1)
    count = np.bincount(cell, minlength=cells[0] * cells[1]).reshape(cells).astype(np.float32)
    drawn = (count > 0).astype(np.float32)
    smooth = cv2.blur(count, (3, 3)) / np.maximum(cv2.blur(drawn, (3, 3)), 1e-6)
    return np.minimum(0.5 + 1.25 * np.sqrt(64 / np.maximum(smooth.ravel()[cell], 1.0)), _MAX_RADIUS_PX)


def _shaded(picture: np.ndarray, buffer: np.ndarray) -> np.ndarray:
    """Eye-dome lighting: a pixel is darkened by how far it lies behind the mean of opposite neighbours.

    Means of opposite pixels leave plain slopes alone, which the drawing is full of.
    """
    padded = np.pad(buffer, 2, mode="edge")
    h, w = buffer.shape
    shade = np.zeros(buffer.shape, np.float32)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)):
        a = padded[2 + dy : 2 + dy + h, 2 + dx : 2 + dx + w]
        b = padded[2 - dy : 2 - dy + h, 2 - dx : 2 - dx + w]
        with np.errstate(invalid="ignore"):
            ahead = buffer - (a + b) / 2
        shade += np.clip(np.nan_to_num(ahead, nan=0.0, posinf=0.0, neginf=0.0) - _EDL_DEAD_PX, 0, _EDL_CLIP_PX)
    light = np.exp(-_EDL_STRENGTH * shade / (6 * _EDL_CLIP_PX))[..., None]
    return np.where(np.isfinite(buffer)[..., None], picture * light, picture).astype(np.uint8)


def brightened(rgb: np.ndarray) -> np.ndarray:
    """Colours (N, 3) u1 stretched so that the brightest 2 % are white, at most 1.7 times."""
    top = float(np.quantile(rgb.max(axis=1), 0.98)) if len(rgb) else 255.0
    return np.clip(rgb * min(1.7, 250 / max(top, 1.0)), 0, 255).astype(np.uint8)


def with_scale_bar(view: CloudView, unit: str) -> np.ndarray:
    """The picture with a scale bar at its lower left."""
    picture = view.rgb.copy()
    length = round_below(0.14 * picture.shape[1] / view.px_per_m)
    x, y, size = 18, picture.shape[0] - 18, round(length * view.px_per_m)
    unit = unit if unit.isascii() else "units"  # the font of the picture has no other letters
    label, font = f"{length:g} {unit.removesuffix('s') if length == 1 else unit}", cv2.FONT_HERSHEY_SIMPLEX
    (wide, tall), _ = cv2.getTextSize(label, font, 0.6, 2)
    cv2.rectangle(picture, (x - 10, y - 18 - tall), (x + 10 + max(wide, size), y + 8), (255, 255, 255), cv2.FILLED)
    cv2.line(picture, (x, y), (x + size, y), (30, 30, 30), 2)
    cv2.putText(picture, label, (x, y - 10), font, 0.6, (30, 30, 30), 2, cv2.LINE_AA)
    return picture


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
