"""Constant frame offsets: one for each two cameras and passes, voted as in papers 000 and 001."""

from __future__ import annotations

import numpy as np

from tiegraph.network.offsets.curves import OffsetResult, contained, curves_of, facing, sampled_ranks, votes_of
from tiegraph.network.offsets.lattice import Lattice, make_lattice
from tiegraph.network.passes import Pass, PreviewBook
from tiegraph.network.rig import commonview
from tiegraph.network.rig.axes import allowed_within
from tiegraph.network.settings import NetworkSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.pairs import REASONS, Pairs


def constant_offsets(p: Pass, q: Pass, book: PreviewBook, settings: NetworkSettings, tuning: Tuning) -> OffsetResult:
    """One offset a camera pair: votes on sampled frames, then every frame within the range around the winner."""
    if p is q and len(p.images) == 1:
        return OffsetResult(Pairs.empty(), (), ())
    lattice, notes = _vote_constant(p, q, book, settings, tuning)
    backwards = p is not q and _backwards_by_votes(lattice, settings.min_matches, tuning)
    voted = np.zeros(lattice.allowed.shape, bool)
    best = np.zeros(lattice.allowed.shape, int)
    for c, d in np.argwhere(lattice.allowed):
        couple = int(c), int(d)
        offsets, votes = votes_of(lattice, couple, backwards, settings.min_matches, tuning.counts, total=True)
        if not len(offsets):
            continue
        best[c, d] = offsets[np.argmax(votes)]
        voted[c, d] = _supported(lattice, (*couple, int(best[c, d])), backwards, settings.min_matches, tuning)
    seen = np.isfinite(lattice.inliers)
    why = np.where(voted, REASONS.index("offset"), REASONS.index("votes"))
    code = np.broadcast_to(why[:, :, None, None], seen.shape)
    looked_at = Pairs.make(*lattice.images(seen), "offsets", score=lattice.inliers[seen], dropped=code[seen])
    blocks = [
        _around(lattice, (int(c), int(d), int(best[c, d])), backwards, book, settings) for c, d in np.argwhere(voted)
    ]
    for block in blocks:
        # Where both know a pair, the range decides: "offset" holds only outside of it.
        looked_at = looked_at.where(~contained(looked_at, block)) | block
    curves = curves_of(lattice, backwards, voted, settings.min_matches, tuning.counts, best)
    return OffsetResult(looked_at, curves, notes)


def _vote_constant(
    p: Pass, q: Pass, book: PreviewBook, settings: NetworkSettings, tuning: Tuning
) -> tuple[Lattice, tuple[str, ...]]:
    every = max(1, -(-len(q) // tuning.offsets.constant.max_columns))
    allowed = allowed_within(p.rig, settings.axes_deg) if p is q else np.ones((len(p.images), len(q.images)), bool)
    empty = make_lattice(p, q, every, allowed, tuning.offsets.lattice)
    rows = sampled_ranks(len(p), settings.sample_frames)
    shape = (*allowed.shape, len(rows), len(empty.columns))
    lattice = Lattice(
        p=p, q=q, rows=rows, columns=empty.columns, allowed=allowed, inliers=np.full(shape, np.nan, np.float32)
    )
    c, d = np.ogrid[: shape[0], : shape[1]]
    wanted = np.broadcast_to((c < d) if p is q else np.ones((1, 1), bool), allowed.shape)[:, :, None, None]
    notes: tuple[str, ...] = ()
    if p is not q:  # a few frames show the heading, then the axes rule pairs of cameras out
        few = np.isin(np.arange(len(rows)), sampled_ranks(len(rows), tuning.offsets.constant.heading_frames))[:, None]
        lattice = _measured_oblong(lattice, wanted & few, book)
        excess = commonview.above(lattice, lattice.inliers, settings.min_matches)
        allowed = facing(lattice, excess, settings, tuning.rig)
        said = commonview.in_words(lattice, excess, tuning.rig)
        notes = (said,) if said else ()
        lattice = Lattice(p=p, q=q, rows=rows, columns=lattice.columns, allowed=allowed, inliers=lattice.inliers)
    return _measured_oblong(lattice, wanted, book), notes


def _measured_oblong(lattice: Lattice, nodes: np.ndarray, book: PreviewBook) -> Lattice:
    """``Lattice.measured`` without mirroring: rows and columns are different frames."""
    nodes = np.broadcast_to(nodes, lattice.inliers.shape) & lattice.exists() & np.isnan(lattice.inliers)
    inliers = lattice.inliers.copy()
    inliers[nodes] = book.measure(*lattice.images(nodes))
    return Lattice(
        p=lattice.p, q=lattice.q, rows=lattice.rows, columns=lattice.columns, allowed=lattice.allowed, inliers=inliers
    )


def _backwards_by_votes(lattice: Lattice, min_matches: int, tuning: Tuning) -> bool:
    """The direction in which the votes pile up higher."""
    height = [0.0, 0.0]
    for c, d in np.argwhere(lattice.allowed):
        for k, backwards in enumerate((False, True)):
            votes = votes_of(lattice, (int(c), int(d)), backwards, min_matches, tuning.counts, total=True)[1]
            height[k] += float(votes.max(initial=0))
    return height[1] > height[0]


def _supported(
    lattice: Lattice, block: tuple[int, int, int], backwards: bool, min_matches: int, tuning: Tuning
) -> bool:
    """Whether the best offset has enough matches on average, over enough sampled frames."""
    c, d, best = block
    m, n = np.meshgrid(lattice.rows, lattice.columns, indexing="ij")
    step = int(np.max(np.diff(lattice.columns), initial=1))
    inliers = lattice.inliers[c, d]
    near = (np.abs((n + m if backwards else n - m) - best) <= step) & np.isfinite(inliers)
    count = np.clip(inliers[near], tuning.counts.floor * min_matches, tuning.counts.ceiling * min_matches)
    frames = int(near.any(axis=1).sum())
    return frames >= tuning.offsets.constant.least_frames and float(count.mean()) >= min_matches


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
