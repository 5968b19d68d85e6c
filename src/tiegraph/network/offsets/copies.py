"""Two passes that hold the same pictures (copied, or written anew from one video): they tie without any base.

Files that are the same byte for byte never get here: scan leaves them out. Of others the previews tell: nothing has
moved and nearly every feature is found again.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.network.passes import MatchCache
from tiegraph.network.scorematrix import ScoreMatrix
from tiegraph.network.tuning.retrieval import CopiesTuning
from tiegraph.scene.sorting import evenly


@dataclass(frozen=True)
class Copies:
    """Image pairs i, j (K,) that show the same picture, and what to say."""

    i: np.ndarray
    j: np.ndarray
    note: str


def is_copy(result: Any, min_matches: int, tuning: CopiesTuning) -> bool:
    """Whether a preview match is of one picture twice. A camera that stood still looks the same, and has no base."""
    if result.inliers < tuning.strong * min_matches or result.shift is None or not len(result.matches):
        return False
    # No look at the rotation: the essential matrix of points that do not move is arbitrary.
    features = 1 + int(np.max(result.matches))  # the last feature that is found again
    still = np.linalg.norm(result.shift) <= tuning.max_shift
    return bool(still and result.inliers >= tuning.found_again * features)


def find_copies(scores: ScoreMatrix, cache: MatchCache, min_matches: int, tuning: CopiesTuning) -> Copies | None:
    """Same pictures in two passes of one rig; None within a pass and where the first look finds none."""
    p, q = scores.p, scores.q
    if scores.same or len(p.images) != len(q.images):
        return None
    camera, offset = _best_offset(scores, min_matches, tuning)
    for step in dict.fromkeys((0, *offset)):
        m = np.arange(max(0, -step), min(len(p), len(q) - step))
        some = m[evenly(len(m), tuning.samples)]
        if camera is None or not len(some):
            continue
        first = _copies(p.images[camera, some], q.images[camera, some + step], cache, min_matches, tuning)
        if first.sum() >= max(tuning.least, tuning.many * len(some)):
            return _all(scores, m, step, cache, min_matches, tuning)
    return None


def _best_offset(scores: ScoreMatrix, min_matches: int, tuning: CopiesTuning) -> tuple[int | None, tuple[int, ...]]:
    """The camera that matches itself best, and frame offsets n - m of its best nodes; None = no strong match."""
    own = np.stack([np.nan_to_num(scores.inliers[c, c]) for c in range(len(scores.inliers))])
    camera = int(own.max(axis=(1, 2)).argmax())
    a, b = np.nonzero(own[camera] >= max(tuning.strong * min_matches, tuning.near_best * own.max()))
    if not len(a):
        return None, ()
    values, counts = np.unique(scores.columns[b] - scores.rows[a], return_counts=True)
    return camera, tuple(int(v) for v in values[np.argsort(-counts, kind="stable")][: tuning.offsets])


def _copies(i: np.ndarray, j: np.ndarray, cache: MatchCache, min_matches: int, tuning: CopiesTuning) -> np.ndarray:
    """(K,) bool."""
    there = np.flatnonzero((i >= 0) & (j >= 0))
    out = np.zeros(len(i), bool)
    if len(there):
        results = cache.results(np.minimum(i, j)[there], np.maximum(i, j)[there])
        out[there] = [is_copy(r, min_matches, tuning) for r in results]
    return out


def _all(
    scores: ScoreMatrix, m: np.ndarray, step: int, cache: MatchCache, min_matches: int, tuning: CopiesTuning
) -> Copies:
    p, q = scores.p, scores.q
    i, j = p.images[:, m].ravel(), q.images[:, m + step].ravel()
    same = _copies(i, j, cache, min_matches, tuning)
    count, total = int(same.sum()), int((q.images >= 0).sum())
    note = f"pass {q.name} repeats pass {p.name}: {count} of {total} images show the same picture; "
    return Copies(i[same], j[same], note + "pairs of them carry no base and are dropped: leave one of the passes out")
