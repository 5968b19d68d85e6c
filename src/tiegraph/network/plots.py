"""Pictures of the network as PNG: the tie graph on the map, frames at their positions, ties by kind, weak links in red;
and the sections with the cues of the up camera along the passes. The report draws the matrix of the pairs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from tiegraph.network.sections import Cue, Section
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.results import png
from tiegraph.scene.scene import Scene, between_neighbours
from tiegraph.text import round_below

DPI = 110
BLUE, RED, INK = "#1b6ca8", "#c0392b", "#444444"


def grouped(number: float) -> str:
    """A whole number with spaces between thousands."""
    return f"{round(number):,}".replace(",", " ")


MAX_NODES = 300  # more frames than this are drawn as runs of neighbours
MAX_LINES = 2500  # the strongest of each kind
_BULGE = 0.28  # height of a short arc, as a share of its chord
_HIGHEST = 0.11  # height of the longest arc, as a share of the map's longer side
_ARC = np.linspace(0, 1, 13)
_PAGE_IN, _WORDS_IN = 12.0, 0.9
KINDS = {"same camera": "#0072b2", "across cameras": "#009e73", "across passes": "#d55e00", "photographs": "#0072b2"}
_PASSES = ("#222222", "#cc79a7", "#7a5c99", "#8a6d1f", "#56b4e9", "#8b949e")


@dataclass(frozen=True)
class _Nodes:
    """Frames joined to M nodes: node of each frame (F,) (-1 = not drawn), place (M, 2), pass (M,), frames of a node."""

    of_frame: np.ndarray
    place: np.ndarray
    sequence: np.ndarray
    frames: int


@dataclass(frozen=True)
class _Ties:
    """Ties of one kind: nodes a, b (K,), pairs of images (K,)."""

    a: np.ndarray
    b: np.ndarray
    count: np.ndarray
    pairs: int


def map_png(
    pairs: Pairs,
    positions: np.ndarray | None,
    scene: Scene,
    weak: np.ndarray | Sequence[tuple[int, int]] | None = None,
    unit: str = "m",
) -> bytes:
    """Map of the kept pairs, one panel for each kind of tie: same camera, across cameras, across passes.

    ``positions`` (F, 2 or 3) of the frames, x to the right and y up, NaN = unknown (then between its neighbours on
    the pass); None or all NaN: a layout by sequence or on a circle, as the picture states. ``weak`` (K, 2): image pairs
    to be drawn in red. ``unit`` of the positions.
    """
    kept = pairs.kept()
    if np.any(pairs.inliers >= 0):
        kept = kept.where(kept.inliers > 0)
    place, said = _layout(positions, scene)
    nodes = _joined(place, scene)
    links = np.zeros((0, 2), int) if weak is None else np.asarray(weak, int).reshape(-1, 2)
    ties = {k: tie for k in KINDS if (tie := _aggregated(kept, scene, nodes, k)).pairs} or {
        "same camera": _aggregated(kept, scene, nodes, "same camera")
    }
    figure, panels = _panels(nodes, len(ties))
    for n, (axes, (kind, tie)) in enumerate(zip(panels, ties.items())):
        _lines(axes, nodes, tie, kind)
        _dots(axes, scene, nodes, kept)
        _names(axes, scene, nodes, named=n == 0)
        _weak(axes, nodes, scene.frame[links[_of_kind(scene, links) == kind]].reshape(-1, 2))
        axes.set_title(f"{kind}: {grouped(tie.pairs)} pairs", fontsize=10, loc="left", color=KINDS[kind], pad=3)
        if n == 0 and not said:
            _scale_bar(axes, unit)
    title, more = _words(kept, scene, nodes, links, ties)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12)
    figure.supxlabel(f"{said}\n{more}" if said else more, x=0.01, ha="left", fontsize=9, color=RED if said else INK)
    return png(figure)


def weak_pairs(table: dict, scene: Scene) -> np.ndarray:
    """(K, 2) images of the rows of a weak-links table ("columns", "rows") that name a pair as "first - second"."""
    found = []
    for row in table.get("rows") or []:
        ends = [scene.image_index.get(name) for name in str(row[1]).split(" - ")] if len(row) > 1 else []
        if len(ends) == 2 and None not in ends:
            found.append(ends)
    return np.array(found, int).reshape(-1, 2)


# ---------------------------------------------------------------- places


def _layout(positions: np.ndarray | None, scene: Scene) -> tuple[np.ndarray, str]:
    """(F, 2) places of the frames, and a remark on them."""
    if positions is not None and np.isfinite(np.asarray(positions, float)[:, :2]).all(axis=1).any():
        return between_neighbours(np.asarray(positions, float)[:, :2], scene), ""
    if (scene.sequence >= 0).any():
        lane = np.where(scene.sequence >= 0, scene.sequence, scene.sequence.max() + 1)
        rank = np.zeros(scene.frames)
        for t in np.unique(lane):
            own = scene.in_order(lane == t)
            rank[own] = np.arange(len(own))
        gap = 0.25 * max(1.0, float(rank.max()))
        said = "frames are drawn in the order of their passes, one row for each pass"
        return np.stack([rank, -gap * lane], axis=1), f"no positions: {said}; lengths have no meaning"
    angle = 2 * np.pi * np.arange(scene.frames) / max(scene.frames, 1)
    said = "photographs are drawn on a circle"
    return np.stack([np.cos(angle), np.sin(angle)], axis=1), f"no positions: {said}; lengths have no meaning"


def _joined(place: np.ndarray, scene: Scene) -> _Nodes:
    known = np.isfinite(place).all(axis=1)
    step = max(1, -(-int(known.sum()) // MAX_NODES))
    of_frame = np.full(scene.frames, -1)
    places: list[np.ndarray] = []
    tracks: list[int] = []
    for t in np.unique(scene.sequence):
        own = scene.in_order((scene.sequence == t) & known)
        width = step if t >= 0 else 1
        for first in range(0, len(own), width):
            run = own[first : first + width]
            of_frame[run] = len(places)
            places.append(place[run].mean(axis=0))
            tracks.append(int(t))
    place = np.array(places).reshape(-1, 2)
    return _Nodes(of_frame=of_frame, place=place, sequence=np.array(tracks, int), frames=step)


def _of_kind(scene: Scene, links: np.ndarray) -> np.ndarray:
    """(K,) kind of image pairs (K, 2)."""
    frames, keys = scene.frame[links], scene.sensor_key[links]
    across = scene.sequence[frames[:, 0]] != scene.sequence[frames[:, 1]]
    loose = (scene.sequence[frames] < 0).all(axis=1)
    same = (keys[:, 0] == keys[:, 1]) & ~loose
    inside = frames[:, 0] == frames[:, 1]
    names = np.where(across, "across passes", np.where(same, "same camera", "across cameras"))
    return np.where(inside, "within a frame", np.where(loose, "photographs", names))


def _aggregated(kept: Pairs, scene: Scene, nodes: _Nodes, kind: str) -> _Ties:
    fi, fj = scene.frame[kept.i], scene.frame[kept.j]
    of_kind = _of_kind(scene, np.stack([kept.i, kept.j], axis=1)) == kind
    a, b = np.minimum(nodes.of_frame[fi], nodes.of_frame[fj]), np.maximum(nodes.of_frame[fi], nodes.of_frame[fj])
    rows = np.flatnonzero(of_kind & (a >= 0) & (a != b))
    key, count = np.unique(a[rows].astype(np.int64) * len(nodes.place) + b[rows], return_counts=True)
    best = np.sort(np.argsort(-count, kind="stable")[:MAX_LINES])
    width = max(len(nodes.place), 1)
    return _Ties(a=key[best] // width, b=key[best] % width, count=count[best], pairs=int(of_kind.sum()))


# ---------------------------------------------------------------- drawing


def _panels(nodes: _Nodes, count: int) -> tuple[Figure, list[Axes]]:
    """So many maps of the nodes, equal in both directions: below each other if they are wide, else side by side."""
    place = nodes.place if len(nodes.place) else np.zeros((1, 2))
    low, high = place.min(axis=0), place.max(axis=0)
    room = (0.04 + _HIGHEST) * max(float((high - low).max()), 1e-9)
    low, high = low - room, high + room
    shape = float((high - low)[1] / (high - low)[0])
    rows, columns = (1, count) if shape > 0.55 else (count, 1)
    width = min(_PAGE_IN / columns, 5.5) if shape > 0.55 else _PAGE_IN
    height = float(np.clip(shape * width, 1.8, 7.5)) + 0.3
    size = max(width * columns, 7.5), rows * height + _WORDS_IN
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    panels = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for axes in panels:
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[], aspect="equal")
        axes.spines[:].set_color("#dddddd")
    return figure, panels


def _lines(axes: Axes, nodes: _Nodes, ties: _Ties, kind: str) -> None:
    if not len(ties.a):
        return
    order = np.argsort(ties.count, kind="stable")
    share = ties.count[order] / max(int(ties.count.max()), 1)
    curves = _curves(nodes, ties.a[order], ties.b[order], 0.0 if kind in ("across passes", "photographs") else _BULGE)
    # The more lines, the fainter each: the total ink stays about the same, and thick bundles stand out.
    ink = np.clip(9 / np.sqrt(len(order)), 0.12, 0.85)
    alpha = np.clip(ink * (0.12 + 0.88 * share**1.5), 0.04, 0.9)
    look = {"color": KINDS[kind], "linewidths": 0.4 + 1.4 * share, "alpha": alpha, "zorder": 2}
    axes.add_collection(LineCollection(list(curves), **look))


def _curves(nodes: _Nodes, a: np.ndarray, b: np.ndarray, bulge: float) -> np.ndarray:
    """(K, 13, 2) arcs from nodes a to nodes b, to the left for a positive bulge; straight for zero."""
    start, end = nodes.place[a], nodes.place[b]
    chord = end - start
    length = np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-12)
    highest = _HIGHEST * max(float(np.ptp(nodes.place, axis=0).max()), 1e-12)
    height = highest * np.tanh(bulge * length / highest)  # long arcs do not leave the page
    side = np.stack([-chord[:, 1], chord[:, 0]], axis=1) / length * height
    t = _ARC[None, :, None]
    return start[:, None] + t * chord[:, None] + 4 * t * (1 - t) * side[:, None]


def _dots(axes: Axes, scene: Scene, nodes: _Nodes, kept: Pairs) -> None:
    degree = kept.degree(len(scene))
    tied = np.zeros(len(nodes.place), bool)
    drawn = nodes.of_frame[scene.frame] >= 0
    np.logical_or.at(tied, nodes.of_frame[scene.frame[drawn]], degree[drawn] > 0)
    size = float(np.clip(1200 / max(len(tied), 1), 5, 18))
    for k, t in enumerate(np.unique(nodes.sequence)):
        own = nodes.sequence == t
        axes.plot(*nodes.place[own].T, color=INK, lw=0.6 if t >= 0 else 0, alpha=0.5, zorder=3)
        colour = _PASSES[k % len(_PASSES)]
        axes.scatter(*nodes.place[own & tied].T, s=size, color=colour, zorder=4, lw=0.3, edgecolor="white")
        if (own & ~tied).any():
            lonely = nodes.place[own & ~tied].T
            axes.scatter(*lonely, s=3 * size, facecolor="white", edgecolor=RED, zorder=5, lw=1)


def _names(axes: Axes, scene: Scene, nodes: _Nodes, named: bool) -> None:
    tracks = [t for t in np.unique(nodes.sequence) if 0 <= t < len(scene.sequences)]
    if not named or not 1 < len(tracks) <= 12:
        return
    left, low = nodes.place.min(axis=0)
    span = np.maximum(np.ptp(nodes.place, axis=0), 1e-9)
    for k, t in enumerate(tracks):
        first = nodes.place[np.flatnonzero(nodes.sequence == t)[0]]
        x, y = (first - (left, low)) / span
        above = y > 0.5 or span[1] < 0.2 * span[0] and k % 2 == 0
        away = (16 + 12 * (k // 2)) * (1 if above else -1)
        axes.annotate(f"{scene.sequences[t]} starts", first, (0, away), textcoords="offset points",
                      ha="left" if x < 0.34 else "right" if x > 0.66 else "center", va="bottom" if above else "top",
                      fontsize=8.5, color=_PASSES[k % len(_PASSES)], zorder=7,
                      arrowprops={"arrowstyle": "-", "color": INK, "lw": 0.5, "shrinkB": 3})  # fmt: skip


def _weak(axes: Axes, nodes: _Nodes, frames: np.ndarray) -> None:
    ends = nodes.of_frame[frames]
    ends = ends[(ends >= 0).all(axis=1)]
    if not len(ends):
        return
    axes.add_collection(LineCollection(list(nodes.place[ends]), color=RED, linewidths=2.2, alpha=0.9, zorder=6))
    here = nodes.place[np.unique(ends)]
    axes.scatter(here[:, 0], here[:, 1], s=40, facecolor="none", edgecolor=RED, lw=1.4, zorder=6)


def _words(kept: Pairs, scene: Scene, nodes: _Nodes, links: np.ndarray, ties: dict[str, _Ties]) -> tuple[str, str]:
    inside = int(np.sum(scene.frame[kept.i] == scene.frame[kept.j]))
    lost = int(np.sum(nodes.of_frame < 0))
    parts = [f"one dot = {nodes.frames} frames" if nodes.frames > 1 else "one dot = one frame"]
    parts += [f"{grouped(inside)} pairs within a frame are not drawn"] if inside else []
    parts += [f"{lost} frame{'s are' if lost > 1 else ' is'} left out, without a position"] if lost else []
    if any(len(t.a) >= MAX_LINES for t in ties.values()):
        parts.append(f"the {MAX_LINES} strongest lines of each kind")
    parts += [f"red: {len(links)} weak links"] if len(links) else []
    return f"The tie graph: {grouped(len(kept))} pairs of images, {grouped(scene.frames)} frames", "; ".join(parts)


def _scale_bar(axes: Axes, unit: str) -> None:
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    length = round_below(0.2 * (right - left))
    x, y = left + 0.03 * (right - left), low + 0.05 * (high - low)
    axes.plot([x, x + length], [y, y], color=INK, lw=2.5, solid_capstyle="butt", zorder=8)
    axes.text(x + length / 2, y + 0.012 * (high - low), f"{length:g} {unit}", ha="center", va="bottom", fontsize=9)


# ---------------------------------------------------------------- sections


def sections_png(scene: Scene, sections: Sequence[Section], cues: Sequence[Cue]) -> bytes:
    """One panel for each cue: its values by frame, the threshold of each pass, the sections as coloured bands."""
    frames = np.lexsort((scene.sequence_index, scene.sequence))
    frames = frames[np.any([np.isfinite(c.values[frames]) for c in cues], axis=0)]
    figure = Figure(figsize=(10, 2.2 * len(cues) + 1), dpi=DPI, layout="constrained")
    for k, (cue, axes) in enumerate(zip(cues, figure.subplots(len(cues), 1, sharex=True, squeeze=False).ravel())):
        _bands(axes, scene, sections, frames, named=k == 0)
        _values(axes, scene, cue, frames)
        axes.tick_params(labelsize=8)
    key = "brown: bridge; blue: open sky; dashed: threshold of the pass (none: the cue was not used)"
    figure.suptitle("Bridge and open sections by the up camera", x=0.01, ha="left", fontsize=12)
    figure.supxlabel(f"across: frames of all passes in a row; {key}", x=0.01, ha="left", fontsize=9, color=INK)
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
    starts = 1 + np.flatnonzero(np.diff(sequence))
    for e in starts:
        axes.axvline(e - 0.5, color=INK, lw=1.2)
    for first in np.r_[0, starts] if named and len(frames) else ():
        name = f"pass {scene.sequences[sequence[first]]}" if 0 <= sequence[first] < len(scene.sequences) else "loose"
        axes.text(first - 0.3, 0.03, name, transform=axes.get_xaxis_transform(), fontsize=9, color=INK)


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
