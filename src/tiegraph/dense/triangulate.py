"""Multi-stereo triangulation: one point on each ray of the base image from the disparities of all its partners
(paper 004, section 5.3 and figure 5).

A disparity is the place of the corresponding ray in the partner's epipolar image, and that place is a linear function
of the inverse depth along the base pixel's ray. So the intersection of all rays that minimises the errors in the
images is a weighted mean of inverse depths: the linear solution is already the one that Hartley & Zisserman refine to,
and what is left to refine is who takes part and with what weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# However coarse a pair is, depths further apart than this share of the depth are not the same surface.
MAX_RELATIVE = 0.05
# One standard deviation of a disparity, pixels, where an image cannot tell its own: 0.2-0.3 in paper 004, and the
# larger figure also covers the smoothing of slanted surfaces.
SIGMA_DISPARITY_PX = 0.3
# Partners share the base image, and with it a part of their errors. On a rendered rig (exact truth) disparities err by
# 0.107-0.120 px and differ from each other by 0.085-0.099 px, on three images of canal by 0.15-0.23 and 0.11-0.24 px:
# the shared part of the variance is about 0.3.
_SHARED = 0.3
_SIGMA_LIMITS_PX = (0.1, 0.5)
_FEW = 1000  # pixels with two proposals; below, an image says nothing of its sigma
_SAMPLES = 100_000
_ROBUST = 1.345  # Huber's constant, in sigmas: 95 % efficient on normal errors
_REFINEMENTS = 2  # two or three rays settle at once, four or five in two steps
_STRIP_PIXELS = 1 << 15  # pixels solved together, so that the partners' columns stay in the cache


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


@dataclass(frozen=True, eq=False)
class Triangulated:
    """inverse (H, W) f4 inverse depth along the base rays, sigma (H, W) f4 its standard deviation, NaN = none; support
    (H, W) u1 bit mask of the partners that took part; sigma_px that of one disparity."""

    inverse: np.ndarray
    sigma: np.ndarray
    support: np.ndarray
    sigma_px: float


def triangulate(candidates: Sequence[Candidates], tolerance_px: float) -> Triangulated:
    """The intersection of the base rays with their partners' rays.

    1. *Consensus*: the proposal that most others agree with, within ``tolerance_px`` of both pairs' pixels together and
       MAX_RELATIVE of the depth; between equals the one with most information.
    2. *Linear*: the mean of those that agree, weighted by precision.
    3. *Refined*: all partners judged again by their residual from the mean, those beyond ``tolerance_px`` left out, the
       others weighted by Huber.

    The sigma follows from the disparities' (``disparity_sigma_px``: what the partners of this image say of each other),
    the geometry of the rays that took part, and their residuals where these are larger than they should be.
    """
    shape = candidates[0].inverse.shape
    inverse = np.stack([c.inverse.ravel() for c in candidates])
    unit = np.stack([c.unit.ravel() for c in candidates])
    sigma_px = disparity_sigma_px(inverse, unit, tolerance_px)
    found = [
        _solve(inverse[:, s : s + _STRIP_PIXELS], unit[:, s : s + _STRIP_PIXELS], tolerance_px, sigma_px)
        for s in range(0, inverse.shape[1], _STRIP_PIXELS)
    ]
    depth, sigma, support = (np.concatenate(part).reshape(shape) for part in zip(*found, strict=True))
    return Triangulated(depth, sigma, support, sigma_px)


def disparity_sigma_px(inverse: np.ndarray, unit: np.ndarray, tolerance_px: float) -> float:
    """One standard deviation of a disparity in this image, from the differences of the proposals (K, n) of its partners
    that agree; SIGMA_DISPARITY_PX where too few do."""
    step = max(1, inverse.shape[1] // _SAMPLES)
    inverse, unit = inverse[:, ::step], unit[:, ::step]
    differences = [np.zeros(0, np.float32)]
    for j in range(len(inverse)):
        for k in range(j):
            apart = np.abs(inverse[j] - inverse[k]) / np.hypot(unit[j], unit[k])
            differences.append(apart[apart < tolerance_px])
    together = np.concatenate(differences)
    if len(together) < _FEW:
        return SIGMA_DISPARITY_PX
    return float(np.clip(1.4826 * np.median(together) / np.sqrt(1 - _SHARED), *_SIGMA_LIMITS_PX))


def _solve(
    inverse: np.ndarray, unit: np.ndarray, tolerance_px: float, sigma_px: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The three steps for n pixels of K partners (K, n)."""
    known = np.isfinite(inverse)
    value = np.where(known, inverse, np.float32(0))
    weight = np.where(known, 1 / np.square(unit), np.float32(0))
    part = _consensus(inverse, unit, weight, tolerance_px)
    mean = _mean(value, weight * part)
    for _ in range(_REFINEMENTS):
        residual = np.abs(inverse - mean) / unit  # pixels of disparity; NaN = none
        part = (residual <= tolerance_px) & (np.abs(inverse - mean) <= MAX_RELATIVE * mean)
        robust = weight * part / np.maximum(1, np.where(part, residual, 0) / (_ROBUST * sigma_px))
        mean = _mean(value, robust, mean)
    return mean, _sigma(value, weight * part, mean, sigma_px), _bits(part)


