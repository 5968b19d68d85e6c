"""Multi-stereo triangulation: one point on each ray of the base image from the disparities of all its partners
(paper 004, section 5.3 and figure 5).

A disparity is the place of the corresponding ray in the partner's epipolar image, and that place is a linear function
of the inverse depth along the base pixel's ray. So the intersection of all rays that minimises the errors in the
images is a weighted mean of inverse depths: the linear solution is already the one that Hartley & Zisserman refine to,
and what is left to refine is who takes part and with what weight.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.dense.tuning import RayTuning
from tiegraph.scene.results import row_strips


@dataclass(frozen=True, eq=False)
class Candidates:
    """What one partner proposes: inverse (H, W) f4 inverse depth, unit (H, W) f4 that of one pixel; NaN = none.

    Inverse depth is the natural variable: disparities are linear in it, and so are their errors.
    """

    inverse: np.ndarray
    unit: np.ndarray

    @staticmethod
    def nothing(shape: tuple[int, int]) -> "Candidates":
        """A partner that proposes nothing."""
        return Candidates(np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32))


@dataclass(frozen=True, eq=False)
class Triangulation:
    """inverse (H, W) f4 inverse depth along the base rays, sigma (H, W) f4 its standard deviation, NaN = none; support
    (H, W) u1 bit mask of the partners that took part; sigma_px that of one disparity."""

    inverse: np.ndarray
    sigma: np.ndarray
    support: np.ndarray
    sigma_px: float


def triangulate(candidates: Sequence[Candidates], tolerance_px: float, tuning: RayTuning) -> Triangulation:
    """The intersection of the base rays with their partners' rays.

    1. *Consensus*: the proposal that most others agree with, within ``tolerance_px`` of both pairs' pixels together and
       ``max_relative`` of the depth; between equals the one with most information.
    2. *Linear*: the mean of those that agree, weighted by precision.
    3. *Refined*: all partners judged again by their residual from the mean, those beyond ``tolerance_px`` left out, the
       others weighted by Huber.

    The sigma follows from the disparities' (``disparity_sigma_px``: what the partners of this image say of each other),
    the geometry of the rays that took part, and their residuals where these are larger than they should be.
    """
    shape = candidates[0].inverse.shape

    def proposals(pixels: slice) -> tuple[np.ndarray, np.ndarray]:
        """Of some pixels, (K, n) each."""
        chosen = ([values.ravel()[pixels] for values in (c.inverse, c.unit)] for c in candidates)
        inverse, unit = zip(*chosen, strict=True)
        return np.stack(inverse), np.stack(unit)

    count = candidates[0].inverse.size
    some = proposals(slice(None, None, max(1, count // 100_000)))  # pixels of an image that tell its sigma
    sigma_px = disparity_sigma_px(*some, tolerance_px, tuning)
    parts = row_strips((count, 1), 1 << 15)  # pixels solved together, so that the partners' columns stay in the cache
    found = [_solve(*proposals(pixels), tolerance_px, sigma_px, tuning) for pixels in parts]
    depth, sigma, support = (np.concatenate(part).reshape(shape) for part in zip(*found, strict=True))
    return Triangulation(inverse=depth, sigma=sigma, support=support, sigma_px=sigma_px)


def disparity_sigma_px(inverse: np.ndarray, unit: np.ndarray, tolerance_px: float, tuning: RayTuning) -> float:
    """One standard deviation of a disparity in this image, from the differences of the proposals (K, n) of its partners
    that agree; ``sigma_px`` of the tuning where too few do."""
    differences = [np.zeros(0, np.float32)]
    for j in range(len(inverse)):
        for k in range(j):
            apart = np.abs(inverse[j] - inverse[k]) / np.hypot(unit[j], unit[k])
            differences.append(apart[apart < tolerance_px])
    together = np.concatenate(differences)
    if len(together) < 1000:
        return tuning.sigma_px
    own = np.sqrt(1 - tuning.shared_variance)  # the shared part of an error does not differ
    return float(np.clip(1.4826 * np.median(together) / own, 0.1, 0.5))


def _solve(
    inverse: np.ndarray, unit: np.ndarray, tolerance_px: float, sigma_px: float, tuning: RayTuning
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The three steps for n pixels of K partners (K, n)."""
    known = np.isfinite(inverse)
    value = np.where(known, inverse, np.float32(0))
    weight = np.where(known, 1 / np.square(unit), np.float32(0))
    part = _consensus(inverse, unit, weight, tolerance_px, tuning.max_relative)
    mean = _mean(value, weight * part)
    for _ in range(2):
        residual = np.abs(inverse - mean) / unit  # pixels of disparity; NaN = none
        part = (residual <= tolerance_px) & (np.abs(inverse - mean) <= tuning.max_relative * mean)
        # Residual from which a ray loses weight, Huber's constant: 95 % efficient on normal errors
        robust = weight * part / np.maximum(1, np.where(part, residual, 0) / (1.345 * sigma_px))
        mean = _mean(value, robust, mean)
    bits = np.packbits(part, axis=0, bitorder="little")[0]  # of eight partners at most
    return mean, _sigma(value, weight * part, mean, sigma_px, tuning.shared_variance), bits


def _consensus(
    inverse: np.ndarray, unit: np.ndarray, weight: np.ndarray, tolerance_px: float, max_relative: float
) -> np.ndarray:
    """(K, n) bool: the largest set that agrees with one of its members."""
    count = len(inverse)
    agrees = np.zeros((count, count, inverse.shape[1]), bool)
    for j in range(count):
        agrees[j, j] = np.isfinite(inverse[j])
        for k in range(j):
            limit = tolerance_px * np.hypot(unit[j], unit[k])
            limit = np.minimum(limit, max_relative * np.minimum(inverse[j], inverse[k]))
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


def _sigma(
    value: np.ndarray, weight: np.ndarray, mean: np.ndarray, sigma_px: float, shared_variance: float
) -> np.ndarray:
    """(n,) f4 standard deviation of the inverse depth: the shared part of the errors does not average out."""
    total = weight.sum(axis=0)
    safe = np.where(total > 0, total, 1)
    count = np.sum(weight > 0, axis=0)
    own = (1 - shared_variance) * sigma_px**2
    chi2 = np.sum(weight * np.square(value - mean), axis=0) / own
    inflation = np.maximum(1, chi2 / np.maximum(count - 1, 1))
    # The shared error is one of the base image: as a disparity it is the same for all partners.
    shared = shared_variance * sigma_px**2 * np.square(np.sum(np.sqrt(weight), axis=0) / safe)
    sigma = np.sqrt(own * inflation / safe + shared)
    return np.where(total > 0, sigma, np.nan).astype(np.float32)
