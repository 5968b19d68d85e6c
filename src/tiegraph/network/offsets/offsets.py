"""Source ``offsets``: which frame of a pass a camera shares with which frame of the same or another pass.

Papers 000 (section c) and 001 (section b) vote, for every two cameras, on one constant frame offset and match a limited
range around it: mode ``constant``. Mode ``local`` (default) follows the offset along the pass, because the speed of two
passes is never equal: previews on a coarse lattice of frames, grown where they hit, smoothed and interpolated.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiegraph.network.looks.copies import find_copies
from tiegraph.network.offsets.background import LONG, band, level_away, level_within
from tiegraph.network.offsets.constant import constant_offsets
from tiegraph.network.offsets.curves import OffsetResult, contained, curves_of, facing, sampled_ranks
from tiegraph.network.offsets.lattice import CEILING, FLOOR, Lattice, Level, make_lattice
from tiegraph.network.offsets.surface import ridge, surfaces_of
from tiegraph.network.passes import Pass, PreviewBook
from tiegraph.network.rig import commonview
from tiegraph.network.rig.axes import allowed_within
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASONS, Pairs

LADDER = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)  # frame distances at which the reach of a camera is measured
MAX_STRIDE = 16
WINDOW_NODES = 10  # seeds reach this far from the path, in lattice nodes
LEAST_WINDOW = 3
FLOOD_EXCESS = 1.1  # the lattice grows from nodes this much above min_matches: noise alone must not spread
PREVIEWS_PER_IMAGE = 25  # the most that previews may take: linear in the number of images
MIN_BUDGET = 6000  # previews that are always affordable (less than a minute on one core)
COARSE_NODES = 24  # lattice nodes a side of the first look between two passes

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Survey:
    """One finished lattice: smoothed counts, direction, yaw of q against p."""

    lattice: Lattice
    smooth: np.ndarray
    reversed: bool
    notes: tuple[str, ...] = ()
    complete: bool = True  # False: the budget of previews was spent before every hit was followed
    path: np.ndarray | None = None  # (A,) column node of each row, where evidence far from it does not count
    window: int = WINDOW_NODES  # nodes from the path within which it does


def estimate_offsets(passes: Sequence[Pass], book: PreviewBook, images: int, settings: NetworkSettings) -> OffsetResult:
    """Candidate pairs within and between passes by the mode of ``settings.offsets``."""
    couples = [(a, b) for k, a in enumerate(passes) for b in passes[k:]]
    if settings.offsets == "constant":
        parts = [constant_offsets(p, q, book, settings) for p, q in couples]
    else:
        budget = len(book) + max(MIN_BUDGET, PREVIEWS_PER_IMAGE * images)
        strides = {id(p): _stride(p, book, settings) for p in passes}
        parts = []
        for k, (p, q) in enumerate(couples):
            share = max(0, budget - len(book)) // (len(couples) - k)
            stride = finest = min(strides[id(p)], strides[id(q)])
            survey = _survey(p, q, (stride, WINDOW_NODES), book, settings, len(book) + share)
            while not survey.complete and 4 * stride < max(len(p), len(q)):
                stride *= 2  # coarser: the nodes of the finer lattice are known and cost nothing
                # As many frames from the path as before: else pairs, and previews, would grow faster than the images.
                window = max(LEAST_WINDOW, WINDOW_NODES * finest // stride)
                survey = _survey(p, q, (stride, window), book, settings, len(book) + share)
            parts.append(_without_copies(_local(survey, settings), survey.lattice, book, settings))
    pairs = Pairs.empty()
    for part in parts:
        pairs = pairs | part.pairs
    curves, notes, surfaces = (sum((getattr(r, n) for r in parts), ()) for n in ("curves", "notes", "surfaces"))
    lost = commonview.strangers([r.stranger for r in parts if r.stranger])
    return OffsetResult(pairs, curves, (*notes, *lost), surfaces)


def _stride(p: Pass, book: PreviewBook, settings: NetworkSettings) -> int:
    """Lattice stride in frames: a fifth of the frames over which a typical camera keeps seeing the same things."""
    reach = []
    starts = sampled_ranks(len(p), settings.sample_frames)
    level = level_within(p, allowed_within(p.rig, settings.axes_deg), book, settings.min_matches)
    for camera, images in enumerate(p.images):
        best = 0
        for step in LADDER:
            start = starts[starts + step < len(p)]
            left, right = images[start], images[start + step]
            there = (left >= 0) & (right >= 0)
            if not there.any():
                break
            if _usual(book.measure(left[there], right[there]), camera, level, settings) < settings.min_matches:
                break
            best = step
        reach.append(best)
    return int(np.clip(round(float(np.median(reach)) / 5 + 1), 1, min(MAX_STRIDE, max(1, len(p) // 4))))


def _usual(count: np.ndarray, camera: int, level: Level | None, settings: NetworkSettings) -> float:
    """What the previews (K,) of one camera at one distance reach, above what its unrelated frames do."""
    if level is None:
        return float(np.median(count))
    mean = np.clip(count, FLOOR * settings.min_matches, CEILING * settings.min_matches).mean()
    return float(level.above(mean, (camera, camera)))


def _survey(
    p: Pass, q: Pass, grid: tuple[int, int], book: PreviewBook, settings: NetworkSettings, budget: int
) -> _Survey:
    """Seed the lattice, then grow it from every hit until nothing new ties or the budget of previews is spent.

    ``grid``: stride in frames, and nodes from the path of long passes within which evidence counts.
    """
    stride, window = grid
    if p is q:
        lattice, backwards, path = _seed_same(p, stride, book, settings), False, None
        path = np.arange(len(lattice.rows), dtype=float)
    else:
        lattice, backwards, path = _seed_across(p, q, stride, book, settings, budget)
    path = path if min(len(p), len(q)) >= LONG else None
    while True:
        smooth = lattice.smoothed(settings.min_matches)
        frontier = lattice.frontier(smooth, FLOOD_EXCESS * settings.min_matches) & _beside(lattice, path, window)
        if p is q:
            frontier &= _upper(lattice)
        if not frontier.any():
            return _Survey(lattice, smooth, backwards, path=path, window=window)
        if len(book) + int(frontier.sum()) > budget:
            text = f"{p.name} - {q.name}: the budget of previews was spent before every hit was followed"
            return _Survey(lattice, smooth, backwards, (text,), complete=False, path=path, window=window)
        lattice = lattice.measured(frontier, book)


def _beside(lattice: Lattice, path: np.ndarray | None, window: int = WINDOW_NODES) -> np.ndarray:
    """(A, B) bool: nodes near the path, or all without one. What a long pass shares with itself or another elsewhere is
    a loop: repeated walls look the same, so it takes more than a lattice to believe it (``retrieval``)."""
    if path is None:
        return np.ones((len(lattice.rows), len(lattice.columns)), bool)
    return np.abs(np.arange(len(lattice.columns)) - path[:, None]) <= window + 2


def _upper(lattice: Lattice) -> np.ndarray:
    """(S, T, A, B) bool: one of the two nodes that hold the same image pair when both passes are one."""
    c, d, a, b = np.ogrid[tuple(slice(n) for n in lattice.inliers.shape)]
    return (c < d) | ((c == d) & (a < b))


def _seed_same(p: Pass, stride: int, book: PreviewBook, settings: NetworkSettings) -> Lattice:
    """Sampled frames against the frames around them, for every two cameras that the axes permit."""
    allowed = allowed_within(p.rig, settings.axes_deg)
    lattice = make_lattice(p, p, stride, allowed, level_within(p, allowed, book, settings.min_matches))
    a, b = np.ogrid[: len(lattice.rows), : len(lattice.columns)]
    sampled = np.isin(np.arange(len(lattice.rows)), sampled_ranks(len(lattice.rows), settings.sample_frames))
    near = sampled[:, None] & (np.abs(a - b) <= WINDOW_NODES)
    return lattice.measured(_upper(lattice) & near, book)


def _seed_across(
    p: Pass, q: Pass, stride: int, book: PreviewBook, settings: NetworkSettings, budget: int
) -> tuple[Lattice, bool, np.ndarray | None]:
    """A coarse grid over both passes gives the path and the heading; then sampled frames around the path."""
    lattice = make_lattice(p, q, stride, np.ones((len(p.images), len(q.images)), bool))
    cameras = len(p.images) * len(q.images)
    nodes = min(COARSE_NODES, max(4, int(np.sqrt(max(0, budget - len(book)) / 2 / cameras))))
    coarse = np.isin(np.arange(len(lattice.rows)), sampled_ranks(len(lattice.rows), nodes))[:, None] & np.isin(
        np.arange(len(lattice.columns)), sampled_ranks(len(lattice.columns), nodes)
    )
    lattice = lattice.measured(np.broadcast_to(coarse, lattice.inliers.shape), book)
    centre = None
    beside = np.ones(lattice.inliers.shape[2:], bool)
    if min(len(p), len(q)) >= LONG:
        centre = _ridge_path(lattice, settings.min_matches)
        beside = _beside(lattice, centre)
        lattice = replace(lattice, level=level_away(lattice, beside, settings.min_matches))
    excess = commonview.above(lattice, lattice.smoothed(settings.min_matches), settings.min_matches) * beside
    backwards, _ = commonview.direction(lattice, excess)
    lattice = replace(lattice, allowed=facing(lattice, excess, settings))
    centre = _path(lattice, excess.sum(axis=(0, 1))) if centre is None else centre
    if centre is None:
        return lattice, backwards, None
    sampled = np.isin(np.arange(len(lattice.rows)), sampled_ranks(len(lattice.rows), settings.sample_frames))
    near = np.abs(np.arange(len(lattice.columns)) - centre[:, None]) <= WINDOW_NODES
    return lattice.measured(np.broadcast_to(sampled[:, None] & near, lattice.inliers.shape), book), backwards, centre


def _ridge_path(lattice: Lattice, min_matches: int) -> np.ndarray:
    """(A,) column node of each row on the strongest path through what the whole rig shares above the rest of the grid.

    Most frames of two long passes share nothing: their median is what chance and repeated walls give.
    """
    low, high = FLOOR * min_matches, CEILING * min_matches
    known = np.isfinite(lattice.inliers)
    excess = np.where(known, np.clip(lattice.inliers, low, high) - low, 0).sum(axis=(0, 1))
    mean = excess / np.maximum(known.sum(axis=(0, 1)), 1)
    rows = np.flatnonzero(known.any(axis=(0, 1, 3)))
    columns = np.flatnonzero(known.any(axis=(0, 1, 2)))
    grid = mean[np.ix_(rows, columns)]
    evidence = np.maximum(grid - np.median(grid), 0)
    node = ridge(evidence, np.ones(evidence.shape, bool))
    return np.interp(np.arange(len(lattice.rows)), rows, columns[node.astype(int)])


def _path(lattice: Lattice, weight: np.ndarray) -> np.ndarray | None:
    """(A,) column node that a row of p shares most with, interpolated between the rows that have evidence."""
    rows = np.flatnonzero(weight.sum(axis=1) > 0)
    if not len(rows):
        return None
    columns = np.arange(weight.shape[1])
    centre = weight[rows] @ columns / weight[rows].sum(axis=1)
    return np.interp(np.arange(weight.shape[0]), rows, centre)


def _local(survey: _Survey, settings: NetworkSettings) -> OffsetResult:
    """Pairs kept by the interpolated surface; measured pairs that were not kept, with the reason."""
    lattice = survey.lattice
    smooth = lattice.confirmed(survey.smooth, settings.min_matches)
    smooth = commonview.without_chance(lattice, smooth, settings.min_matches)
    near = None
    if survey.path is not None:
        near = band(lattice, survey.path, survey.window + 2)
        smooth = np.where(near | np.isnan(smooth), smooth, np.minimum(smooth, FLOOR * settings.min_matches))
    c, d, m, n, count = lattice.interpolated(smooth, settings.min_matches)
    i, j = lattice.p.images[c, m], lattice.q.images[d, n]
    there = (i >= 0) & (j >= 0) & (i != j)
    if survey.path is not None:
        beside = np.interp(m, lattice.rows, np.interp(survey.path, np.arange(len(lattice.columns)), lattice.columns))
        there &= np.abs(n - beside) <= (survey.window + 2) * float(np.median(np.diff(lattice.columns)))
    kept = Pairs.make(i[there], j[there], "offsets", score=count[there])
    seen = np.isfinite(lattice.inliers)
    # A pair that is strong by itself is kept whatever its neighbours say.
    strong = np.nan_to_num(lattice.inliers) >= lattice.sure(settings.min_matches)
    if near is not None:
        strong &= near
    voted = np.nan_to_num(smooth).max(axis=(2, 3), initial=0) >= settings.min_matches
    reason = np.where(voted | strong.any(axis=(2, 3)), REASONS.index("weak"), REASONS.index("votes"))
    code = np.where(strong, 0, np.broadcast_to(reason[:, :, None, None], seen.shape))
    measured = Pairs.make(*lattice.images(seen), "offsets", score=lattice.inliers[seen], dropped=code[seen])
    curves = curves_of(lattice, survey.reversed, voted, settings)
    surfaces = surfaces_of(lattice, smooth, settings.min_matches)
    note, stranger = _said(lattice, smooth, settings)
    return OffsetResult(measured | kept, curves, (*survey.notes, *note), surfaces, stranger)


def _said(lattice: Lattice, smooth: np.ndarray, settings: NetworkSettings) -> tuple[tuple[str, ...], str]:
    """How two passes lie to each other as a note, or their names if they have nothing in common."""
    if lattice.same:
        return (), ""
    excess = commonview.above(lattice, smooth, settings.min_matches)
    if not excess.any():
        return (), f"{lattice.p.name} - {lattice.q.name}"
    said = commonview.in_words(lattice, excess)
    return ((said,) if said else ()), ""


def _without_copies(
    result: OffsetResult, lattice: Lattice, book: PreviewBook, settings: NetworkSettings
) -> OffsetResult:
    """Pairs of one picture twice are dropped: they match best of all and have no base."""
    copies = find_copies(lattice, book, settings.min_matches)
    if copies is None:
        return result
    twins = Pairs.make(copies.i, copies.j, "offsets", score=book.known(copies.i, copies.j))
    pairs = result.pairs | twins
    return replace(result, pairs=pairs.drop(contained(pairs, twins), "similar"), notes=(*result.notes, copies.note))
