"""Offset surfaces: how much the frames of two passes share, with the kept region and the chosen path."""

import os.path
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tiegraph.network.offsets.surface import OffsetSurface
from tiegraph.network.plots.common import DPI, RED, edges_of
from tiegraph.scene.figures import png

MAX_PAIRS = 8  # couples of passes in one picture
_SMALL = 12  # panels of camera pairs beside the rig's
_UNSEEN = "#eeeeee"
_LONG = 19  # characters that fit above a small panel
_BAND_IN = 3.5  # height of a couple


def surfaces_png(surfaces: Sequence[OffsetSurface]) -> bytes:
    """One band a couple of passes: left the rig's surface, beside it the strongest camera pairs."""
    couples = list(dict.fromkeys((s.pass_a, s.pass_b) for s in surfaces))
    by_couple = {c: [s for s in surfaces if (s.pass_a, s.pass_b) == c] for c in couples}
    shown = sorted(couples, key=lambda c: -_weight(by_couple[c][0]))[:MAX_PAIRS]
    shown = [c for c in couples if c in shown]
    height = 0.75 + _BAND_IN * len(shown) + 0.15
    figure = Figure(figsize=(13, height), dpi=DPI)
    for k, couple in enumerate(shown):
        _band(figure, by_couple[couple], 1 - (0.75 + _BAND_IN * k) / height, _BAND_IN / height)
    text = "What the frames of two passes share: preview matches above chance, smoothed over neighbouring frames"
    more = f" ({len(couples) - len(shown)} weaker couples of passes not shown)" if len(couples) > len(shown) else ""
    figure.text(0.03, 1 - 0.3 / height, text + more, fontsize=12)
    key = (
        "black line: border of what is kept; red: path the rig follows from frame to frame; grey: not looked at; "
        "blue: from none to the most of the rig (left) and of its best camera pair (right)"
    )
    figure.text(0.03, 1 - 0.53 / height, key, fontsize=9, color="#555555")
    return png(figure)


def _weight(surface: OffsetSurface) -> float:
    return float(np.nansum(np.where(surface.kept, surface.evidence, 0)))


def _band(figure: Figure, surfaces: Sequence[OffsetSurface], top: float, height: float) -> None:
    inch = height / _BAND_IN
    a, b = surfaces[0].pass_a, surfaces[0].pass_b
    title = f"pass {a} with itself" if a == b else f"passes {a} and {b}"
    figure.text(0.03, top - 0.2 * inch, title, fontsize=11, weight="bold")
    bottom = top - height
    large = figure.add_axes((0.055, bottom + 0.5 * inch, 0.2, 2.55 * inch))
    _draw(large, surfaces[0], float(np.nanmax(surfaces[0].evidence, initial=1)), 1.4)
    large.set_title("whole rig (all camera pairs)" if len(surfaces) > 1 else "", fontsize=9, pad=3)
    large.set_xlabel(f"frame in {b}", fontsize=9)
    large.set_ylabel(f"frame in {a}", fontsize=9)
    large.tick_params(labelsize=8, length=2)
    most = max((float(np.nanmax(s.evidence, initial=1)) for s in surfaces[1:]), default=1.0)
    ending = _ending([name for s in surfaces[1:] for name in s.sensors.split(" – ")])
    for k, surface in enumerate(surfaces[1 : 1 + _SMALL]):
        row, column = divmod(k, 6)
        left, low = 0.3 + 0.115 * column, bottom + (1.93 - 1.43 * row) * inch
        small = figure.add_axes((left, low, 0.095, 1.12 * inch))
        _draw(small, surface, most, 0.7)
        label = surface.sensors.replace(ending, "") if len(surface.sensors) > _LONG else surface.sensors
        small.set_title(label, fontsize=min(8.0, 8.0 * _LONG / len(label)), pad=2)
        small.tick_params(labelsize=6, length=1.5, pad=1)


def _ending(names: Sequence[str]) -> str:
    """What all names end with, as in left_camera and right_camera; a name of its own stays whole."""
    end = os.path.commonprefix([name[::-1] for name in names])[::-1]
    return end if end and all(len(name) > len(end) for name in names) else "\n"


def _draw(axes: Axes, s: OffsetSurface, most: float, line: float) -> None:
    axes.set_facecolor(_UNSEEN)
    shown = np.ma.masked_invalid(s.evidence)
    axes.pcolormesh(edges_of(s.columns), edges_of(s.rows), shown, cmap="Blues", vmin=0, vmax=most)
    if min(s.kept.shape) > 1 and s.kept.any() and not s.kept.all():
        axes.contour(s.columns, s.rows, s.kept.astype(float), levels=[0.5], colors="#222222", linewidths=0.7)
    axes.plot(s.path, s.rows, color=RED, lw=line)
    across, down = edges_of(s.columns), edges_of(s.rows)
    axes.set_xlim(float(across[0]), float(across[-1]))
    axes.set_ylim(float(down[-1]), float(down[0]))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=4, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(nbins=4, integer=True))
