"""Is a loop there? What its previews reach must stand above what unrelated frames of this survey do, for the whole rig.

Walls that repeat tie two places for one or two cameras and some frames; at one place again, most cameras of the rig see
what the rig saw before. So the frame pairs of a loop are previewed by all cameras, also by those that had no part in
finding it.

A loop far from the path is believed if most cameras of the rig support it, each with the camera that the other end of
the loop named.
"""

import numpy as np

from tiegraph.network.offsets.background import Far
from tiegraph.network.passes import MatchCache
from tiegraph.network.retrieval.timeline import Timeline
from tiegraph.network.scorematrix import NoiseFloor
from tiegraph.network.tuning import Tuning
from tiegraph.network.tuning.retrieval import SignificanceTuning


def unrelated(
    line: Timeline, blocked: np.ndarray, cache: MatchCache, min_matches: int, tuning: Tuning
) -> NoiseFloor | None:
    """What previews of places that have nothing to do with each other reach; None in a short survey, where it cannot be
    told. ``blocked`` (C, C): cells that are near each other, or known to tie."""
    background = tuning.offsets.background
    if len(line.of_pass) < background.long_frames:
        return None
    rng = np.random.default_rng(0)
    c, d = np.triu_indices(line.image_at.shape[1])
    c, d = np.repeat(c, background.samples), np.repeat(d, background.samples)
    a, b = rng.integers(0, len(line.of_pass), (2, len(c)))
    left, right = line.image_at[a, c], line.image_at[b, d]
    fine = (left >= 0) & (right >= 0) & ~blocked[line.cell[a], line.cell[b]]
    if fine.sum() < background.enough:
        return None
    c, d, count = c[fine], d[fine], cache.measure(left[fine], right[fine])
    shape = (line.image_at.shape[1],) * 2
    far = Far(np.concatenate([c, d]), np.concatenate([d, c]), np.tile(count, 2))
    return far.noise_floor(shape, min_matches, tuning)


def seen_by_the_rig(
    line: Timeline,
    ends: tuple[np.ndarray, np.ndarray],
    patch: np.ndarray,
    cache: MatchCache,
    noise_floor: NoiseFloor,
    tuning: SignificanceTuning,
) -> np.ndarray:
    """(P,) bool: patches of image pairs ``ends`` i (K,), j (K,) that most cameras of the rig bear out; ``patch`` (K,).

    The largest ones are looked at; the others are not believed.
    """
    size = np.bincount(patch)
    most = max(1, len(line.of_pass) // tuning.places_a_loop)
    out = np.zeros(len(size), bool)
    for k in np.argsort(-size, kind="stable")[:most]:
        a, b = _frame_pairs(line, ends[0][patch == k], ends[1][patch == k], tuning.frame_pairs)
        out[k] = _share_speaking(line, (a, b), cache, noise_floor, tuning.speaks) >= tuning.most_cameras
    return out


def _frame_pairs(line: Timeline, i: np.ndarray, j: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """A few places a (K,), b (K,) along a patch of image pairs, each the one most of its images speak for."""
    a, b = line.place[i], line.place[j]
    a, b = np.minimum(a, b), np.maximum(a, b)
    key, votes = np.unique(a * len(line.of_pass) + b, return_counts=True)
    a, b = key // len(line.of_pass), key % len(line.of_pass)
    chosen = [part[np.argmax(votes[part])] for part in np.array_split(np.arange(len(key)), min(most, len(key)))]
    return a[chosen], b[chosen]


def _share_speaking(
    line: Timeline, places: tuple[np.ndarray, np.ndarray], cache: MatchCache, noise_floor: NoiseFloor, speaks: float
) -> float:
    """Share of the cameras that tie at ``places`` a (K,), b (K,) with a camera of the other place; of both the
    lower one.

    Which camera that is, one end of the loop says, and whether they tie the other end: the best of several chances
    would speak for any two places, and neighbouring frames see the same wall.
    """
    a, b = places
    left, right = np.broadcast_arrays(line.image_at[a][:, :, None], line.image_at[b][:, None, :])  # (K, S, S)
    there = (left >= 0) & (right >= 0)
    count = np.full(left.shape, np.nan)
    count[there] = cache.measure(left[there], right[there])
    high = noise_floor.highest
    above = (np.clip(count, noise_floor.lowest, high) - noise_floor.told) / (high - noise_floor.told)
    middle = len(a) // 2
    halves = [_mean(above[:middle]), _mean(above[middle:])] if middle else [_mean(above)] * 2
    shares = []
    for axis in (1, 2):
        told = [_at_best(choose, judge, axis - 1) for choose, judge in (halves, halves[::-1])]
        cameras = there.any(axis=(0, axis))
        shares.append(float(np.mean((np.mean(told, axis=0) >= speaks)[cameras])))
    return min(shares)


def _mean(above: np.ndarray) -> np.ndarray:
    """(S, S) mean of what is known (K, S, S), -1 where nothing is."""
    known = np.isfinite(above)
    return np.where(known.any(axis=0), np.nansum(above, axis=0) / np.maximum(known.sum(axis=0), 1), -1.0)


def _at_best(choose: np.ndarray, judge: np.ndarray, axis: int) -> np.ndarray:
    """(S,) of ``judge`` (S, S) where ``choose`` is highest along an axis."""
    best = np.argmax(choose, axis=axis, keepdims=True)
    return np.take_along_axis(judge, best, axis).squeeze(axis)
