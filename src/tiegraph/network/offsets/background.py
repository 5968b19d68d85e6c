"""What a couple of cameras reach where their frames share nothing: chance, and walls that repeat.

Most frames of a long pass share nothing with a given other frame, so that this can be measured, and what speaks for a
tie is only what stands above it. Simulated canal with walls that come again every 12 m: half of the previews of one
camera in frames 50 m and more apart reach the count of a tie; without this every camera seemed to see the same for 60
frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from tiegraph.network.offsets.lattice import CEILING, FLOOR, SIGMA_NODES, Lattice, Level
from tiegraph.network.passes import Pass, PreviewBook

LONG = 60  # frames from which on most frames of a pass share nothing: evidence counts near its path only
FAR_SHARE = (0.4, 0.6)  # of a pass: frames so far apart share nothing, also where its end is its beginning
SAMPLES = 40  # far frame pairs of a pass that are previewed, for every two cameras
ENOUGH = 12  # previews of two cameras that tell their own level; of fewer, that of all
BAND = 0.15  # of the way from the level to the highest: what the frames at one distance from the path reach on average
OUTSTANDING = 0.99  # share of the previews of far frames that a pair passes that is believed by itself


@dataclass(frozen=True)
class Far:
    """Previews of frames that share nothing: cameras c (K,), d (K,), inliers (K,)."""

    c: np.ndarray
    d: np.ndarray
    count: np.ndarray

    def level(self, shape: tuple[int, ...], min_matches: int) -> Level:
        """The level of every two cameras, (S, T) of them."""
        low, high = FLOOR * min_matches, CEILING * min_matches
        value = np.clip(self.count, low, high)
        key = self.c * shape[1] + self.d
        number = np.bincount(key, minlength=shape[0] * shape[1])
        mean = np.bincount(key, value, minlength=len(number)) / np.maximum(number, 1)
        mean = np.where(number >= ENOUGH, mean, value.mean()).reshape(shape)
        return Level(mean, max(high, float(np.quantile(self.count, OUTSTANDING))), low, high)


def level_within(p: Pass, allowed: np.ndarray, book: PreviewBook, min_matches: int) -> Level | None:
    """The level between frames of one pass far from each other, for cameras that are ``allowed`` (S, S); None for a
    short pass."""
    if len(p) < LONG:
        return None
    rng = np.random.default_rng(len(p))
    apart = rng.integers(int(FAR_SHARE[0] * len(p)), int(FAR_SHARE[1] * len(p)) + 1, SAMPLES)
    a = rng.integers(0, len(p) - apart)
    b = a + apart
    a, b = np.where(rng.random(SAMPLES) < 0.5, (a, b), (b, a))
    c, d = np.nonzero(np.triu(allowed))
    c, d, a, b = np.repeat(c, SAMPLES), np.repeat(d, SAMPLES), np.tile(a, len(c)), np.tile(b, len(c))
    left, right = p.images[c, a], p.images[d, b]
    there = (left >= 0) & (right >= 0)
    if not there.any():
        return None
    count, c, d = book.measure(left[there], right[there]), c[there], d[there]
    return Far(np.concatenate([c, d]), np.concatenate([d, c]), np.tile(count, 2)).level(allowed.shape, min_matches)


def level_away(lattice: Lattice, beside: np.ndarray, min_matches: int) -> Level | None:
    """The level of the measured nodes that are not ``beside`` (A, B) the path between two passes."""
    c, d, a, b = np.nonzero(np.isfinite(lattice.inliers) & ~beside)
    if not len(c):
        return None
    return Far(c, d, lattice.inliers[c, d, a, b]).level(lattice.allowed.shape, min_matches)


def band(lattice: Lattice, path: np.ndarray, window: int) -> np.ndarray:
    """(S, T, A, B) bool: nodes as far from the ``path`` (A,) of two long passes as their cameras tie all along it.

    What two cameras share changes slowly along a pass, so that all its frames together tell at which distances they
    tie; a repeated wall ties frames at any distance, but only some of them.
    """
    level = lattice.level
    beside = np.rint(np.arange(len(lattice.columns)) - path[:, None]).astype(int) + window  # (A, B) bin
    inside = (beside >= 0) & (beside <= 2 * window)
    if level is None:
        return np.broadcast_to(inside, lattice.inliers.shape)
    c, d, a, b = np.nonzero(np.isfinite(lattice.inliers) & inside)
    shape = (*lattice.allowed.shape, 2 * window + 1)
    key = np.ravel_multi_index((c, d, beside[a, b]), shape)
    value = np.clip(lattice.inliers[c, d, a, b], level.lowest, level.highest)
    total, number = (np.bincount(key, w, np.prod(shape)).reshape(shape) for w in (value, np.ones(len(key))))
    total, number = (gaussian_filter1d(x, SIGMA_NODES, axis=2, mode="constant") for x in (total, number))
    span = (level.highest - level.told)[..., None]
    share = np.where(number > 0, (total / np.maximum(number, 1e-9) - level.told[..., None]) / span, -1.0)
    ties = share >= BAND
    peak = np.argmax(share, axis=2)
    ahead, back = np.arange(shape[2]) >= peak[..., None], np.arange(shape[2]) <= peak[..., None]
    # Of each two cameras the run of distances that holds the best one.
    upto = np.logical_and.accumulate(ties | ~ahead, axis=2) & ahead
    downto = np.logical_and.accumulate((ties | ~back)[..., ::-1], axis=2)[..., ::-1] & back
    run = (upto | downto) & ties
    return run[:, :, np.clip(beside, 0, 2 * window)] & inside
