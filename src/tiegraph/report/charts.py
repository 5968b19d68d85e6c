"""Charts of the pairs: matrices of what was looked at and of what was verified, the funnel, the ties of an image."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from tiegraph.report import formatting
from tiegraph.report.svg import LIGHT, USED, bars, histogram, matrix
from tiegraph.report.texts import said, t
from tiegraph.report.thumbnails import png, rgb_of
from tiegraph.scene.pairs import AFTER_MATCHING, REASON_LOOKS, REASONS, Pairs
from tiegraph.scene.scene import Scene

VERIFIED, DROPPED = "#0b4f6c", "#c9ced6"
_MATRIX_PX = 700
_MATCHES = ((1, "#c7e0ea"), (30, "#7fb8d0"), (100, "#2b7a9b"), (300, "#0a3d55"))  # verified matches from, colour
_NAMED_BLOCKS = 16


def looked_at(pairs: Pairs, scene: Scene) -> Markup:
    """Every pair that was looked at, by image and image, in the colour of why it was dropped."""
    looks = [REASON_LOOKS[reason] for reason in REASONS]
    key = [(said(looks[k][0]), looks[k][1]) for k in np.unique(pairs.dropped)]
    label = t("Looked at: {} pairs", formatting.count(len(pairs)))
    picture = _picture(pairs, -pairs.dropped.astype(int), scene, [colour for _, colour in looks])
    return matrix(picture, *_blocks(scene), key, label)


def holding(pairs: Pairs, scene: Scene) -> Markup:
    """The pairs that hold, by their verified matches; before the matching, those to be matched."""
    matched, kept = is_matched(pairs), tied(pairs)
    count = formatting.count(len(kept))
    step = np.full(len(kept), len(_MATCHES) - 1)
    key, label = [], t("To be matched: {} pairs", count)
    if matched:
        step = np.searchsorted([low for low, _ in _MATCHES], kept.inliers, side="right") - 1
        key, label = [(t("from {} matches", low), colour) for low, colour in _MATCHES], t("Verified: {} pairs", count)
    picture = _picture(kept, step, scene, [colour for _, colour in _MATCHES])
    return matrix(picture, *_blocks(scene), key, label)


def is_matched(pairs: Pairs) -> bool:
    """Whether the pairs were matched at full resolution."""
    return bool(np.any(pairs.inliers >= 0))


def tied(pairs: Pairs) -> Pairs:
    """The verified pairs; before the matching, those to be matched."""
    kept = pairs.kept()
    return kept.where(kept.inliers > 0) if is_matched(pairs) else kept


def _picture(pairs: Pairs, rank: np.ndarray, scene: Scene, colours: Sequence[str]) -> str:
    """The matrix of the images, pairs of rank k or -k in colour k; of those on one pixel the highest rank is seen."""
    place, _, _ = image_order(scene)
    size, rising = min(len(scene), _MATRIX_PX), np.argsort(rank, kind="stable")
    row, column = (place[ends[rising]] * size // max(len(scene), 1) for ends in (pairs.i, pairs.j))
    rgba = np.zeros((size, size, 4), np.uint8)
    shown = np.array([[*rgb_of(c), 255] for c in colours], np.uint8)[np.abs(rank[rising])]
    rgba[row, column] = rgba[column, row] = shown
    return png(rgba)


def _blocks(scene: Scene) -> tuple[list[tuple[float, str]], list[float]]:
    """(middle, name) of the blocks of pass and camera, and their borders, as shares of the side."""
    _, names, edges = image_order(scene)
    n = max(len(scene), 1)
    every = -(-len(names) // _NAMED_BLOCKS)
    return [((m + 0.5) / n, name) for m, name in names[::every]], [e / n for e in edges]


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


def funnel_rows(pairs: Pairs, network: Pairs | None) -> list[tuple[str, int, str]]:
    """(what, pairs, colour) from all candidates to the verified ones, in the order of the filters."""
    funnel = pairs.funnel()
    start = max(len(network) if network is not None else 0, funnel["candidates"])
    rows = [("candidates", start, "#8b949e")]
    gone = {k: v for k, v in funnel.items() if k not in ("candidates", "used", *AFTER_MATCHING)}
    if network is not None and len(network) > len(pairs):
        rows.append(("dropped: in the network", len(network) - len(pairs), DROPPED))
    rows += [(f"dropped: {REASON_LOOKS[k][0]}", v, REASON_LOOKS[k][1]) for k, v in gone.items()]
    if not is_matched(pairs):
        return [*rows, ("pairs to match", funnel["used"], USED)]
    lost = sum(funnel.get(reason, 0) for reason in AFTER_MATCHING)
    rows.append(("matched at full resolution", funnel["used"] + lost, USED))
    rows += [(f"dropped: {REASON_LOOKS[k][0]}", funnel[k], REASON_LOOKS[k][1]) for k in AFTER_MATCHING if k in funnel]
    return [*rows, ("verified", len(tied(pairs)), VERIFIED)]


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
    return tied(pairs).degree(images)
