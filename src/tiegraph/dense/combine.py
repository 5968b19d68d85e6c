"""One depth from the depths that several partners propose for a pixel (paper 004, section 5.3: multi-stereo)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# However coarse a pair is, depths further apart than this share of the depth are not the same surface.
MAX_RELATIVE = 0.05
# One standard deviation of a disparity, pixels: 0.24-0.29 for parabola interpolation on scenes with exact truth,
# 0.2-0.3 in paper 004; the larger figure also covers the smoothing of slanted surfaces.
SIGMA_DISPARITY_PX = 0.3


@dataclass(frozen=True, eq=False)
class Candidates:
    """What one partner proposes: inverse (H, W) f4 inverse depth, unit (H, W) f4 that of one pixel; NaN = none.

    Inverse depth is the natural variable: disparities are linear in it, and so are their errors.
    """

    inverse: np.ndarray
    unit: np.ndarray

    @staticmethod
    def nothing(shape: tuple[int, int]) -> Candidates:
        """A partner that proposes nothing."""
        empty = np.full(shape, np.nan, np.float32)
        return Candidates(empty, empty)


def combine(candidates: Sequence[Candidates], tolerance_px: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The best supported inverse depth: (inverse (H, W) f4, sigma (H, W) f4, support (H, W) u1 bit mask of partners).

    Each proposal is tried as the hypothesis; those within ``tolerance_px`` (of both pairs' pixels together, and within
    MAX_RELATIVE of the depth) agree with it. The hypothesis with the most agreeing partners wins, then the one with the
    smallest sigma; the result is their mean weighted by precision. The sigma follows from the disparity's and is
    enlarged where the agreeing depths scatter more than they should.
    """
    inverse = np.stack([c.inverse for c in candidates])
    unit = np.stack([c.unit for c in candidates])
    weight = np.where(np.isfinite(inverse), 1.0 / np.square(unit), 0.0).astype(np.float32)
    best = np.zeros(inverse.shape[1:], np.float32)
    support = np.zeros(inverse.shape[1:], np.uint8)
    for k in range(len(candidates)):
        agrees = _agreeing(inverse, unit, k, tolerance_px)
        information = np.sum(np.where(agrees, weight, 0), axis=0)
        # Votes first; information, squashed to below one vote, decides between equals.
        total = np.sum(weight, axis=0)
        score = agrees.sum(axis=0) + 0.99 * information / np.where(total > 0, total, 1)
        wins = score > best
        best = np.where(wins, score, best).astype(np.float32)
        bits = np.zeros_like(support)
        for j in range(len(candidates)):
            bits |= agrees[j].astype(np.uint8) << np.uint8(j)
        support = np.where(wins, bits, support)
    return *_mean(inverse, weight, support), support


def _agreeing(inverse: np.ndarray, unit: np.ndarray, k: int, tolerance_px: float) -> np.ndarray:
    """(K, H, W) bool: which proposals agree with the k-th."""
    tolerance = tolerance_px * np.hypot(unit, unit[k])
    tolerance = np.minimum(tolerance, MAX_RELATIVE * inverse[k])
    return np.abs(inverse - inverse[k]) <= tolerance  # NaN compares false


def _mean(inverse: np.ndarray, weight: np.ndarray, support: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    inside = np.stack([(support >> np.uint8(k)) & 1 for k in range(len(inverse))]).astype(bool)
    weight = np.where(inside, weight, 0)
    total = weight.sum(axis=0)
    safe = np.where(total > 0, total, 1)
    mean = np.sum(np.where(inside, inverse, 0) * weight, axis=0) / safe
    count = inside.sum(axis=0)
    chi2 = np.sum(weight * np.square(np.where(inside, inverse - mean, 0)), axis=0) / SIGMA_DISPARITY_PX**2
    inflation = np.sqrt(np.maximum(1.0, chi2 / np.maximum(count - 1, 1)))
    sigma = SIGMA_DISPARITY_PX * inflation / np.sqrt(safe)
    nan = np.float32(np.nan)
    known = total > 0
    return np.where(known, mean, nan).astype(np.float32), np.where(known, sigma, nan).astype(np.float32)
