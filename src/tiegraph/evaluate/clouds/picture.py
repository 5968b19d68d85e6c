"""The map of differences between two clouds: a grid of their medians in plan, with a scale bar, as PNG bytes."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import ndimage

from tiegraph.evaluate.clouds.m3c2 import Differences
from tiegraph.scene.results import png
from tiegraph.text import round_below

_CELLS = 500  # along the longer side
_INCHES, _DPI = 8.0, 110


def difference_map(found: Differences, title: str, only_significant: bool = False) -> bytes:
    """Medians of the differences in plan, x to the right (east) and y up (north); grey: compared, but nothing
    significant (``only_significant``); white: nothing compared."""
    xyz, value = found.xyz[found.known], found.distance_m[found.known]
    wide, high = np.ptp(xyz[:, :2], axis=0) if len(xyz) else (1.0, 1.0)
    inches = (_INCHES, float(np.clip(_INCHES * high / max(wide, 1e-9), 2.0, 2 * _INCHES)) + 1.6)
    figure = Figure(figsize=inches, dpi=_DPI, layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(title, fontsize=11, loc="left")
    if len(xyz):
        edge, low = max(float(wide), float(high)) / _CELLS, xyz[:, :2].min(axis=0)
        at = np.floor((xyz[:, :2] - low) / max(edge, found.cylinders.cores_m)).astype(np.int64)
        size = at.max(axis=0) + 1
        extent = np.column_stack([low, low + size * max(edge, found.cylinders.cores_m)]).ravel().tolist()
        shown: dict[str, Any] = {"origin": "lower", "extent": extent, "interpolation": "nearest"}
        loud = found.significant[found.known] if only_significant else np.ones(len(xyz), bool)
        if only_significant:
            grey = np.where(np.isnan(_medians(at, value, size)), np.nan, 0.85)
            axes.imshow(grey, cmap="gray", vmin=0, vmax=1, **shown)
        limit = float(np.percentile(np.abs(value[loud] if loud.any() else value), 95)) or 1e-3
        drawn = axes.imshow(_medians(at[loud], value[loud], size), cmap="coolwarm", vmin=-limit, vmax=limit, **shown)
        label = "difference along the normal, m"
        figure.colorbar(drawn, ax=axes, shrink=0.6, location="bottom", extend="both", label=label)
        _scale_bar(axes, extent)
        axes.text(0.01, 0.99, "N \u2191", transform=axes.transAxes, va="top", fontsize=11)
    else:
        axes.text(0.5, 0.5, "nothing could be compared", transform=axes.transAxes, ha="center")
    axes.set(xticks=[], yticks=[], aspect="equal")
    return png(figure)


def _medians(at: np.ndarray, value: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(Y, X) median of the values (N,) in each cell x, y (N, 2), NaN without any."""
    cell = at[:, 1] * size[0] + at[:, 0]
    out, found = np.full(size[0] * size[1], np.nan), np.unique(cell)
    out[found] = ndimage.median(value, cell, found) if len(found) else []
    return out.reshape(size[1], size[0])


def _scale_bar(axes: Axes, extent: list[float]) -> None:
    left, right, low, high = extent
    length, y = round_below((right - left) / 4), low - 0.04 * (high - low)
    axes.plot([left, left + length], [y, y], color="#444444", linewidth=3, solid_capstyle="butt", clip_on=False)
    axes.text(left + length / 2, y - 0.015 * (high - low), f"{length:g} m", ha="center", va="top", fontsize=9)
    axes.set_ylim(low - 0.1 * (high - low), high)