def _consensus(inverse: np.ndarray, unit: np.ndarray, weight: np.ndarray, tolerance_px: float) -> np.ndarray:
    """(K, n) bool: the largest set that agrees with one of its members."""
    count = len(inverse)
    agrees = np.zeros((count, count, inverse.shape[1]), bool)
    for j in range(count):
        agrees[j, j] = np.isfinite(inverse[j])
        for k in range(j):
            limit = tolerance_px * np.hypot(unit[j], unit[k])
            limit = np.minimum(limit, MAX_RELATIVE * np.minimum(inverse[j], inverse[k]))
            agrees[j, k] = agrees[k, j] = np.abs(inverse[j] - inverse[k]) <= limit  # NaN compares false
    # Votes first; information, squashed to below one vote, decides between equals.
    total = weight.sum(axis=0)
    share = 0.99 / np.where(total > 0, total, 1)
    score = np.stack([a.sum(axis=0) + share * np.sum(weight * a, axis=0) for a in agrees])
    best = np.argmax(score, axis=0)
    return np.take_along_axis(agrees, best[None, None, :], axis=0)[0]


def _mean(value: np.ndarray, weight: np.ndarray, otherwise: np.ndarray | None = None) -> np.ndarray:
    """(n,) f4 weighted mean; where nothing has weight ``otherwise``, NaN without."""
    total = weight.sum(axis=0)
    mean = np.sum(value * weight, axis=0) / np.where(total > 0, total, 1)
    return np.where(total > 0, mean, np.nan if otherwise is None else otherwise).astype(np.float32)


def _sigma(value: np.ndarray, weight: np.ndarray, mean: np.ndarray, sigma_px: float) -> np.ndarray:
    """(n,) f4 standard deviation of the inverse depth: the shared part of the errors does not average out."""
    total = weight.sum(axis=0)
    safe = np.where(total > 0, total, 1)
    count = np.sum(weight > 0, axis=0)
    own = (1 - _SHARED) * sigma_px**2
    chi2 = np.sum(weight * np.square(value - mean), axis=0) / own
    inflation = np.maximum(1, chi2 / np.maximum(count - 1, 1))
    # The shared error is one of the base image: as a disparity it is the same for all partners.
    shared = _SHARED * sigma_px**2 * np.square(np.sum(np.sqrt(weight), axis=0) / safe)
    sigma = np.sqrt(own * inflation / safe + shared)
    return np.where(total > 0, sigma, np.nan).astype(np.float32)


def _bits(part: np.ndarray) -> np.ndarray:
    bits = np.zeros(part.shape[1], np.uint8)
    for k, row in enumerate(part):
        bits |= row.astype(np.uint8) << np.uint8(k)
    return bits
