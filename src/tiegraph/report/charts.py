"""Charts of the pairs: matrices of what was looked at and of what was verified, the funnel, the ties of an image."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from tiegraph.report import formatting
from tiegraph.report.svg.charts import LIGHT, USED, bars, histogram, matrix
from tiegraph.report.texts import said, t
from tiegraph.report.thumbnails import png_alpha
from tiegraph.scene.pairs import AFTER_MATCHING, REASON_LOOKS, REASONS, Pairs
from tiegraph.scene.scene import Scene

VERIFIED, DROPPED = "#0b4f6c", "#c9ced6"
_MATRIX_PX = 700
_MATCHES = ((1, "#c7e0ea"), (30, "#7fb8d0"), (100, "#2b7a9b"), (300, "#0a3d55"))  # verified matches from, colour
_NAMED_BLOCKS = 16


def looked_at(pairs: Pairs, scene: Scene) -> Markup:
    """Every pair that was looked at, by image and image, in the colour of why it was dropped."""
    order, _, _ = image_order(scene)
    size = min(len(scene), _MATRIX_PX)
    cells = np.full((size, size), np.nan)
    _fill(cells, _place(pairs, order, size), -pairs.dropped.astype(float))  # kept (0) wins
    colours = np.array([_rgb(REASON_LOOKS[r][1]) for r in REASONS])
    picture = _picture(np.where(np.isnan(cells), -1, -cells).astype(int), colours)
    key = [(said(REASON_LOOKS[REASONS[k]][0]), REASON_LOOKS[REASONS[k]][1]) for k in np.unique(pairs.dropped)]
    label = t("Looked at: {} pairs", formatting.count(len(pairs)))
    return matrix(picture, *_blocks(scene), key, label)


def holding(pairs: Pairs, scene: Scene) -> Markup:
    """The pairs that hold, by their verified matches; before the matching, those to be matched."""
    order, _, _ = image_order(scene)
    size = min(len(scene), _MATRIX_PX)
    kept = pairs.kept()
    matched = bool(np.any(pairs.inliers >= 0))
    kept = kept.where(kept.inliers > 0) if matched else kept
    value = kept.inliers.astype(float) if matched else np.full(len(kept), float(_MATCHES[-1][0]))
    cells = np.full((size, size), np.nan)
    _fill(cells, _place(kept, order, size), value)
    steps = np.searchsorted([low for low, _ in _MATCHES], np.nan_to_num(cells), side="right") - 1
    picture = _picture(steps, np.array([_rgb(colour) for _, colour in _MATCHES]))
    key = [(t("from {} matches", low), colour) for low, colour in _MATCHES] if matched else []
    count = formatting.count(len(kept))
    label = t("Verified: {} pairs", count) if matched else t("To be matched: {} pairs", count)
    return matrix(picture, *_blocks(scene), key, label)


def _blocks(scene: Scene) -> tuple[list[tuple[float, str]], list[float]]:
    """(middle, name) of the blocks of pass and camera, and their borders, as shares of the side."""
    _, names, edges = image_order(scene)
    n = max(len(scene), 1)
    every = -(-len(names) // _NAMED_BLOCKS)
    return [((m + 0.5) / n, name) for m, name in names[::every]], [e / n for e in edges]


def _rgb(colour: str) -> list[int]:
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


def _picture(classes: np.ndarray, colours: np.ndarray) -> str:
    """(H, W) classes, -1 = nothing, in their colours (C, 3)."""
    rgba = np.zeros((*classes.shape, 4), np.uint8)
    there = classes >= 0
    rgba[there, :3], rgba[there, 3] = colours[classes[there]], 255
    return png_alpha(rgba)


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


def _place(pairs: Pairs, order: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    return order[pairs.i] * size // max(len(order), 1), order[pairs.j] * size // max(len(order), 1)


def _fill(values: np.ndarray, place: tuple[np.ndarray, np.ndarray], column: np.ndarray) -> None:
    rising = np.argsort(column, kind="stable")  # the largest is written last
    row, col = place[0][rising], place[1][rising]
    values[row, col] = values[col, row] = column[rising]


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


def funnel(rows: Sequence[tuple[str, int, str]]) -> Markup:
    """What every filter leaves, with what it drops in the colour it has in the matrix."""
    drawn: list[tuple[str, Sequence[tuple[float, str]], str]] = []
    for (name, value, colour), left in zip(rows, pairs_left(rows)):
        if is_loss(name):
            end = f"\N{MINUS SIGN}{formatting.count(value)} \N{RIGHTWARDS ARROW} {formatting.count(left)}"
            drawn.append((step_name(name), ((left, LIGHT), (value, colour)), end))
        else:
            drawn.append((step_name(name), ((left, colour),), formatting.count(left)))
    return bars(drawn, t("From candidates to ties"))


def step_name(name: str) -> str:
    """A row of the funnel in the language of the page."""
    head, _, reason = name.partition(": ")
    return f"{t('dropped')}: {said(reason)}" if reason else said(head)


def degrees(pairs: Pairs, images: int, few: int) -> Markup:
    """Histogram of how many verified (or else planned) pairs an image has."""
    return histogram(ties(pairs, images), few, t("ties of an image (red: fewer than {})", few), t("images"))


def ties(pairs: Pairs, images: int) -> np.ndarray:
    """(N,) verified, or else planned, pairs of each image."""
    kept = pairs.kept()
    if np.any(pairs.inliers >= 0):
        kept = kept.where(kept.inliers > 0)
    return kept.degree(images)
