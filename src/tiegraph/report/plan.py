"""The map of the survey: where the cameras went, which frames are missing, and where the GNSS said they were."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib
import numpy as np

from tiegraph.report.charts import ALERT, PASSES, STYLE, figure_axes, saved
from tiegraph.scene.places import between_neighbours
from tiegraph.scene.scene import Scene

_BACKDROP = 60_000


@dataclass(frozen=True)
class Track:
    """A pass on the map: name, positions (T, 3) of its frames in order (NaN = not registered), and where the missing
    ones probably are (M, 3)."""

    name: str
    positions: np.ndarray
    missing: np.ndarray


def frame_positions(scene: Scene, centres: np.ndarray) -> np.ndarray:
    """(F, 3) mean of the registered projection centres (N, 3) of each frame, NaN where none is registered."""
    seen = np.isfinite(centres).all(axis=1)
    count = np.bincount(scene.frame[seen], minlength=scene.frames)
    sums = [np.bincount(scene.frame[seen], weights=centres[seen, c], minlength=scene.frames) for c in range(3)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack(sums, axis=1) / np.where(count > 0, count, np.nan)[:, None]


def tracks(scene: Scene, positions: np.ndarray) -> list[Track]:
    """The passes with the places of their missing frames, interpolated along the pass or taken from the prior."""
    between = between_neighbours(positions, scene)
    guess = np.where(np.isfinite(between), between, scene.world_from_rig[:, :3, 3])
    out = []
    for t in [*range(len(scene.sequences)), -1]:
        frames = np.flatnonzero(scene.sequence == t)
        if not len(frames):
            continue
        frames = frames[np.argsort(scene.sequence_index[frames], kind="stable")]
        at = positions[frames]
        missing = guess[frames][~np.isfinite(at[:, 0]) & np.isfinite(guess[frames, 0])]
        out.append(Track(scene.sequences[t] if t >= 0 else "images", at, missing))
    return out


def plan_chart(found: list[Track], gnss: np.ndarray, backdrop: np.ndarray, unit: str, axes: tuple[str, str]) -> str:
    """Plan view of the passes over a thinned cloud, with missing frames and GNSS positions (K, 3)."""
    with matplotlib.rc_context(STYLE):
        low, high = _extent(found, gnss)
        ratio = (high[1] - low[1]) / (high[0] - low[0])
        figure, (ax,) = figure_axes(float(np.clip(8.2 * ratio, 2.6, 8.0)) + 0.7)
        near = np.all((backdrop[:, :2] > low) & (backdrop[:, :2] < high), axis=1) if len(backdrop) else []
        if np.any(near):
            dots = backdrop[near][:: max(1, int(np.sum(near)) // _BACKDROP)]
            size = 0.9 if len(dots) > _BACKDROP / 3 else 2.2
            ax.plot(dots[:, 0], dots[:, 1], ".", ms=size, mew=0, color="#aab2bc", zorder=1)
        if len(gnss):
            ax.plot(gnss[:, 0], gnss[:, 1], "+", color="#6b7280", ms=6, mew=0.9, label="GNSS or prior", zorder=2)
        for k, track in enumerate(found):
            _draw_track(ax, track, PASSES[k % len(PASSES)])
        missing = np.concatenate([t.missing for t in found]) if found else np.zeros((0, 3))
        if len(missing):
            ax.plot(
                missing[:, 0], missing[:, 1], "x", color=ALERT, ms=6, mew=1.6, label="frame not registered", zorder=5
            )
        ax.set_xlim(low[0], high[0])
        ax.set_ylim(low[1], high[1])
        ax.set_aspect("equal")
        ax.set_xlabel(f"{axes[0]}, {unit}")
        ax.set_ylabel(f"{axes[1]}, {unit}")
        ax.ticklabel_format(useOffset=False, style="plain")
        ax.legend(frameon=False, ncols=5, loc="lower left", bbox_to_anchor=(0, 1.0), fontsize=9)
        return saved(figure, "png")


def _draw_track(ax: matplotlib.axes.Axes, track: Track, colour: str) -> None:
    ordered = track.name != "images"
    style = ".-" if ordered else "."
    ax.plot(track.positions[:, 0], track.positions[:, 1], style, color=colour, ms=5, lw=1.2, label=track.name, zorder=4)
    seen = track.positions[np.isfinite(track.positions[:, 0])]
    if ordered and len(seen) > 2:
        ax.annotate("start", seen[0, :2], xytext=(5, 5), textcoords="offset points", fontsize=8, color=colour, zorder=6)
        ax.annotate(
            "", seen[-1, :2], seen[-2, :2], arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.2}, zorder=5
        )


def _extent(found: list[Track], gnss: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    points = np.concatenate(
        [t.positions[:, :2] for t in found] + [t.missing[:, :2] for t in found] or [np.zeros((0, 2))]
    )
    points = points[np.isfinite(points[:, 0])]
    if not len(points):
        points = gnss[:, :2] if len(gnss) else np.zeros((1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float(np.max(high - low)), 1e-6)
    pad = 0.22 * size + np.maximum(0, 0.6 * size - (high - low)) / 2
    return low - pad, high + pad
