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

from tiegraph.network import commonview
from tiegraph.network.axes import allowed_within, angles_deg
from tiegraph.network.copies import find_copies
from tiegraph.network.lattice import CEILING, FLOOR, Lattice, make_lattice
from tiegraph.network.passes import Pass, PreviewBook
from tiegraph.network.settings import NetworkSettings
from tiegraph.network.surface import OffsetSurface, ridge, surfaces_of
from tiegraph.scene.pairs import REASONS, Pairs

LADDER = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)  # frame distances at which the reach of a camera is measured
MAX_STRIDE = 16
WINDOW_NODES = 10  # seeds reach this far from the path, in lattice nodes
FLOOD_EXCESS = 1.1  # the lattice grows from nodes this much above min_matches: noise alone must not spread
PREVIEWS_PER_IMAGE = 25  # the most that previews may take: linear in the number of images
MIN_BUDGET = 6000  # previews that are always affordable (less than a minute on one core)
LONG = 60  # frames from which on most frames of a pass share nothing: evidence counts near its path only
COARSE_NODES = 24  # lattice nodes a side of the first look between two passes
MAX_COLUMNS = 120  # constant offsets: frames of the other pass a sampled frame is compared with

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class OffsetCurve:
    """Votes against frame offset for two cameras: offset = n - m, or n + m when the other pass runs the other way.

    offsets (K,) i4; votes (K,) f4 mean preview matches above chance; best: offset with most votes; accepted: whether
    the camera pair gave candidates at all.
    """

    pass_a: str
    pass_b: str
    sensor_a: str
    sensor_b: str
    offsets: np.ndarray
    votes: np.ndarray
    best: int
    accepted: bool
    reversed: bool


@dataclass(frozen=True)
class OffsetResult:
    """Pairs of the source, its curves, and what people should know."""

    pairs: Pairs
    curves: tuple[OffsetCurve, ...]
    notes: tuple[str, ...]
    surfaces: tuple[OffsetSurface, ...] = ()
    stranger: str = ""  # the couple of passes, where it has no common view


@dataclass(frozen=True)
class _Survey:
    """One finished lattice: smoothed counts, direction, yaw of q against p."""

    lattice: Lattice
    smooth: np.ndarray
    reversed: bool
    notes: tuple[str, ...] = ()
    complete: bool = True  # False: the budget of previews was spent before every hit was followed
    path: np.ndarray | None = None  # (A,) column node of each row, where evidence far from it does not count


def estimate_offsets(passes: Sequence[Pass], book: PreviewBook, images: int, settings: NetworkSettings) -> OffsetResult:
    """Candidate pairs within and between passes by the mode of ``settings.offsets``."""
    couples = [(a, b) for k, a in enumerate(passes) for b in passes[k:]]
    if settings.offsets == "constant":
        parts = [_constant(p, q, book, settings) for p, q in couples]
    else:
        budget = len(book) + max(MIN_BUDGET, PREVIEWS_PER_IMAGE * images)
        strides = {id(p): _stride(p, book, settings) for p in passes}
        parts = []
        for k, (p, q) in enumerate(couples):
            share = max(0, budget - len(book)) // (len(couples) - k)
            stride = min(strides[id(p)], strides[id(q)])
            survey = _survey(p, q, stride, book, settings, len(book) + share)
            while not survey.complete and 4 * stride < max(len(p), len(q)):
                stride *= 2  # coarser: the nodes of the finer lattice are known and cost nothing
                survey = _survey(p, q, stride, book, settings, len(book) + share)
            parts.append(_without_copies(_local(survey, settings), survey.lattice, book, settings))
    pairs = Pairs.empty()
    for part in parts:
        pairs = pairs | part.pairs
    curves, notes, surfaces = (sum((getattr(r, n) for r in parts), ()) for n in ("curves", "notes", "surfaces"))
    lost = commonview.strangers([r.stranger for r in parts if r.stranger])
    return OffsetResult(pairs, curves, (*notes, *lost), surfaces)


# ---------------------------------------------------------------- local offsets


