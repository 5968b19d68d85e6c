"""Charts of the report by matplotlib, as data URIs; readable at 900 pixels of width."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from tiegraph.report.thumbnails import data_uri
from tiegraph.scene.pairs import AFTER_MATCHING, REASON_LOOKS, REASONS, Pairs
from tiegraph.scene.scene import Scene

USED, VERIFIED, DROPPED, ALERT, INK = "#2b7a9b", "#0b4f6c", "#c9ced6", "#c8442b", "#2a3138"
# Okabe and Ito 2008: told apart by colour-blind readers too
PASSES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5c99", "#5b6770")
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8b949e",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.grid": True,
    "grid.color": "#e4e7eb",
    "axes.axisbelow": True,
    "svg.fonttype": "path",
    "svg.hashsalt": "tiegraph",
}
_WIDTH_IN = 9.0
_MATRIX_PX = 700


def figure_axes(
    height_in: float, columns: int = 1, width_ratios: Sequence[float] | None = None
) -> tuple[Figure, list[Axes]]:
    """A figure as wide as the page and its axes side by side."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
        FigureCanvasAgg(figure)
        made = figure.subplots(1, columns, squeeze=False, width_ratios=width_ratios)
    return figure, list(made[0])


def saved(figure: Figure, kind: str = "svg") -> str:
    """A figure as a data URI; "png" for many points."""
    out = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        options: dict = {"metadata": {"Date": None}} if kind == "svg" else {"dpi": 200}
        figure.savefig(out, format=kind, **options)
    return data_uri(out.getvalue(), "svg+xml" if kind == "svg" else "png")


def stage_times(rows: Sequence[tuple[str, float, float, float]]) -> str:
    """(stage, wall s, CPU s, peak MiB) as two panels of bars."""
    figure, (left, right) = figure_axes(0.9 + 0.36 * len(rows), 2, (1.7, 1))
    y = np.arange(len(rows))
    names, wall, cpu, peak = zip(*rows)
    unit, label = (60, "minutes") if max(*wall, *cpu) > 600 else (1, "seconds")
    left.barh(y - 0.19, np.array(wall) / unit, 0.36, color=USED, label="wall time")
    left.barh(y + 0.19, np.array(cpu) / unit, 0.36, color="#a9cbd8", label="CPU time")
    right.barh(y, np.array(peak) / 1024, 0.5, color="#8b949e")
    for ax, text in ((left, label), (right, "peak memory, GiB")):
        ax.set_yticks(y, names if ax is left else [""] * len(y))
        ax.invert_yaxis()
        ax.set_xlabel(text)
        ax.grid(axis="y", visible=False)
    left.legend(frameon=False, loc="best")
    return saved(figure)


def matrices(before: Pairs, after: Pairs, scene: Scene) -> str:
    """Correspondence matrices: every pair looked at and why it was dropped, and what the full resolution verified."""
    order, ticks, edges = image_order(scene)
    size = min(len(scene), _MATRIX_PX)
    figure, (left, right) = figure_axes(4.6, 2)
    matched = bool(np.any(after.inliers >= 0))
    _looked_at(left, _cells(before, order, size), before)
    left.set_title(f"Looked at: {_count(len(before))} pairs", fontsize=11, loc="left")
    kept = after.kept()
    if matched:
        verified = kept.where(kept.inliers > 0)
        values = np.full((size, size), np.nan)
        _fill(values, verified, _place(verified, order, size), verified.inliers.astype(float))
        norm = LogNorm(15, max(400, float(np.nanmax(values, initial=400))))
        shown = right.imshow(values, cmap="viridis_r", norm=norm, interpolation="nearest")
        bar = figure.colorbar(shown, ax=right, shrink=0.75, label="verified matches")
        marks = [m for m in (15, 30, 60, 100, 200, 400, 1000, 2000, 5000) if m <= float(norm.vmax or 0)]
        bar.set_ticks(marks, labels=[str(m) for m in marks])
        bar.minorticks_off()
        right.set_title(f"Verified: {_count(len(verified))} pairs", fontsize=11, loc="left")
    else:
        values = np.full((size, size), np.nan)
        _fill(values, kept, _place(kept, order, size), np.ones(len(kept)))
        right.imshow(values, cmap=ListedColormap([USED]), interpolation="nearest")
        right.set_title(f"To be matched: {_count(len(kept))} pairs", fontsize=11, loc="left")
    for ax in (left, right):
        _matrix_axes(ax, ticks, edges, size / max(len(scene), 1), ax is left)
    return saved(figure, "png")


