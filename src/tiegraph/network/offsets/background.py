"""The noise floor of preview matches: counts of unrelated frames, by chance or from repeated walls.

Most frames of a long pass share nothing with a given other frame, so their counts can be measured, and only counts
above them are evidence of a tie. Simulated canal with walls that repeat every 12 m: half of the previews of one
camera in frames 50 m and more apart reach the count of a tie; without the noise floor every camera seemed to see the
same for 60 frames.

It is measured for every pair of cameras. Evidence counts above it, and only at those distances from the path at which
two cameras tie all along it.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from tiegraph.network.passes import MatchCache, Pass
from tiegraph.network.scorematrix import NoiseFloor, ScoreMatrix
from tiegraph.network.tuning import Tuning


def noise_floor(
    cameras: tuple[np.ndarray, np.ndarray], count: np.ndarray, shape: tuple[int, ...], min_matches: int, tuning: Tuning
) -> NoiseFloor:
    """The noise floor of every pair of cameras (S, T), from previews (K,) of unrelated frames, of ``cameras`` c (K,)
    and d (K,)."""
    low, high = tuning.counts.floor * min_matches, tuning.counts.ceiling * min_matches
    value, key = np.clip(count, low, high), cameras[0] * shape[1] + cameras[1]
    number = np.bincount(key, minlength=shape[0] * shape[1])
    mean = np.bincount(key, value, minlength=len(number)) / np.maximum(number, 1)
    mean = np.where(number >= tuning.offsets.background.enough, mean, value.mean()).reshape(shape)
    most = max(high, float(np.quantile(count, 0.99)))
    return NoiseFloor(mean=mean, most=most, lowest=low, highest=high, most_level=tuning.offsets.scores.most_level)


def noise_floor_within(
    p: Pass, allowed: np.ndarray, cache: MatchCache, min_matches: int, tuning: Tuning
) -> NoiseFloor | None:
    """The noise floor from frames of one pass far from each other, for cameras that are ``allowed`` (S, S); None for
    a short pass."""
    if len(p) < tuning.offsets.background.long_frames:
        return None
    rng = np.random.default_rng(len(p))
    # At this distance frames share nothing, even if the end of a pass is its beginning
    (least, most), samples = (0.4, 0.6), tuning.offsets.background.samples
    apart = rng.integers(int(least * len(p)), int(most * len(p)) + 1, samples)
    a = rng.integers(0, len(p) - apart)
    b = a + apart
    a, b = np.where(rng.random(samples) < 0.5, (a, b), (b, a))
    c, d = np.nonzero(np.triu(allowed))
    c, d, a, b = np.repeat(c, samples), np.repeat(d, samples), np.tile(a, len(c)), np.tile(b, len(c))
    left, right = p.images[c, a], p.images[d, b]
    there = (left >= 0) & (right >= 0)
    if not there.any():
        return None
    count, c, d = cache.measure(left[there], right[there]), c[there], d[there]
    return noise_floor((np.r_[c, d], np.r_[d, c]), np.tile(count, 2), allowed.shape, min_matches, tuning)


def noise_floor_away(scores: ScoreMatrix, beside: np.ndarray, min_matches: int, tuning: Tuning) -> NoiseFloor | None:
    """The noise floor from the measured nodes that are not ``beside`` (A, B) the path between two passes."""
    c, d, a, b = np.nonzero(np.isfinite(scores.inliers) & ~beside)
    if not len(c):
        return None
    return noise_floor((c, d), scores.inliers[c, d, a, b], scores.allowed.shape, min_matches, tuning)


def corridor(scores: ScoreMatrix, path: np.ndarray, window: int, tuning: Tuning) -> np.ndarray:
    """(S, T, A, B) bool: nodes at those distances from the ``path`` (A,) of two long passes at which their cameras
    tie all along it.

    The overlap of two cameras changes slowly along a pass, so all its frames together show at which distances they
    tie; a repeated wall ties frames at any distance, but only some of them.
    """
    floor = scores.noise_floor
    beside = np.rint(np.arange(len(scores.columns)) - path[:, None]).astype(int) + window  # (A, B) bin
    inside = (beside >= 0) & (beside <= 2 * window)
    if floor is None:
        return np.broadcast_to(inside, scores.inliers.shape)
    c, d, a, b = np.nonzero(np.isfinite(scores.inliers) & inside)
    shape = (*scores.allowed.shape, 2 * window + 1)
    key = np.ravel_multi_index((c, d, beside[a, b]), shape)
    value = np.clip(scores.inliers[c, d, a, b], floor.lowest, floor.highest)
    total, number = (np.bincount(key, w, np.prod(shape)).reshape(shape) for w in (value, np.ones(len(key))))
    total, number = (gaussian_filter1d(x, tuning.counts.sigma_nodes, axis=2, mode="constant") for x in (total, number))
    span = (floor.highest - floor.told)[..., None]
    share = np.where(number > 0, (total / np.maximum(number, 1e-9) - floor.told[..., None]) / span, -1.0)
    ties = share >= tuning.offsets.background.band
    peak = np.argmax(share, axis=2)
    ahead, back = np.arange(shape[2]) >= peak[..., None], np.arange(shape[2]) <= peak[..., None]
    # For each pair of cameras, the run of distances that contains the best one.
    upto = np.logical_and.accumulate(ties | ~ahead, axis=2) & ahead
    downto = np.logical_and.accumulate((ties | ~back)[..., ::-1], axis=2)[..., ::-1] & back
    run = (upto | downto) & ties
    return run[:, :, np.clip(beside, 0, 2 * window)] & inside
