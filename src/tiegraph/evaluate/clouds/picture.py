"""The map of differences between two clouds: a grid of their medians in plan, with a scale bar, as PNG bytes."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tiegraph.evaluate.clouds.m3c2 import Differences
from tiegraph.scene.figures import png
from tiegraph.scene.sorting import order_of, row_numbers, run_starts
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
        edge = max(float(np.ptp(xyz[:, :2], axis=0).max()) / _CELLS, found.cylinders.cores_m)
        extent: Any = tuple(_extent(xyz, edge))
        limit = float(np.percentile(np.abs(value), 95)) or 1e-3
        if only_significant:
            loud = found.significant[found.known]
            axes.imshow(np.where(np.isnan(_grid(xyz, value, edge)), np.nan, 0.85), cmap="gray", vmin=0, vmax=1,
                        origin="lower", extent=extent, interpolation="nearest")  # fmt: skip
            limit = float(np.percentile(np.abs(value[loud]), 95)) if loud.any() else limit
            value = np.where(loud, value, np.nan)
        grid = _grid(xyz, value, edge)
        shown = axes.imshow(grid, cmap="coolwarm", vmin=-limit, vmax=limit, origin="lower", extent=extent,
                            interpolation="nearest")  # fmt: skip
        figure.colorbar(
            shown, ax=axes, shrink=0.6, location="bottom", extend="both", label="difference along the normal, m"
        )
        _scale_bar(axes, extent)
        axes.text(0.01, 0.99, "N \u2191", transform=axes.transAxes, va="top", fontsize=11)
    else:
        axes.text(0.5, 0.5, "nothing could be compared", transform=axes.transAxes, ha="center")
    axes.set(xticks=[], yticks=[], aspect="equal")
    return png(figure)


def _extent(xyz: np.ndarray, edge: float) -> np.ndarray:
    """(4,) left, right, low, high of the grid."""
    low = xyz[:, :2].min(axis=0)
    size = np.floor((xyz[:, :2].max(axis=0) - low) / edge) + 1
    return np.column_stack([low, low + size * edge]).ravel()


def _grid(xyz: np.ndarray, value: np.ndarray, edge: float) -> np.ndarray:
    """(Y, X) median by cell, NaN without a value."""
    at = np.floor((xyz[:, :2] - xyz[:, :2].min(axis=0)) / edge).astype(np.int64)
    out = np.full((at[:, 1].max() + 1, at[:, 0].max() + 1), np.nan)
    there = np.isfinite(value)
    if there.any():
        at, value = at[there], value[there]
        order = order_of(row_numbers(at.T))
        begin = run_starts(row_numbers(at[order].T))
        for rows in np.split(order, begin[1:]):
            out[at[rows[0], 1], at[rows[0], 0]] = np.median(value[rows])
    return out


def _scale_bar(axes, extent: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    left, right, low, high = extent
    length, y = round_below((right - left) / 4), low - 0.04 * (high - low)
    axes.plot([left, left + length], [y, y], color="#444444", linewidth=3, solid_capstyle="butt", clip_on=False)
    axes.text(left + length / 2, y - 0.015 * (high - low), f"{length:g} m", ha="center", va="top", fontsize=9)
    axes.set_ylim(low - 0.1 * (high - low), high)
