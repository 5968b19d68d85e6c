"""Residual vectors of a camera: the mean in every cell of its image, much enlarged, over the corners that were seen."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from tiegraph.calibrate.adjust import Adjusted
from tiegraph.calibrate.state import view_residuals
from tiegraph.calibrate.tuning import JudgeTuning
from tiegraph.scene.figures import plain_text, png

_DPI = 110
_LONGEST = 0.8  # of a cell: the longest mean vector


@plain_text()
def residual_picture(done: Adjusted, camera: int, tuning: JudgeTuning) -> bytes:
    """PNG of one camera."""
    images = done.seen.cameras[camera]
    own = [k for k, view in enumerate(done.seen.views) if view.camera == camera]
    xy = np.concatenate([done.seen.views[k].xy for k in own])
    off = np.concatenate([r for k, r in enumerate(view_residuals(done.seen, done.state)) if k in own])
    side = max(images.size) / tuning.cells
    at, mean = _by_cell(xy, off, side, tuning.cell_corners)
    longest = max(float(np.hypot(*mean.T).max()), 1e-9)
    width, height = images.size
    figure = Figure(figsize=(7.0, 0.6 + 6.4 * height / width), dpi=_DPI, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(*xy.T, ".", ms=2, color="#c9d1d9")
    scale = longest / (_LONGEST * side)
    arrows = axes.quiver(*at.T, *mean.T, angles="xy", scale_units="xy", scale=scale, color="#1b6ca8", width=0.004)
    rounded = float(f"{longest:.1g}")
    axes.quiverkey(arrows, 0.9, 1.03, rounded, f"{rounded:g} px", labelpos="W")
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    axes.set_title(f"{images.name}: mean residuals, seen minus adjusted", loc="left", fontsize=10)
    return png(figure)


def _by_cell(xy: np.ndarray, off: np.ndarray, side: float, least: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean places (C, 2) of the corners in each cell that holds so many, and their mean residuals (C, 2)."""
    good = np.isfinite(off).all(axis=1)
    _, number = np.unique(np.floor(xy[good] / side), axis=0, return_inverse=True)
    count = np.bincount(number.ravel())
    columns = np.hstack([xy[good], off[good]]).T
    means = np.stack([np.bincount(number.ravel(), column) / count for column in columns], axis=1)
    means = means[count >= min(least, count.max())]
    return means[:, :2], means[:, 2:]