def image_order(scene: Scene) -> tuple[np.ndarray, list[tuple[float, str]], list[int]]:
    """Rank (N,) of each image by pass, camera and step; (middle, label) of each block and the blocks' borders."""
    track = scene.sequence[scene.frame]
    sequence = np.lexsort((scene.sequence_index[scene.frame], scene.sensor_key, track))
    rank = np.empty(len(scene), int)
    rank[sequence] = np.arange(len(scene))
    labels = scene.image_label()
    names = [" ".join(labels[k]).strip() for k in sequence]
    starts = [0, *(k for k in range(1, len(names)) if names[k] != names[k - 1]), len(names)]
    ticks = [((a + b - 1) / 2, names[a]) for a, b in zip(starts[:-1], starts[1:])] if len(names) else []
    return rank, ticks, starts[1:-1]


def _cells(pairs: Pairs, order: np.ndarray, size: int) -> np.ndarray:
    """(size, size) class of each cell: NaN not looked at, else minus the index into REASONS; kept (0) wins."""
    values = np.full((size, size), np.nan)
    _fill(values, pairs, _place(pairs, order, size), -pairs.dropped.astype(float))
    return values


def _place(pairs: Pairs, order: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    return order[pairs.i] * size // max(len(order), 1), order[pairs.j] * size // max(len(order), 1)


def _fill(values: np.ndarray, pairs: Pairs, place: tuple[np.ndarray, np.ndarray], column: np.ndarray) -> None:
    rising = np.argsort(column, kind="stable")  # the largest is written last
    row, col = place[0][rising], place[1][rising]
    values[row, col] = values[col, row] = column[rising]


def _looked_at(ax: Axes, cells: np.ndarray, pairs: Pairs) -> None:
    colours = ListedColormap([REASON_LOOKS[r][1] for r in REASONS])
    ax.imshow(-cells, cmap=colours, vmin=-0.5, vmax=len(REASONS) - 0.5, interpolation="nearest")
    present = [REASONS[k] for k in np.unique(pairs.dropped)]
    looks = [REASON_LOOKS[r] for r in present]
    handles = [Patch(facecolor=colour, edgecolor="#b6bec7", lw=0.5, label=text) for text, colour in looks]
    ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(0, -0.02), ncols=2, frameon=False, fontsize=8)


def _matrix_axes(ax: Axes, ticks: list[tuple[float, str]], edges: list[int], zoom: float, named: bool) -> None:
    ax.grid(visible=False)
    for edge in edges:
        ax.axhline(edge * zoom - 0.5, color="#9aa3ad", lw=0.4)
        ax.axvline(edge * zoom - 0.5, color="#9aa3ad", lw=0.4)
    shown = ticks if len(ticks) <= 24 else []
    ax.set_xticks([])
    ax.set_yticks([t * zoom for t, _ in shown] if named else [], [n for _, n in shown] if named else [], fontsize=8)
    for spine in ax.spines.values():
        spine.set_visible(True)


def funnel_rows(pairs: Pairs, network: Pairs | None) -> list[tuple[str, int, str]]:
    """(what, pairs, colour) from all candidates to the verified ones, in the order of the filters."""
    funnel = pairs.funnel()
    start = max(len(network) if network is not None else 0, funnel["candidates"])
    rows = [("candidates", start, "#8b949e")]
    gone = {k: v for k, v in funnel.items() if k not in ("candidates", "used", *AFTER_MATCHING)}
    if network is not None and len(network) > len(pairs):
        rows.append(("dropped: in the network", len(network) - len(pairs), DROPPED))
    rows += [(f"dropped: {REASON_LOOKS[k][0]}", v, REASON_LOOKS[k][1]) for k, v in gone.items()]
    matched = bool(np.any(pairs.inliers >= 0))
    if not matched:
        return [*rows, ("pairs to match", funnel["used"], USED)]
    lost = sum(funnel.get(reason, 0) for reason in AFTER_MATCHING)
    verified = int(np.sum((pairs.dropped == 0) & (pairs.inliers > 0)))
    rows.append(("matched at full resolution", funnel["used"] + lost, USED))
    rows += [(f"dropped: {REASON_LOOKS[k][0]}", funnel[k], REASON_LOOKS[k][1]) for k in AFTER_MATCHING if k in funnel]
    return [*rows, ("verified", verified, VERIFIED)]


def is_loss(name: str) -> bool:
    """Whether a row of the funnel says what a filter dropped, not what is there."""
    return name.startswith("dropped")