def _stride(p: Pass, book: PreviewBook, settings: NetworkSettings) -> int:
    """Lattice stride in frames: a fifth of the frames over which a typical camera keeps seeing the same things."""
    reach = []
    starts = _sampled(len(p), settings.sample_frames)
    for images in p.images:
        best = 0
        for step in LADDER:
            start = starts[starts + step < len(p)]
            left, right = images[start], images[start + step]
            there = (left >= 0) & (right >= 0)
            if not there.any():
                break
            if np.median(book.measure(left[there], right[there])) < settings.min_matches:
                break
            best = step
        reach.append(best)
    return int(np.clip(round(float(np.median(reach)) / 5 + 1), 1, min(MAX_STRIDE, max(1, len(p) // 4))))


def _sampled(n: int, count: int) -> np.ndarray:
    return np.unique(np.linspace(0, n - 1, min(n, count)).round().astype(int))


def _survey(p: Pass, q: Pass, stride: int, book: PreviewBook, settings: NetworkSettings, budget: int) -> _Survey:
    """Seed the lattice, then grow it from every hit until nothing new ties or the budget of previews is spent."""
    if p is q:
        lattice, backwards, path = _seed_same(p, stride, book, settings), False, None
        path = np.arange(len(lattice.rows), dtype=float)
    else:
        lattice, backwards, path = _seed_across(p, q, stride, book, settings, budget)
    path = path if min(len(p), len(q)) >= LONG else None
    while True:
        smooth = lattice.smoothed(settings.min_matches)
        frontier = lattice.frontier(smooth, FLOOD_EXCESS * settings.min_matches) & _beside(lattice, path)
        if p is q:
            frontier &= _upper(lattice)
        if not frontier.any():
            return _Survey(lattice, smooth, backwards, path=path)
        if len(book) + int(frontier.sum()) > budget:
            text = f"{p.name} - {q.name}: the budget of previews was spent before every hit was followed"
            return _Survey(lattice, smooth, backwards, (text,), complete=False, path=path)
        lattice = lattice.measured(frontier, book)


def _beside(lattice: Lattice, path: np.ndarray | None) -> np.ndarray:
    """(A, B) bool: nodes near the path, or all without one. What a long pass shares with itself or another elsewhere is
    a loop: repeated walls look the same, so it takes more than a lattice to believe it (``retrieval``)."""
    if path is None:
        return np.ones((len(lattice.rows), len(lattice.columns)), bool)
    return np.abs(np.arange(len(lattice.columns)) - path[:, None]) <= WINDOW_NODES + 2


def _upper(lattice: Lattice) -> np.ndarray:
    """(S, T, A, B) bool: one of the two nodes that hold the same image pair when both passes are one."""
    c, d, a, b = np.ogrid[tuple(slice(n) for n in lattice.inliers.shape)]
    return (c < d) | ((c == d) & (a < b))


def _seed_same(p: Pass, stride: int, book: PreviewBook, settings: NetworkSettings) -> Lattice:
    """Sampled frames against the frames around them, for every two cameras that the axes permit."""
    lattice = make_lattice(p, p, stride, allowed_within(p.rig, settings.axes_deg))
    a, b = np.ogrid[: len(lattice.rows), : len(lattice.columns)]
    sampled = np.isin(np.arange(len(lattice.rows)), _sampled(len(lattice.rows), settings.sample_frames))
    near = sampled[:, None] & (np.abs(a - b) <= WINDOW_NODES)
    return lattice.measured(_upper(lattice) & near, book)


def _seed_across(
    p: Pass, q: Pass, stride: int, book: PreviewBook, settings: NetworkSettings, budget: int
) -> tuple[Lattice, bool, np.ndarray | None]:
    """A coarse grid over both passes gives the path and the heading; then sampled frames around the path."""
    lattice = make_lattice(p, q, stride, np.ones((len(p.images), len(q.images)), bool))
    cameras = len(p.images) * len(q.images)
    nodes = min(COARSE_NODES, max(4, int(np.sqrt(max(0, budget - len(book)) / 2 / cameras))))
    coarse = np.isin(np.arange(len(lattice.rows)), _sampled(len(lattice.rows), nodes))[:, None] & np.isin(
        np.arange(len(lattice.columns)), _sampled(len(lattice.columns), nodes)
    )
    lattice = lattice.measured(np.broadcast_to(coarse, lattice.inliers.shape), book)
    excess = commonview.above(lattice, lattice.smoothed(settings.min_matches), settings.min_matches)
    centre = None
    if min(len(p), len(q)) >= LONG:
        centre = _ridge_path(lattice, settings.min_matches)
        excess = excess * _beside(lattice, centre)
    backwards, _ = commonview.direction(lattice, excess)
    lattice = Lattice(p, q, lattice.rows, lattice.columns, _facing(lattice, excess, settings), lattice.inliers)
    centre = _path(lattice, excess.sum(axis=(0, 1))) if centre is None else centre
    if centre is None:
        return lattice, backwards, None
    sampled = np.isin(np.arange(len(lattice.rows)), _sampled(len(lattice.rows), settings.sample_frames))
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


def _facing(lattice: Lattice, excess: np.ndarray, settings: NetworkSettings) -> np.ndarray:
    """(S, T) bool: camera pairs whose axes permit a match at the heading of q against p; all, while that is unknown."""
    yaw = commonview.yaw(lattice, excess)
    if yaw is None:
        return np.ones(excess.shape[:2], bool)
    return angles_deg(lattice.p.rig, yaw) <= settings.axes_deg


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
    c, d, m, n, count = lattice.interpolated(smooth, settings.min_matches)
    i, j = lattice.p.images[c, m], lattice.q.images[d, n]
    there = (i >= 0) & (j >= 0) & (i != j)
    if survey.path is not None:
        beside = np.interp(m, lattice.rows, np.interp(survey.path, np.arange(len(lattice.columns)), lattice.columns))
        there &= np.abs(n - beside) <= (WINDOW_NODES + 2) * float(np.median(np.diff(lattice.columns)))
    kept = Pairs.make(i[there], j[there], "offsets", score=count[there])
    seen = np.isfinite(lattice.inliers)
    # A pair that is strong by itself is kept whatever its neighbours say.
    strong = (np.nan_to_num(lattice.inliers) >= CEILING * settings.min_matches) & _beside(lattice, survey.path)
    voted = np.nan_to_num(smooth).max(axis=(2, 3), initial=0) >= settings.min_matches
    reason = np.where(voted | strong.any(axis=(2, 3)), REASONS.index("weak"), REASONS.index("votes"))
    code = np.where(strong, 0, np.broadcast_to(reason[:, :, None, None], seen.shape))
    measured = Pairs.make(*lattice.images(seen), "offsets", score=lattice.inliers[seen], dropped=code[seen])
    curves = _curves(lattice, survey.reversed, voted, settings)
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
    return replace(result, pairs=pairs.drop(_contained(pairs, twins), "similar"), notes=(*result.notes, copies.note))


# ---------------------------------------------------------------- curves


def _curves(
    lattice: Lattice, backwards: bool, accepted: np.ndarray, settings: NetworkSettings, best: np.ndarray | None = None
) -> tuple[OffsetCurve, ...]:
    """One curve a camera pair; ``best`` (S, T) is the offset that was voted, where one was."""
    p, q = lattice.p, lattice.q
    out = []
    for c, d in np.argwhere(lattice.allowed):
        if lattice.same and c >= d:
            continue
        offsets, votes = _votes(lattice, int(c), int(d), backwards, settings.min_matches)
        if not len(offsets):
            continue
        winner = int(offsets[np.argmax(votes)] if best is None else best[c, d])
        names = p.rig.sensors[c].name, q.rig.sensors[d].name
        out.append(OffsetCurve(p.name, q.name, *names, offsets, votes, winner, bool(accepted[c, d]), backwards))
    return tuple(out)


def _votes(
    lattice: Lattice, c: int, d: int, backwards: bool, min_matches: int, total: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (K,) and matches above chance at each, mean over the frames looked at (or their sum)."""
    inliers = lattice.inliers[c, d]
    m, n = np.meshgrid(lattice.rows, lattice.columns, indexing="ij")
    offset = (n + m if backwards else n - m)[np.isfinite(inliers)]
    value = np.maximum(0, inliers[np.isfinite(inliers)] - FLOOR * min_matches)
    offsets, at = np.unique(offset, return_inverse=True)
    votes = np.bincount(at, value, minlength=len(offsets)).astype(np.float64)
    if not total:
        votes = votes / np.maximum(np.bincount(at, minlength=len(offsets)), 1)
    return offsets.astype(np.int32), votes.astype(np.float32)


# ---------------------------------------------------------------- constant offsets (papers 000, 001)


def _constant(p: Pass, q: Pass, book: PreviewBook, settings: NetworkSettings) -> OffsetResult:
    """One offset a camera pair: votes on sampled frames, then every frame within the range around the winner."""
    if p is q and len(p.images) == 1:
        return OffsetResult(Pairs.empty(), (), ())
    lattice, notes = _vote_constant(p, q, book, settings)
    backwards = p is not q and _backwards_by_votes(lattice, settings)
    voted = np.zeros(lattice.allowed.shape, bool)
    best = np.zeros(lattice.allowed.shape, int)
    for c, d in np.argwhere(lattice.allowed):
        offsets, votes = _votes(lattice, int(c), int(d), backwards, settings.min_matches, total=True)
        if not len(offsets):
            continue
        best[c, d] = offsets[np.argmax(votes)]
        voted[c, d] = _supported(lattice, (int(c), int(d), int(best[c, d])), backwards, settings)
    seen = np.isfinite(lattice.inliers)
    why = np.where(voted, REASONS.index("offset"), REASONS.index("votes"))
    code = np.broadcast_to(why[:, :, None, None], seen.shape)
    looked_at = Pairs.make(*lattice.images(seen), "offsets", score=lattice.inliers[seen], dropped=code[seen])
    blocks = [
        _around(lattice, (int(c), int(d), int(best[c, d])), backwards, book, settings) for c, d in np.argwhere(voted)
    ]
    for block in blocks:
        # Where both know a pair, the range decides: "offset" holds only outside of it.
        looked_at = looked_at.where(~_contained(looked_at, block)) | block
    return OffsetResult(looked_at, _curves(lattice, backwards, voted, settings, best), notes)


def _vote_constant(p: Pass, q: Pass, book: PreviewBook, settings: NetworkSettings) -> tuple[Lattice, tuple[str, ...]]:
    every = max(1, -(-len(q) // MAX_COLUMNS))
    allowed = allowed_within(p.rig, settings.axes_deg) if p is q else np.ones((len(p.images), len(q.images)), bool)
    empty = make_lattice(p, q, every, allowed)
    rows = _sampled(len(p), settings.sample_frames)
    shape = (*allowed.shape, len(rows), len(empty.columns))
    lattice = Lattice(p, q, rows, empty.columns, allowed, np.full(shape, np.nan, np.float32))
    c, d = np.ogrid[: shape[0], : shape[1]]
    wanted = np.broadcast_to((c < d) if p is q else np.ones((1, 1), bool), allowed.shape)[:, :, None, None]
    notes: tuple[str, ...] = ()
    if p is not q:  # three frames show the heading, then the axes rule pairs of cameras out
        few = np.isin(np.arange(len(rows)), _sampled(len(rows), 3))[:, None]
        lattice = _measured_oblong(lattice, wanted & few, book)
        excess = commonview.above(lattice, lattice.inliers, settings.min_matches)
        allowed, said = _facing(lattice, excess, settings), commonview.in_words(lattice, excess)
        notes = (said,) if said else ()
        lattice = Lattice(p, q, rows, lattice.columns, allowed, lattice.inliers)
    return _measured_oblong(lattice, wanted, book), notes


def _measured_oblong(lattice: Lattice, nodes: np.ndarray, book: PreviewBook) -> Lattice:
    """``Lattice.measured`` without mirroring: rows and columns are different frames."""
    nodes = np.broadcast_to(nodes, lattice.inliers.shape) & lattice.exists() & np.isnan(lattice.inliers)
    inliers = lattice.inliers.copy()
    inliers[nodes] = book.measure(*lattice.images(nodes))
    return Lattice(lattice.p, lattice.q, lattice.rows, lattice.columns, lattice.allowed, inliers)


def _backwards_by_votes(lattice: Lattice, settings: NetworkSettings) -> bool:
    """The direction in which the votes pile up higher."""
    height = [0.0, 0.0]
    for c, d in np.argwhere(lattice.allowed):
        for k, backwards in enumerate((False, True)):
            votes = _votes(lattice, int(c), int(d), backwards, settings.min_matches, total=True)[1]
            height[k] += float(votes.max(initial=0))
    return height[1] > height[0]


def _supported(lattice: Lattice, block: tuple[int, int, int], backwards: bool, settings: NetworkSettings) -> bool:
    """Whether the best offset has enough matches on average, over at least two sampled frames."""
    c, d, best = block
    m, n = np.meshgrid(lattice.rows, lattice.columns, indexing="ij")
    step = int(np.max(np.diff(lattice.columns), initial=1))
    inliers = lattice.inliers[c, d]
    near = (np.abs((n + m if backwards else n - m) - best) <= step) & np.isfinite(inliers)
    count = np.clip(inliers[near], FLOOR * settings.min_matches, CEILING * settings.min_matches)
    return int(near.any(axis=1).sum()) >= 2 and float(count.mean()) >= settings.min_matches


def _around(
    lattice: Lattice, block: tuple[int, int, int], backwards: bool, book: PreviewBook, settings: NetworkSettings
) -> Pairs:
    """All frames of a camera pair within the range around its offset; of these the best by preview if so set."""
    c, d, best = block
    p, q = lattice.p, lattice.q
    m, r = np.meshgrid(np.arange(len(p)), np.arange(-settings.offset_range, settings.offset_range + 1), indexing="ij")
    n = best + r - m if backwards else best + r + m
    there = (n >= 0) & (n < len(q))
    i = p.images[c, m[there]]
    j = q.images[d, n[there]]
    exists = (i >= 0) & (j >= 0) & (i != j)
    i, j = i[exists], j[exists]
    if settings.offset_best == 0:
        return Pairs.make(i, j, "offsets", score=book.known(i, j))
    score = book.measure(i, j)
    order = np.lexsort((-score, i))
    first = np.r_[True, np.diff(i[order]) != 0]
    start = np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order)) - start
    keep = (rank < settings.offset_best) & (score >= settings.min_matches)
    return Pairs.make(i, j, "offsets", score=score, dropped=np.where(keep, 0, REASONS.index("weak")))


def _contained(pairs: Pairs, other: Pairs) -> np.ndarray:
    """(P,) bool: rows of ``pairs`` that are in ``other`` too."""
    key = pairs.i.astype(np.int64) << 32 | pairs.j
    return np.isin(key, other.i.astype(np.int64) << 32 | other.j)
