"""The map of the surface from above: cells by verdict, the path, and the places to go to again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from tiegraph.design.surface import VERDICTS, SurfaceMap, WeakPlace
from tiegraph.geometry import transforms
from tiegraph.geometry.levelled import levelled
from tiegraph.scene.figures import plain_text, png

COLOURS = ("#4c9a6a", "#b3261e", "#d9822b", "#c4a000", "#8e5ea2")  # of VERDICTS
_INK, _DPI = "#444444", 110
_INSIDE = (1.0, 99.0)  # percentiles of the cells that the picture shows


@plain_text()
def surface_png(
    surface: SurfaceMap, places: Sequence[WeakPlace], cam_from_world: np.ndarray, frame: np.ndarray
) -> bytes:
    """PNG of the map; cam_from_world (N, 4, 4) of the images, NaN = no pose, and the frame (N,) of each."""
    plan = levelled(cam_from_world, frame)
    cells = transforms.apply(plan, surface.xyz)
    path = transforms.apply(plan, transforms.centre(cam_from_world))
    figure = Figure(figsize=(11.0, 6.0), dpi=_DPI, layout="constrained")
    axes = figure.add_subplot(aspect="equal")
    shares = surface.shares()
    for k in np.argsort(np.arange(len(VERDICTS)) > 0, kind="stable"):
        own = cells[surface.verdict == k]
        label = f"{VERDICTS[k]} {shares[VERDICTS[k]]:.0f} %"
        axes.scatter(own[:, 0], own[:, 1], s=9, marker="s", color=COLOURS[k], alpha=0.4 if k == 0 else 0.8, label=label)
    axes.plot(path[:, 0], path[:, 1], ".", color="#1b4f8a", markersize=4, label="images")
    for number, place in enumerate(places[:20]):
        x, y, _ = transforms.apply(plan, place.xyz[None])[0]
        box = {"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": COLOURS[place.verdict]}
        axes.text(x, y, str(number + 1), ha="center", va="center", fontsize=8, bbox=box, clip_on=True)
    shown = np.concatenate([np.percentile(cells[:, :2], _INSIDE, axis=0), path[np.isfinite(path[:, 0]), :2]])
    low, high = shown.min(axis=0), shown.max(axis=0)
    edge = 0.05 * float((high - low).max())
    axes.set_xlim(low[0] - edge, high[0] + edge)
    axes.set_ylim(low[1] - edge, high[1] + edge)
    axes.set_title("The surface from above: by how many images, from which angles, how precisely", fontsize=10,
                   loc="left", color=_INK)  # fmt: skip
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
    return png(figure)