def pairs_left(rows: Sequence[tuple[str, int, str]]) -> list[int]:
    """Pairs left after each row of the funnel (paper 002, table 1)."""
    out: list[int] = []
    for name, value, _ in rows:
        out.append(out[-1] - value if is_loss(name) and out else value)
    return out


def funnel(rows: Sequence[tuple[str, int, str]]) -> str:
    """What every filter leaves, with what it drops in the colour it has in the matrix."""
    figure, (ax,) = figure_axes(0.9 + 0.34 * len(rows))
    y = np.arange(len(rows))
    left = pairs_left(rows)
    lost = [value if is_loss(name) else 0 for name, value, _ in rows]
    ax.barh(y, left, color=["#d5e4ea" if is_loss(name) else colour for name, _, colour in rows], height=0.68)
    edge = ["#9aa3ad" if k else "none" for k in lost]
    ax.barh(y, lost, left=left, color=[c for _, _, c in rows], height=0.68, edgecolor=edge, lw=0.6)
    ax.set_yticks(y, [name for name, _, _ in rows])
    ax.invert_yaxis()
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("pairs of images")
    top = max([*left, 1])
    for k, (n, gone) in enumerate(zip(left, lost)):
        text = f"\N{MINUS SIGN}{_count(gone)}, leaves {_count(n)}" if gone else _count(n)
        ax.text(n + gone + top * 0.008, k, text, va="center", fontsize=9)
    ax.set_xlim(0, top * 1.22)
    return saved(figure)


def degrees(pairs: Pairs, images: int) -> str:
    """Histogram of how many verified (or else planned) pairs an image has."""
    kept = pairs.kept()
    if np.any(pairs.inliers >= 0):
        kept = kept.where(kept.inliers > 0)
    degree = kept.degree(images)
    figure, (ax,) = figure_axes(2.5)
    top = int(degree.max(initial=1))
    edges = np.arange(-0.5, top + 1 + max(1, top // 40), max(1, top // 40)).tolist()
    ax.hist(degree, bins=edges, color=USED)
    ax.hist(degree[degree < 3], bins=edges, color=ALERT)
    ax.set_xlabel("ties of an image (red: fewer than 3)")
    ax.set_ylabel("images")
    return saved(figure)


def residuals(frames: np.ndarray, enu_m: np.ndarray, used: np.ndarray, track: np.ndarray, tracks: Sequence[str]) -> str:
    """Residuals (K, 3) of the frames' positions, one panel a component; outliers, not ``used`` (K,), as crosses."""
    figure = Figure(figsize=(_WIDTH_IN, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    with matplotlib.rc_context(STYLE):
        axes = figure.subplots(3, 1, sharex=True)
        for c, (ax, name) in enumerate(zip(axes, ("east", "north", "up"))):
            ax.axhline(0, color="#8b949e", lw=0.8)
            for t in np.unique(track):
                of = track == t
                label = (tracks[t] if 0 <= t < len(tracks) else "frames") if c == 0 else None
                ax.plot(frames[of], enu_m[of, c], ".", ms=5, color=PASSES[t % len(PASSES)], label=label)
            if not used.all():
                ax.plot(frames[~used], enu_m[~used, c], "x", ms=7, color=ALERT, label=None if c else "outlier")
            ax.set_ylabel(f"{name}, m")
            ax.margins(y=0.12)
            ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes[-1].set_xlabel("frame")
        axes[0].legend(frameon=False, ncols=6, loc="lower left", bbox_to_anchor=(0, 1.0), fontsize=9)
    return saved(figure, "svg" if len(frames) < 1500 else "png")


def shares(rows: Sequence[Sequence[float]]) -> str:
    """(distance m, accuracy %, completeness %, F %) as grouped bars."""
    figure, (ax,) = figure_axes(2.8)
    x = np.arange(len(rows))
    for k, (name, colour) in enumerate((("accuracy", "#a9cbd8"), ("completeness", USED), ("F-score", VERIFIED))):
        values = [r[k + 1] or 0 for r in rows]
        drawn = ax.bar(x + (k - 1) * 0.27, values, 0.25, color=colour, label=name)
        ax.bar_label(drawn, fmt="%.0f", fontsize=8)
    ax.set_xticks(x, [f"{r[0]:g} m" for r in rows])
    ax.set_ylim(0, 112)
    ax.set_ylabel("% of points")
    ax.grid(axis="x", visible=False)
    ax.legend(frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0, 1.0))
    return saved(figure)


def _count(number: int) -> str:
    return f"{number:,}".replace(",", " ")
