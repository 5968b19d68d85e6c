"""Is a loop there? What its previews reach must stand above what unrelated frames of this survey do, for the whole rig.

Walls that repeat tie two places for one or two cameras and some frames; at one place again, most cameras of the rig see
what the rig saw before. So the frame pairs of a loop are previewed by all cameras, also by those that had no part in
finding it.
"""

from __future__ import annotations

import numpy as np

from tiegraph.network.looks.timeline import Timeline
from tiegraph.network.offsets.background import ENOUGH, LONG, SAMPLES, Far
from tiegraph.network.offsets.lattice import Level
from tiegraph.network.passes import PreviewBook

FRAME_PAIRS = 8  # of a loop that all cameras are previewed at
SPEAKS = 0.35  # of the way from the level of unrelated frames to the highest: what a camera must reach there
MOST_CAMERAS = 0.5  # share of a rig's cameras that must
PLACES_A_LOOP = 16  # of the survey's places: so many loops are looked at so closely


def unrelated(line: Timeline, blocked: np.ndarray, book: PreviewBook, min_matches: int) -> Level | None:
    """What previews of places that have nothing to do with each other reach; None in a short survey, where it cannot be
    told. ``blocked`` (C, C): cells that are near each other, or known to tie."""
    if len(line.of_pass) < LONG:
        return None
    rng = np.random.default_rng(0)
    c, d = np.triu_indices(line.image_at.shape[1])
    c, d = np.repeat(c, SAMPLES), np.repeat(d, SAMPLES)
    a, b = rng.integers(0, len(line.of_pass), (2, len(c)))
    left, right = line.image_at[a, c], line.image_at[b, d]
    fine = (left >= 0) & (right >= 0) & ~blocked[line.cell[a], line.cell[b]]
    if fine.sum() < ENOUGH:
        return None
    c, d, count = c[fine], d[fine], book.measure(left[fine], right[fine])
    shape = (line.image_at.shape[1],) * 2
    return Far(np.concatenate([c, d]), np.concatenate([d, c]), np.tile(count, 2)).level(shape, min_matches)


def seen_by_the_rig(
    line: Timeline, ends: tuple[np.ndarray, np.ndarray], patch: np.ndarray, book: PreviewBook, level: Level
) -> np.ndarray:
    """(P,) bool: patches of image pairs ``ends`` i (K,), j (K,) that most cameras of the rig bear out; ``patch`` (K,).

    The largest ones are looked at; the others are not believed.
    """
    size = np.bincount(patch)
    most = max(1, len(line.of_pass) // PLACES_A_LOOP)
    out = np.zeros(len(size), bool)
    for k in np.argsort(-size, kind="stable")[:most]:
        a, b = _frame_pairs(line, ends[0][patch == k], ends[1][patch == k])
        out[k] = _share_speaking(line, a, b, book, level) >= MOST_CAMERAS
    return out


def _frame_pairs(line: Timeline, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A few places a (K,), b (K,) along a patch of image pairs, each the one most of its images speak for."""
    a, b = line.place[i], line.place[j]
    a, b = np.minimum(a, b), np.maximum(a, b)
    key, votes = np.unique(a * len(line.of_pass) + b, return_counts=True)
    a, b = key // len(line.of_pass), key % len(line.of_pass)
    chosen = [part[np.argmax(votes[part])] for part in np.array_split(np.arange(len(key)), min(FRAME_PAIRS, len(key)))]
    return a[chosen], b[chosen]


def _share_speaking(line: Timeline, a: np.ndarray, b: np.ndarray, book: PreviewBook, level: Level) -> float:
    """Share of the cameras that tie, in the mean over places a (K,), b (K,), with any camera at the other place; of the
    two places the lower one."""
    left, right = line.image_at[a][:, :, None], line.image_at[b][:, None, :]
    left, right = np.broadcast_arrays(left, right)  # (K, S, S)
    there = (left >= 0) & (right >= 0)
    count = np.zeros(left.shape)
    count[there] = book.measure(left[there], right[there])
    high = level.highest
    value = np.where(there, np.clip(count, level.lowest, high), 0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    speaks = (value - level.mean >= SPEAKS * (high - level.mean)) & there.any(axis=0)
    cameras = [there.any(axis=(0, 2)), there.any(axis=(0, 1))]
    return min(float(speaks.any(axis=axis)[c].mean()) for axis, c in zip((1, 0), cameras))
