"""Pictures of the network as PNG: offset curves, sections and the cues of the up camera along the passes, and the map.
The report draws the correspondence matrix (report/network.py)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogFormatter, MaxNLocator

from tiegraph.network.map import BLUE, DPI, INK, RED, map_png, weak_pairs
from tiegraph.network.offsets import OffsetCurve
from tiegraph.network.sections import Cue, Section
from tiegraph.scene.results import png
from tiegraph.scene.scene import Scene

__all__ = ["curves_png", "map_png", "sections_png", "weak_pairs"]
MAX_PANELS = 60
_PANEL_IN = 2.2


def curves_png(curves: Sequence[OffsetCurve]) -> bytes:
    """Votes against frame offset, one panel for each camera pair (papers 000, 001)."""
    curves = list(curves)
    hidden = max(0, len(curves) - MAX_PANELS)
    # Of too many curves, those with the most votes are shown.
    by_votes = sorted(range(len(curves)), key=lambda k: -float(curves[k].votes.max(initial=0)))
    curves = [curves[k] for k in sorted(by_votes[:MAX_PANELS])]
    groups = list(dict.fromkeys((c.pass_a, c.pass_b) for c in curves))
    members = {g: [c for c in curves if (c.pass_a, c.pass_b) == g] for g in groups}
    columns = 6
    lines = {g: -(-len(m) // columns) for g, m in members.items()}
    heights = [x for g in groups for x in (0.42, *([1.25] * lines[g]))]
    figure = Figure(figsize=(12, sum(heights) + 0.9), dpi=DPI)
    top = max((float(c.votes.max(initial=0)) for c in curves), default=1.0)
    grid = figure.add_gridspec(
        len(heights), columns, height_ratios=heights, hspace=0.95, wspace=0.14,
        left=0.055, right=0.985, top=1 - 0.62 / (sum(heights) + 0.9), bottom=0.45 / (sum(heights) + 0.9),
    )  # fmt: skip
    row = 0
    for g in groups:
        head = figure.add_subplot(grid[row, :])
        head.axis("off")
        head.text(0, 0.1, _group_title(g, members[g]), fontsize=11, weight="bold")
        for k, curve in enumerate(members[g]):
            axes = figure.add_subplot(grid[row + 1 + k // columns, k % columns])
            _draw_curve(axes, curve, top, left=k % columns == 0)
        row += 1 + lines[g]
    text = "Preview matches above chance against frame offset (blue: candidates, grey: camera pair rejected)"
    more = f"; {hidden} weaker camera pairs not shown" if hidden else ""
    figure.text(0.055, 1 - 0.32 / (sum(heights) + 0.9), text + more, fontsize=12)
    return png(figure)


def _group_title(group: tuple[str, str], curves: Sequence[OffsetCurve]) -> str:
    if group[0] == group[1]:
        return f"pass {group[0]}: frame of the second camera minus frame of the first"
    kind = "plus" if curves[0].reversed else "minus"
    way = "runs back" if curves[0].reversed else "same way"
    return f"passes {group[0]} and {group[1]} ({way}): frame in {group[1]} {kind} frame in {group[0]}"


def _draw_curve(axes: Axes, curve: OffsetCurve, top: float, left: bool) -> None:
    colour = "#1b6ca8" if curve.accepted else "#9a9a9a"
    axes.fill_between(curve.offsets, curve.votes, color=colour, alpha=0.25, lw=0)
    axes.plot(curve.offsets, curve.votes, color=colour, lw=1.2)
    if curve.accepted:
        axes.axvline(curve.best, color="#c0392b", lw=0.8)
    best = f" ({curve.best:+d})" if curve.accepted else " (rejected)"
    axes.set_title(f"{curve.sensor_a} \N{EN DASH} {curve.sensor_b}{best}", fontsize=8, pad=2)
    axes.set_yscale("function", functions=(lambda v: np.sqrt(np.maximum(v, 0)), np.square))  # faint peaks stay visible
    axes.set_ylim(0, top * 1.05)
    axes.set_yticks([v for v in (0, 5, 20, 50, 100, 200, 500, 1000) if v <= top])
    axes.tick_params(labelsize=7, length=2)
    if not left:
        axes.set_yticklabels([])
    axes.spines[["top", "right"]].set_visible(False)


def sections_png(scene: Scene, sections: Sequence[Section], cues: Sequence[Cue]) -> bytes:
    """One panel for each cue: its values by frame, the threshold of each pass, the sections as coloured bands."""
    frames = np.lexsort((scene.sequence_index, scene.sequence))
    frames = frames[np.any([np.isfinite(c.values[frames]) for c in cues], axis=0)]
    height = 0.7 + _PANEL_IN * len(cues) + 0.5
    figure = Figure(figsize=(10, height), dpi=DPI)
    panel: Axes | None = None
    for k, cue in enumerate(cues):
        bottom = (0.5 + _PANEL_IN * (len(cues) - 1 - k) + 0.1) / height
        panel = figure.add_axes((0.075, bottom, 0.91, (_PANEL_IN - 0.3) / height))
        _bands(panel, scene, sections, frames, named=k == 0)
        _values(panel, scene, cue, frames)
        _ticks(panel, scene, frames, last=k == len(cues) - 1)
    if panel is not None:
        panel.set_xlabel("frame of the pass", fontsize=9)
    figure.text(0.03, 1 - 0.28 / height, "Bridge and open sections by the up camera", fontsize=12)
    key = "brown: bridge; blue: open sky; dashed: threshold of the pass (none: the cue was not used)"
    figure.text(0.03, 1 - 0.5 / height, key, fontsize=8.5, color="#555555")
    return png(figure)


def _bands(axes: Axes, scene: Scene, sections: Sequence[Section], frames: np.ndarray, named: bool) -> None:
    of_frame, sequence = scene.section[frames], scene.sequence[frames]
    edges = np.r_[0, 1 + np.flatnonzero((np.diff(of_frame) != 0) | (np.diff(sequence) != 0)), len(frames)]
    for a, b in zip(edges[:-1], edges[1:]):
        section = sections[of_frame[a]] if 0 <= of_frame[a] < len(sections) else None
        dark = section is not None and section.kind == "bridge"
        axes.axvspan(a - 0.5, b - 0.5, color="#dccfbf" if dark else "#e8f1f8", lw=0)
        if named and section is not None and b - a >= max(2, 0.03 * len(frames)):
            axes.text((a + b - 1) / 2, 1.02, section.name, transform=axes.get_xaxis_transform(), ha="center",
                      fontsize=8, color=INK)  # fmt: skip
    for e in 1 + np.flatnonzero(np.diff(sequence)):
        axes.axvline(e - 0.5, color=INK, lw=1.2)


def _values(axes: Axes, scene: Scene, cue: Cue, frames: np.ndarray) -> None:
    place, values = np.arange(len(frames)), cue.values[frames]
    axes.set_xlim(-0.5, len(frames) - 0.5)
    axes.set_ylabel(cue.name + (", grey value" if "255" in cue.unit else ""), fontsize=8.5)
    if "255" in cue.unit:
        axes.set_ylim(0, 255)
    elif np.nanmax(values, initial=0) <= 1 and np.nanmin(values, initial=1) >= 0 and not cue.unit:
        axes.set_ylim(0, 1.05)
    else:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(LogFormatter())  # matplotlib's own writes formulas
        axes.yaxis.set_minor_formatter(LogFormatter())
    for sequence in np.unique(scene.sequence[frames]):
        own = np.flatnonzero(scene.sequence[frames] == sequence)
        size = 3.0 if len(frames) < 400 else 1.2
        axes.plot(place[own], values[own], "o-", ms=size, lw=1.1, color=BLUE)
        threshold = float(cue.threshold[frames[own[0]]])
        if np.isfinite(threshold):
            axes.plot([own[0] - 0.5, own[-1] + 0.5], [threshold] * 2, color=RED, lw=1, ls="--")
            axes.annotate(f"{threshold:.3g}", (own[-1] + 0.4, threshold), (0, 2), textcoords="offset points",
                          ha="right", fontsize=8, color=RED)  # fmt: skip
    axes.tick_params(labelsize=8)


def _ticks(axes: Axes, scene: Scene, frames: np.ndarray, last: bool) -> None:
    """Whole numbers of frames, counted separately in every pass; the passes' names inside the lowest panel."""
    sequence = scene.sequence[frames]
    start = np.array([int(np.argmax(sequence == t)) for t in sequence]) if len(frames) else np.zeros(0, int)

    def rank(value: float, _: int | None = None) -> str:
        k = round(value)
        return str(k - int(start[k])) if 0 <= k < len(frames) and abs(value - k) < 1e-6 else ""

    starts = np.unique(start)
    if len(starts) > 1:
        most = max(1, 14 // len(starts))
        steps = [s for s in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000) if s * most >= len(frames) / len(starts)]
        step = steps[0] if steps else 2000
        ends = np.r_[starts[1:], len(frames)]
        axes.set_xticks(np.concatenate([np.arange(a, b, step) for a, b in zip(starts, ends)]))
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.xaxis.set_major_formatter(FuncFormatter(rank))
    if not last:
        axes.tick_params(labelbottom=False)
        return
    for t in np.unique(sequence):
        name = f"pass {scene.sequences[t]}" if 0 <= t < len(scene.sequences) else "loose"
        axes.annotate(name, (float(np.flatnonzero(sequence == t)[0]) - 0.3, 0), (2, 3), textcoords="offset points",
                      xycoords=("data", "axes fraction"), fontsize=9, color=INK)  # fmt: skip
