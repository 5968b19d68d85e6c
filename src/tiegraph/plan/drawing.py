"""Pictures of a plan: the curves of a sweep, and the path from above and from the side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tiegraph.plan.figures import Station
from tiegraph.plan.places import PathPlan
from tiegraph.scene.figures import plain_text, png
from tiegraph.scene.sorting import evenly

_DPI = 130
_POINT, _INK = "#b8c0c8", "#2a3138"
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # Okabe and Ito 2008


@plain_text()
def sweep_picture(groups: Sequence[tuple[str, Sequence[Station]]], wanted_m: float | None) -> bytes:
    """PNG: precision of a depth and points per area by the distance, a curve for each group (name, its stations)."""
    figure = Figure(figsize=(9.0, 3.8), dpi=_DPI, layout="constrained")
    left, right = figure.subplots(1, 2)
    for k, (name, stations) in enumerate(groups):
        distance = [s.distance_m for s in stations]
        colour = _COLOURS[k % len(_COLOURS)]
        for rays, style in ((0, "o-"), (1, "s--")):
            deep = [1000 * s.precision_m[rays] if len(s.precision_m) > rays else np.nan for s in stations]
            left.plot(distance, deep, style, color=colour, ms=4, lw=1.4, label=f"{name}{rays + 2} rays")
        right.plot(
            distance, [s.points_mm2 for s in stations], "o-", color=colour, ms=4, lw=1.4, label=name.rstrip(", ")
        )
    if wanted_m is not None:
        left.axhline(1000 * wanted_m, color=_INK, lw=1, ls=":", label="wanted")
    left.set_ylabel("sigma of a depth, mm")
    right.set_ylabel("points per mm²")
    for axes in (left, right):
        axes.set_xlabel("distance, m")
        axes.set_ylim(bottom=0)
        axes.grid(color="#e4e7eb")
    left.legend(frameon=False, fontsize=8)
    return png(figure)


@plain_text()
def path_picture(plan: PathPlan) -> bytes:
    """PNG: from above and from the side, frames coloured by their sigma, viewing directions, points, fixes."""
    e = plan.expected
    sigma, what = (e.world, "in the world") if plan.known.placed else (e.shape, "in shape")
    centres = plan.path.centres
    points = np.array([p.xyz for p in plan.network.model.points3D.values()])
    fixes = np.array([f.place for f in plan.known.fixes]).reshape(-1, 3)
    figure = Figure(figsize=(9.0, 7.2), dpi=_DPI, layout="constrained")
    top, side = figure.subplots(2, 1)
    for axes, (a, b), names in ((top, (0, 1), ("x, m", "y, m")), (side, (0, 2), ("x, m", "z, m"))):
        axes.plot(points[:, a], points[:, b], ".", ms=1.5, color=_POINT, zorder=1)
        _rays(axes, plan, (a, b))
        for leg in range(len(plan.path.legs)):
            own = plan.path.leg == leg
            axes.plot(centres[own, a], centres[own, b], "-", lw=0.8, color=_INK, zorder=2)
        if len(fixes):
            axes.plot(fixes[:, a], fixes[:, b], "+", ms=6, color="#009e73", zorder=3, label="fixes")
        shown = axes.scatter(
            centres[e.frames, a], centres[e.frames, b], c=1000 * sigma, s=16, cmap="plasma_r", vmin=0, zorder=4
        )  # colours from nought: what hardly differs looks alike
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel=names[0], ylabel=names[1])
        axes.grid(color="#e4e7eb")
    figure.colorbar(shown, ax=[top, side], shrink=0.7, label=f"sigma of the position {what}, mm")
    top.set_title("from above", loc="left", fontsize=10)
    side.set_title("from the side", loc="left", fontsize=10)
    return png(figure)


def _rays(axes: Axes, plan: PathPlan, of: tuple[int, int]) -> None:
    """The viewing directions of a few frames' cameras."""
    reach = 0.05 * float(np.linalg.norm(np.ptp(plan.path.centres, axis=0)))
    some = evenly(len(plan.path), 12)
    for pose in plan.path.world_from_body[some]:
        for camera in plan.cameras:
            way = reach * pose[:3, :3] @ camera.sensor_from_body[2, :3]
            start, end = pose[:3, 3], pose[:3, 3] + way
            axes.plot([start[of[0]], end[of[0]]], [start[of[1]], end[of[1]]], "-", lw=0.5, color="#6b7280", zorder=2)
