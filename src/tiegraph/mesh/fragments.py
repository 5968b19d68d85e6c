"""Triangles drawn into a raster: the pixels of each, and where in it they lie."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

_AT_ONCE = 4_000_000  # pixels that are looked at together: bounds the memory to some 300 MB


@dataclass(frozen=True, eq=False)
class Fragments:
    """Pixels of triangles: triangle (N,), row (N,), column (N,), and the weights (N, 3) of the triangle's corners at
    the pixel's middle."""

    triangle: np.ndarray
    row: np.ndarray
    column: np.ndarray
    weight: np.ndarray


def fragments(xy: np.ndarray, shape: tuple[int, int], slack: float = 0.0) -> Iterator[Fragments]:
    """The pixels whose middles lie in triangles (T, 3, 2), whose corners are in pixels (0, 0 = the corner of the first
    pixel), of a raster of ``shape`` (rows, columns); a few million at a time. ``slack``: how far outside, as a weight,
    a middle may lie."""
    low = np.clip(np.ceil(xy.min(axis=1) - 0.5 - slack), 0, None).astype(np.int64)
    high = np.floor(xy.max(axis=1) - 0.5 + slack).astype(np.int64)
    high = np.minimum(high, np.array(shape[::-1]) - 1)
    size = np.maximum(high - low + 1, 0)
    count = size[:, 0] * size[:, 1]
    ends = np.cumsum(count)
    start = 0
    while start < len(xy):
        done = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, done + _AT_ONCE, "right")), start + 1)
        found = _of(xy, slice(start, stop), low, size, slack)
        if len(found.triangle):
            yield found
        start = stop


def _of(xy: np.ndarray, part: slice, low: np.ndarray, size: np.ndarray, slack: float) -> Fragments:
    """The pixels of some of the triangles."""
    wide = size[part, 0]
    count = wide * size[part, 1]
    triangle = np.repeat(np.arange(len(count)), count)
    k = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    down, right = np.divmod(k, wide[triangle])
    column, row = low[part, 0][triangle] + right, low[part, 1][triangle] + down
    weight = _weights(xy[part], triangle, column + 0.5, row + 0.5)
    inside = (weight >= -slack).all(axis=1)
    return Fragments(part.start + triangle[inside], row=row[inside], column=column[inside], weight=weight[inside])


def _weights(xy: np.ndarray, triangle: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Barycentric weights (N, 3) of places; NaN in a triangle without an area."""
    a, b, c = xy[:, 0], xy[:, 1], xy[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        dx, dy = x - a[triangle, 0], y - a[triangle, 1]
        second = (dx * (c[:, 1] - a[:, 1])[triangle] - dy * (c[:, 0] - a[:, 0])[triangle]) / area[triangle]
        third = (dy * (b[:, 0] - a[:, 0])[triangle] - dx * (b[:, 1] - a[:, 1])[triangle]) / area[triangle]
    return np.stack([1 - second - third, second, third], axis=1)
