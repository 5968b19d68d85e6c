"""The errors of positions: a white part, a slow part and one that all share, their sizes told by the residuals.

A position of stated sigma s is off by s (w n + g z) + c. n is white; z is a first-order Gauss-Markov process of unit
variance whose correlation falls as exp(-dt / tau); c is the same for all positions. A receiver states its sigma, and
not how it is made up. So w and g (of each level of the stated sigma) and tau are the likeliest after the residuals are
seen (restricted likelihood: Patterson and Thompson 1971; of variance components: Foerstner 1979, Koch 1999), with a
weak belief in the stated sigma beforehand. No residual tells c, nor what of z lasts longer than the survey: these stay
as wide as they are stated. What the images may bend of the model is among the unknowns (``sfm.shape``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize

from tiegraph.sfm.tuning.world import NoiseTuning

_REACH = np.log(100.0)  # of the logarithms of sizes: beyond, positions are made and not measured, or of another survey
_MOST = 1 - 1e-9  # correlation of two positions of one instant


@dataclass(frozen=True)
class Stated:
    """Of K positions: ``sigma`` (K, 3) as stated, its ``level`` (K,), ``time_s`` (K,), NaN = not known, and sigmas (3,)
    of what all of them have in common, metres, NaN = nothing."""

    sigma: np.ndarray
    level: np.ndarray
    time_s: np.ndarray
    common: np.ndarray

    @staticmethod
    def of_sigma(sigma: np.ndarray) -> Stated:
        """Places without times that have nothing in common."""
        count = len(sigma)
        return Stated(sigma=sigma, level=np.zeros(count, int), time_s=np.full(count, np.nan), common=np.full(3, np.nan))

    def where(self, mask: np.ndarray) -> Stated:
        """Some of the positions."""
        return Stated(sigma=self.sigma[mask], level=self.level[mask], time_s=self.time_s[mask], common=self.common)


@dataclass(frozen=True)
class Linear:
    """K positions and what else is known of D unknowns, linearised where they are.

    ``rows`` (K, 3, D + 1), metres: derivatives of places by the unknowns and, last, residuals. ``known``
    (D + 1, D + 1): the products of such rows, over their sigmas, of all else.
    """

    rows: np.ndarray
    stated: Stated
    known: np.ndarray


@dataclass(frozen=True)
class Sizes:
    """Of errors, over the stated sigma: ``white`` and ``slow`` by level (L,), and how long the latter last (s)."""

    white: np.ndarray
    slow: np.ndarray
    lasts_s: float


class PositionErrors:
    """The likeliest sizes of the errors of some positions, and what they leave of the unknowns."""

    def __init__(self, linear: Linear, tuning: NoiseTuning) -> None:
        self._linear, self._tuning = linear, tuning
        names, number, counts = np.unique(linear.stated.level, return_inverse=True, return_counts=True)
        few = counts < tuning.min_rows  # levels of a few positions share one size
        joined = np.where(few, few.argmax(), np.arange(len(names)))
        self._level = np.unique(joined[number], return_inverse=True)[1]
        order = np.argsort(linear.stated.time_s, kind="stable")  # NaN last
        self._order = order
        self._steps = np.diff(linear.stated.time_s[order])
        self._sides = (linear.rows / linear.stated.sigma[:, :, None])[order].reshape(len(order), -1)  # (K, 3 (D + 1))

    @cached_property
    def sizes(self) -> Sizes:
        """The likeliest after the residuals are seen."""
        levels = self._level.max(initial=-1) + 1
        start = np.log([*[np.sqrt(0.5)] * (2 * levels), self._tuning.slow_s])
        bounds = np.stack([start - _REACH, start + _REACH], axis=1)
        return self._of(minimize(self._unlikely, start, (start,), method="L-BFGS-B", bounds=bounds).x)

    @property
    def times_stated(self) -> float:
        """The errors over what is stated of them, median of the positions."""
        return float(np.median(np.hypot(self.sizes.white, self.sizes.slow)[self._level]))

    @staticmethod
    def _of(x: np.ndarray) -> Sizes:
        white, slow = np.exp(x[:-1]).reshape(2, -1)
        return Sizes(white=white, slow=slow, lasts_s=float(np.exp(x[-1])))

    def _unlikely(self, x: np.ndarray, believed: np.ndarray) -> float:
        """Twice the negative logarithm of the likelihood of sizes (their logarithms), but for a constant."""
        lost, normal = self._normal(self._of(x))
        left = normal[-1, -1] - normal[-1, :-1] @ np.linalg.solve(normal[:-1, :-1], normal[:-1, -1])
        off, levels = x - believed, len(x) // 2
        off[levels:-1] -= off[:levels]  # as much slow as white
        belief = float(np.sum((off / self._tuning.belief) ** 2))
        return lost + float(np.linalg.slogdet(normal[:-1, :-1])[1] + left) + belief

    def _normal(self, sizes: Sizes) -> tuple[float, np.ndarray]:
        """Logarithm of the determinant of the errors' covariance, and (D + 1, D + 1): the normal matrix, with the right
        side as its last column and the squares of the residuals in the corner."""
        level = self._level[self._order]
        slow = sizes.slow[level]
        precise = (slow / sizes.white[level]) ** 2  # all is read in units of the slow part
        steps = np.where(np.isfinite(self._steps), self._steps, np.inf)
        rho = np.minimum(np.exp(-steps / sizes.lasts_s), _MOST)
        free = 1 / (1 - rho**2)
        band = np.zeros((2, len(precise)))  # of the inverse covariance of the slow part, upper form, and of the white
        band[0, 1:] = -rho * free
        band[1] = 1 + np.append(0.0, free - 1) + np.append(free - 1, 0.0) + precise
        factor = cholesky_banded(band)
        lost = 2 * np.sum(np.log(factor[1] * slow)) - np.sum(np.log(precise)) - np.sum(np.log(free))
        sides = self._sides / slow[:, None]
        weighed = precise[:, None] * sides
        weighed -= precise[:, None] * cho_solve_banded((factor, False), weighed)
        sides, weighed = (v.reshape(len(precise) * 3, -1) for v in (sides, weighed))
        return 3 * float(lost), self._linear.known + sides.T @ weighed

    def step(self, considered: Mapping[int, float]) -> tuple[np.ndarray, np.ndarray]:
        """What the unknowns are to be moved by (D,) for the best fit, and their covariance (D, D).

        Those ``considered`` (number: sigma), which the positions hardly tell, stay where they are, and what they may be
        off by counts (Schmidt 1966): noise would carry a clock and with it all places far along a straight way.
        """
        normal = self._normal(self.sizes)[1]
        moved, covariance = np.zeros(len(normal) - 1), np.zeros((len(normal) - 1,) * 2)
        held = np.array(sorted(considered), int)
        free = np.setdiff1d(np.arange(len(moved)), held)
        covariance[np.ix_(free, free)] = np.linalg.pinv(normal[np.ix_(free, free)], hermitian=True)
        moved[free] = -covariance[np.ix_(free, free)] @ normal[free, -1]
        follows = np.zeros((len(moved), len(held)))  # what each unknown follows those that are held by
        follows[held, range(len(held))] = 1.0
        follows[free] = -covariance[np.ix_(free, free)] @ normal[np.ix_(free, held)]
        return moved, covariance + (follows * [considered[k] ** 2 for k in held]) @ follows.T
