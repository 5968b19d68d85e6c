"""Source ``offsets``: which frame of a pass a camera shares with which frame of the same or another pass.

Papers 000 (section c) and 001 (section b) vote, for every two cameras, on one constant frame offset and match a
limited range around it: mode ``constant`` (``tiegraph.papers.meguro2024``). Mode ``local`` (default) follows the
offset along the pass, because the speeds of two passes are never equal: previews on a coarse lattice of frames, grown
where they tie, smoothed and interpolated.

Two passes with the same pictures (copied, or encoded again from one video) tie without any base. Identical files do
not get here: scan leaves them out. Others are recognised by their previews: nothing has moved and nearly every
feature is found again.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from operator import or_
from typing import cast

import numpy as np

from tiegraph.errors import choose
from tiegraph.network import axes
from tiegraph.network.axes import allowed_within, angles_deg
from tiegraph.network.passes import Context, MatchCache, Pass, Proposal
from tiegraph.network.scorematrix import (
    NoiseFloor,
    ScoreMatrix,
    corridor,
    kernel_reach,
    noise_floor_away,
    noise_floor_within,
    score_matrix,
)
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import CountsTuning, RigTuning, Tuning
from tiegraph.scene.graph import best_line
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.sorting import evenly

Estimate = Callable[[Pass, Pass, MatchCache, CandidatesSettings, Tuning], Proposal]
OFFSETS: dict[str, Estimate] = {}
"""Named methods that estimate the offsets of each two passes separately, beside ``local`` of this module."""


@dataclass(frozen=True)
class _Survey:
    """One finished score matrix: smoothed counts, path."""

    scores: ScoreMatrix
    smooth: np.ndarray
    path: np.ndarray | None  # (A,) column node of each row; evidence far from it does not count
    reach: int  # nodes from the path within which evidence counts
    notes: tuple[str, ...]  # the budget of previews was spent before every tie was followed


def estimate_offsets(context: Context) -> Proposal:
    """Candidate pairs within and between passes by the mode of ``settings.offsets``."""
    passes, mode = context.passes, context.settings.offsets
    pass_pairs = [(a, b) for k, a in enumerate(passes) for b in passes[k:]]
    if mode == "local":
        parts = _local_offsets(context, pass_pairs)
    else:
        estimate = cast(Estimate, choose("mode of offsets", mode, OFFSETS))
        parts = [estimate(p, q, context.cache, context.settings, context.tuning) for p, q in pass_pairs]
    lost = axes.strangers([r.stranger for r in parts if r.stranger])
    merged = reduce(or_, parts, Proposal(Pairs.empty()))
    return replace(merged, notes=(*merged.notes, *lost))


def _local_offsets(context: Context, pass_pairs: list[tuple[Pass, Pass]]) -> list[Proposal]:
    """Every two passes, each with an equal share of the budget that is left; a coarser lattice where it is spent."""
    cache, tuning, offsets = context.cache, context.tuning, context.tuning.offsets
    budget = len(cache) + max(tuning.free_previews, tuning.previews_an_image * len(context.scene))
    strides = {id(p): _stride(context, p) for p in context.passes}
    parts = []
    for k, (p, q) in enumerate(pass_pairs):
        share = max(0, budget - len(cache)) // (len(pass_pairs) - k)
        stride = finest = min(strides[id(p)], strides[id(q)])
        survey = _survey(context, (p, q), (stride, offsets.window_nodes), len(cache) + share)
        while survey.notes and 4 * stride < max(len(p), len(q)):
            stride *= 2  # coarser: the nodes of the finer lattice are known and cost nothing
            # The same distance in frames from the path: otherwise pairs, and previews, would grow faster than the
            # images.
            window = max(3, offsets.window_nodes * finest // stride)
            survey = _survey(context, (p, q), (stride, window), len(cache) + share)
        local = _local(survey, context.settings.min_matches, tuning)
        parts.append(_without_copies(local, survey.scores, context))
    return parts


def _stride(context: Context, p: Pass) -> int:
    """Lattice stride in frames: a share of the frames over which a typical camera keeps seeing the same surface."""
    cache, settings, tuning = context.cache, context.settings, context.tuning
    reach = []
    starts = evenly(len(p), settings.sample_frames)
    noise_floor = noise_floor_within(p, allowed_within(p.rig, settings.axes_deg), cache, settings.min_matches, tuning)
    for camera, images in enumerate(p.images):
        best = 0
        for step in tuning.ladder:
            start = starts[starts + step < len(p)]
            left, right = images[start], images[start + step]
            there = (left >= 0) & (right >= 0)
            if not there.any():
                break
            count = cache.measure(left[there], right[there])
            if _usual(count, camera, noise_floor, settings.min_matches, tuning.counts) < settings.min_matches:
                break
            best = step
        reach.append(best)
    most = min(16, max(1, len(p) // 4))
    return int(np.clip(round(float(np.median(reach)) / tuning.strides_a_reach + 1), 1, most))


def _usual(
    count: np.ndarray, camera: int, noise_floor: NoiseFloor | None, min_matches: int, tuning: CountsTuning
) -> float:
    """The mean count of previews (K,) of one camera at one distance, above its noise floor."""
    if noise_floor is None:
        return float(np.median(count))
    mean = np.clip(count, tuning.floor * min_matches, tuning.ceiling * min_matches).mean()
    return float(noise_floor.above(mean, (camera, camera)))


def _survey(context: Context, couple: tuple[Pass, Pass], grid: tuple[int, int], budget: int) -> _Survey:
    """Seed the score matrix, then grow it from every tie until nothing new ties or the budget of previews is spent.

    ``grid``: stride in frames, and nodes from the path of long passes within which evidence counts.
    """
    (p, q), (stride, window) = couple, grid
    cache, least, tuning = context.cache, context.settings.min_matches, context.tuning
    reach = window + kernel_reach(tuning)
    if p is q:
        scores = _seed_same(context, p, stride)
        path = np.arange(len(scores.rows), dtype=float)
    else:
        scores, path = _seed_across(context, couple, stride, budget)
    path = path if min(len(p), len(q)) >= tuning.offsets.long_frames else None
    beside = _beside(scores, path, reach)
    smooth = scores.smoothed(least, tuning)
    touched, notes = np.ones(len(scores.rows), bool), ()
    while True:
        frontier = scores.frontier(smooth, 1.1 * least, beside, touched)  # noise alone must not spread
        if not len(frontier[0]):
            break
        if len(cache) + len(frontier[0]) > budget:
            notes = (f"{p.name} - {q.name}: the budget of previews was spent before every tie was followed",)
            break
        touched = scores.smooth_again(smooth, scores.measure(frontier, cache), least, tuning)
    return _Survey(scores=scores, smooth=smooth, path=path, reach=reach, notes=notes)


def _beside(scores: ScoreMatrix, path: np.ndarray | None, reach: int) -> np.ndarray:
    """(A, B) bool: nodes within reach of the path, or all without one. Further overlap of a long pass with itself or
    another is a loop: because repeated walls look the same, a lattice is not enough to confirm it (``retrieval``)."""
    if path is None:
        return np.ones((len(scores.rows), len(scores.columns)), bool)
    return np.abs(np.arange(len(scores.columns)) - path[:, None]) <= reach


def _seed_same(context: Context, p: Pass, stride: int) -> ScoreMatrix:
    """Sampled frames with the frames around them, for every two cameras that the axes permit."""
    settings, tuning = context.settings, context.tuning
    allowed = allowed_within(p.rig, settings.axes_deg)
    noise_floor = noise_floor_within(p, allowed, context.cache, settings.min_matches, tuning)
    scores = score_matrix(p, p, stride, allowed, noise_floor)
    c, d, a, b = np.ogrid[tuple(slice(n) for n in scores.inliers.shape)]
    once = (c < d) | ((c == d) & (a < b))  # of the two nodes with the same image pair
    sampled = np.isin(a, evenly(len(scores.rows), settings.sample_frames))
    near = sampled & (np.abs(a - b) <= tuning.offsets.window_nodes)
    return scores.measured(np.nonzero(once & near), context.cache)


def _seed_across(
    context: Context, couple: tuple[Pass, Pass], stride: int, budget: int
) -> tuple[ScoreMatrix, np.ndarray | None]:
    """A coarse grid over both passes gives the path and the heading; then sampled frames around the path."""
    cache, settings, tuning = context.cache, context.settings, context.tuning
    (p, q), offsets, least = couple, tuning.offsets, settings.min_matches
    scores = score_matrix(p, q, stride, np.ones((len(p.images), len(q.images)), bool))
    cameras = len(p.images) * len(q.images)
    side = int(np.sqrt(max(0, budget - len(cache)) / (2 * cameras)))  # half the budget: the rest is for growth
    nodes = min(24, max(4, side))
    a, b = np.ogrid[: len(scores.rows), : len(scores.columns)]
    coarse = np.isin(a, evenly(len(scores.rows), nodes)) & np.isin(b, evenly(len(scores.columns), nodes))
    scores = scores.measured(np.nonzero(np.broadcast_to(coarse, scores.inliers.shape)), cache)
    centre = None
    beside = np.ones(scores.inliers.shape[2:], bool)
    if min(len(p), len(q)) >= offsets.long_frames:
        centre = _minimum_cost_path(scores, least, tuning)
        beside = _beside(scores, centre, offsets.window_nodes + kernel_reach(tuning))
        scores = replace(scores, noise_floor=noise_floor_away(scores, beside, least, tuning))
    excess = axes.above(scores.smoothed(least, tuning), least) * beside
    scores = replace(scores, allowed=facing(scores, excess, settings))
    centre = _path(excess.sum(axis=(0, 1))) if centre is None else centre
    if centre is None:
        return scores, None
    near = np.isin(a, evenly(len(scores.rows), settings.sample_frames)) & _beside(scores, centre, offsets.window_nodes)
    return scores.measured(np.nonzero(np.broadcast_to(near, scores.inliers.shape)), cache), centre


def _minimum_cost_path(scores: ScoreMatrix, min_matches: int, tuning: Tuning) -> np.ndarray:
    """(A,) column node of each row on the strongest path through the overlap of the whole rig.

    Most frames of two long passes share nothing: their median is the level of chance and repeated walls.
    """
    low, high = tuning.counts.floor * min_matches, tuning.counts.ceiling * min_matches
    known = np.isfinite(scores.inliers)
    excess = np.where(known, np.clip(scores.inliers, low, high) - low, 0).sum(axis=(0, 1))
    mean = excess / np.maximum(known.sum(axis=(0, 1)), 1)
    rows = np.flatnonzero(known.any(axis=(0, 1, 3)))
    columns = np.flatnonzero(known.any(axis=(0, 1, 2)))
    grid = mean[np.ix_(rows, columns)]
    evidence = np.maximum(grid - np.median(grid), 0)
    node = best_line(evidence, 0.02 * float(evidence.max(initial=0)))  # a single peak does not attract it
    return np.interp(np.arange(len(scores.rows)), rows, columns[node])


def _path(weight: np.ndarray) -> np.ndarray | None:
    """(A,) column node with which a row of p shares most, interpolated between the rows with evidence."""
    rows = np.flatnonzero(weight.sum(axis=1) > 0)
    if not len(rows):
        return None
    columns = np.arange(weight.shape[1])
    centre = weight[rows] @ columns / weight[rows].sum(axis=1)
    return np.interp(np.arange(weight.shape[0]), rows, centre)


def _local(survey: _Survey, least: int, tuning: Tuning) -> Proposal:
    """Pairs kept by the interpolated surface, and measured pairs that were not kept, with the reason."""
    scores, counts = survey.scores, tuning.counts
    smooth = scores.confirmed(survey.smooth, least, tuning)
    smooth = axes.without_chance(scores, smooth, least, tuning)
    near = None
    if survey.path is not None:
        near = corridor(scores, survey.path, survey.reach, tuning)
        smooth = np.where(near | np.isnan(smooth), smooth, np.minimum(smooth, counts.floor * least))
    c, d, m, n, count = scores.interpolated(smooth, least, counts)
    i, j = scores.p.images[c, m], scores.q.images[d, n]
    there = (i >= 0) & (j >= 0) & (i != j)
    if survey.path is not None:
        beside = np.interp(m, scores.rows, np.interp(survey.path, np.arange(len(scores.columns)), scores.columns))
        there &= np.abs(n - beside) <= survey.reach * float(np.median(np.diff(scores.columns)))
    kept = Pairs.make(i[there], j[there], "offsets", score=count[there])
    seen = np.isfinite(scores.inliers)
    # A strong pair is kept whatever its neighbours show.
    sure = counts.ceiling * least if scores.noise_floor is None else scores.noise_floor.most
    strong = np.nan_to_num(scores.inliers) >= sure
    if near is not None:
        strong &= near
    voted = np.nan_to_num(smooth).max(axis=(2, 3), initial=0) >= least
    reason = np.where(voted | strong.any(axis=(2, 3)), REASONS.index("weak"), REASONS.index("votes"))
    nodes = np.nonzero(seen)  # of two long passes a small part: arrays of all nodes took 2 GiB each
    code = np.where(strong[nodes], 0, reason[nodes[:2]])
    measured = Pairs.make(*scores.images(seen), "offsets", score=scores.inliers[nodes], dropped=code)
    note, stranger = _said(scores, smooth, least, tuning.rig)
    return Proposal(pairs=measured | kept, notes=(*survey.notes, *note), stranger=stranger)


def _said(scores: ScoreMatrix, smooth: np.ndarray, min_matches: int, tuning: RigTuning) -> tuple[tuple[str, ...], str]:
    """How two passes relate to each other as a note, or their names if they have nothing in common."""
    if scores.same:
        return (), ""
    excess = axes.above(smooth, min_matches)
    if not excess.any():
        return (), f"{scores.p.name} - {scores.q.name}"
    said = axes.in_words(scores, excess, tuning)
    return ((said,) if said else ()), ""


def _without_copies(result: Proposal, scores: ScoreMatrix, context: Context) -> Proposal:
    """The proposal with pairs of the same picture dropped: they match best of all and have no base."""
    p, q, tuning = scores.p, scores.q, context.tuning.offsets
    if scores.same or len(p.images) != len(q.images):
        return result
    cameras = np.arange(len(p.images))
    own = np.nan_to_num(scores.inliers[cameras, cameras])
    camera = int(own.max(axis=(1, 2)).argmax())  # the one that matches itself best
    a, b = np.nonzero(own[camera] >= max(tuning.copy_matches * context.settings.min_matches, 0.8 * own.max()))
    if not len(a):
        return result
    steps, nodes = np.unique(scores.columns[b] - scores.rows[a], return_counts=True)
    for step in dict.fromkeys((0, *steps[np.argsort(-nodes, kind="stable")][:2].tolist())):
        m = np.arange(max(0, -step), min(len(p), len(q) - step))
        some = m[evenly(len(m), 6)]
        first = _copies(context, p.images[camera, some], q.images[camera, some + step])
        if first.sum() < max(2, len(some) / 2):
            continue
        i, j = p.images[:, m].ravel(), q.images[:, m + step].ravel()
        same = _copies(context, i, j)
        twins = Pairs.make(i[same], j[same], "offsets", score=context.cache.known(i[same], j[same]))
        note = (
            f"pass {q.name} repeats pass {p.name}: {int(same.sum())} of {int((q.images >= 0).sum())} images show the "
            "same picture; their pairs have no base and are dropped: leave out one of the passes"
        )
        pairs = result.pairs | twins
        return replace(result, pairs=pairs.drop(pairs.isin(twins), "similar"), notes=(*result.notes, note))
    return result


def _copies(context: Context, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(K,) bool: image pairs of the same picture, or of a camera at rest, which has no base either; -1 = no image."""
    tuning, out = context.tuning.offsets, np.zeros(len(i), bool)
    there = np.flatnonzero((i >= 0) & (j >= 0))
    found = context.cache.results(np.minimum(i, j)[there], np.maximum(i, j)[there]) if len(there) else []
    least = tuning.copy_matches * context.settings.min_matches
    for k, match in zip(there, found):
        if match.inliers >= least and match.shift is not None and len(match.matches):
            # The rotation is not tested: the essential matrix of points that do not move is arbitrary.
            still = np.linalg.norm(match.shift) <= 0.003  # of the image size
            features = 1 + int(np.max(match.matches))  # the last feature that is found again
            out[k] = still and match.inliers >= tuning.found_again * features
    return out


def facing(scores: ScoreMatrix, excess: np.ndarray, settings: CandidatesSettings) -> np.ndarray:
    """(S, T) bool: camera pairs whose axes permit a match at the heading of q relative to p; all,
    if that is unknown."""
    yaw = axes.yaw(scores, excess)
    if yaw is None:
        return np.ones(excess.shape[:2], bool)
    return angles_deg(scores.p.rig, yaw) <= settings.axes_deg
