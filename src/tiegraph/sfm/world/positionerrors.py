"""The errors of positions: a white part, a slow part and a common part, with sizes estimated from the residuals.

A position of stated sigma s has the error s (w n + g z) + c. n is white; z is a first-order Gauss-Markov process of
unit variance with correlation exp(-dt / tau); c is the same for all positions. A receiver states its sigma, but not
these parts. So w and g (for each level of the stated sigma) and tau are estimated from the residuals (restricted
likelihood: Patterson and Thompson 1971; variance components: Foerstner 1979, Koch 1999), with a weak prior at the
stated sigma. No residual shows c, nor the part of z that lasts longer than the survey: these keep their stated sizes.
The possible bend of the model, given its images, is among the unknowns (``sfm.shape``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize

from tiegraph.sfm.tuning.world import NoiseTuning

MEDIAN_CHI2_3 = 2.366  # median of chi-square with three degrees of freedom
_REACH = np.log(100.0)  # limit on the logarithms of sizes: beyond, positions are synthetic or of another survey
HARDLY = 0.9  # ratio to the prior sigma: an unknown with a larger one counts as undetermined
_OPEN = 1e-10  # of the information: an undetermined unknown gets a huge sigma instead of a singular matrix
_SAME = 1e-7  # of the log likelihood: a smaller step ends the search
_MOST = 1 - 1e-9  # correlation of two positions of one instant


@dataclass(frozen=True)
class Stated:
    """For K positions: ``sigma`` (K, 3) as stated, its ``level`` (K,), ``time_s`` (K,), NaN = unknown, and sigmas
    (3,) of their common error, metres, NaN = none."""

    sigma: np.ndarray
    level: np.ndarray
    time_s: np.ndarray
    common: np.ndarray

    def where(self, mask: np.ndarray) -> Stated:
        """Some of the positions."""
        return Stated(sigma=self.sigma[mask], level=self.level[mask], time_s=self.time_s[mask], common=self.common)


@dataclass(frozen=True)
class Sizes:
    """Sizes of errors relative to the stated sigma: ``white`` and ``slow`` by level (L,), and the correlation time
    (s)."""

    white: np.ndarray
    slow: np.ndarray
    lasts_s: float


class PositionErrors:
    """The maximum likelihood sizes of the errors of some positions, and the resulting estimate of D unknowns,
    linearised at their present values.

    ``rows`` (K, 3, D + 1), metres: derivatives of places by the unknowns and, last, residuals. ``known`` (D + 1, D +
    1): the products of such rows, divided by their sigmas, of all other information. ``near``: sizes of nearly the same
    positions, from which the search starts.
    """

    def __init__(
        self, rows: np.ndarray, stated: Stated, known: np.ndarray, tuning: NoiseTuning, near: Sizes | None = None
    ) -> None:
        self._stated, self._known, self._tuning, self._near = stated.sigma[:, 0], known, tuning, near
        names, number, counts = np.unique(stated.level, return_inverse=True, return_counts=True)
        few = counts < tuning.min_rows  # levels of a few positions share one size
        joined = np.where(few, few.argmax() if len(few) else 0, np.arange(len(names)))
        self._level = np.unique(joined[number], return_inverse=True)[1]
        self._order = np.argsort(stated.time_s, kind="stable")  # NaN last
        self._steps = np.diff(stated.time_s[self._order])
        self._sides = (rows / stated.sigma[:, :, None])[self._order].reshape(len(rows), 3 * rows.shape[2])

    @cached_property
    def sizes(self) -> Sizes:
        """The maximum likelihood sizes, given the residuals."""
        levels = self._level.max(initial=-1) + 1
        start = np.log([*[np.sqrt(0.5)] * (2 * levels), self._tuning.slow_s])
        bounds, first = np.stack([start - _REACH, start + _REACH], axis=1), start
        if self._near is not None:
            first = np.clip(np.log([*self._near.white, *self._near.slow, self._near.lasts_s]), *bounds.T)
        found = minimize(self._unlikely, first, (start,), method="L-BFGS-B", bounds=bounds, options={"ftol": _SAME})
        return self._of(found.x)

    @property
    def times_stated(self) -> float:
        """Ratio of the errors to their stated sigmas, median of the positions."""
        return float(np.median(np.hypot(self.sizes.white, self.sizes.slow)[self._level])) if len(self._level) else 1.0

    @property
    def levels(self) -> list[tuple[float, float, int]]:
        """For each level of the stated sigma, best first: that sigma (m), ratio of the errors to it, number of
        positions."""
        total = np.hypot(self.sizes.white, self.sizes.slow)
        of = [self._stated[self._level == k] for k in range(len(total))]
        return sorted((float(np.median(own)), float(factor), len(own)) for own, factor in zip(of, total))

    @staticmethod
    def _of(x: np.ndarray) -> Sizes:
        white, slow = np.exp(x[:-1]).reshape(2, -1)
        return Sizes(white=white, slow=slow, lasts_s=float(np.exp(x[-1])))

    def _unlikely(self, x: np.ndarray, believed: np.ndarray) -> float:
        """Twice the negative log likelihood of sizes (as logarithms), up to a constant."""
        lost, normal = self._normal(self._of(x))
        left = normal[-1, -1] - normal[-1, :-1] @ np.linalg.solve(normal[:-1, :-1], normal[:-1, -1])
        off, levels = x - believed, len(x) // 2
        off[levels:-1] -= off[:levels]  # prior: slow and white errors are equal
        belief = float(np.sum((off / self._tuning.belief) ** 2))
        return lost + float(np.linalg.slogdet(normal[:-1, :-1])[1] + left) + belief

    def _normal(self, sizes: Sizes) -> tuple[float, np.ndarray]:
        """Log determinant of the errors' covariance, and (D + 1, D + 1): the normal matrix, with the right-hand side
        as its last column and the sum of squared residuals in the corner."""
        if not len(self._order):  # control points alone may be all that is believed
            return 0.0, _regular(self._known)
        level = self._level[self._order]
        slow = sizes.slow[level]
        precise = (slow / sizes.white[level]) ** 2  # everything in units of the slow part
        steps = np.where(np.isfinite(self._steps), self._steps, np.inf)
        rho = np.minimum(np.exp(-steps / sizes.lasts_s), _MOST)
        free = 1 / (1 - rho**2)
        band = np.zeros((2, len(precise)))  # inverse covariance of the slow part in upper form, plus the white one's
        band[0, 1:] = -rho * free
        band[1] = 1 + np.append(0.0, free - 1) + np.append(free - 1, 0.0) + precise
        factor = cholesky_banded(band)
        lost = 2 * np.sum(np.log(factor[1] * slow)) - np.sum(np.log(precise)) - np.sum(np.log(free))
        sides = self._sides / slow[:, None]
        weighed = precise[:, None] * sides
        weighed -= precise[:, None] * cho_solve_banded((factor, False), weighed)
        sides, weighed = (v.reshape(len(precise) * 3, -1) for v in (sides, weighed))
        return 3 * float(lost), _regular(self._known + sides.T @ weighed)

    def step(self, believed: Mapping[int, float]) -> tuple[np.ndarray, np.ndarray]:
        """The step (D,) of the unknowns to the best fit, and their covariance (D, D).

        ``believed``: number and sigma of unknowns with a prior at their present value. Those that the positions
        hardly determine are held, and their uncertainty is propagated (Schmidt 1966): otherwise noise would move a
        clock offset, and with it all places, far along a straight path.
        """
        normal = self._normal(self.sizes)[1]
        every = np.linalg.inv(normal[:-1, :-1])
        held = np.array([k for k, sigma in believed.items() if every[k, k] > (HARDLY * sigma) ** 2], int)
        free = np.setdiff1d(np.arange(len(every)), held)
        own = np.linalg.inv(normal[np.ix_(free, free)])
        moved, follows = np.zeros(len(every)), np.zeros((len(every), len(held)))
        moved[free], follows[free] = -own @ normal[free, -1], -own @ normal[np.ix_(free, held)]
        follows[held, range(len(held))] = 1.0
        covariance = (follows * [believed[k] ** 2 for k in held]) @ follows.T
        covariance[np.ix_(free, free)] += own
        return moved, covariance


def _regular(normal: np.ndarray) -> np.ndarray:
    """The normal matrix (D + 1, D + 1), last the right-hand side, made solvable for undetermined unknowns."""
    unknowns, out = np.arange(len(normal) - 1), normal.copy()
    out[unknowns, unknowns] += _OPEN * np.maximum(np.diag(normal)[:-1], _OPEN)
    return out


# --- while poses, antenna and clock offset are estimated -------------------------------------------------------------


def factors(residual: np.ndarray, level: np.ndarray, tuning: NoiseTuning) -> np.ndarray:
    """(K,) factors on the sigmas, from residuals over sigma (K, 3); at least 1.

    The median of squares per level, so that single outliers are left to the robust loss.
    """
    out = np.ones(len(level))
    for value in np.unique(level) if len(level) >= tuning.min_rows else ():
        rows = level == value
        squares = np.sum(residual[rows if rows.sum() >= tuning.min_rows else slice(None)] ** 2, axis=1)
        out[rows] = np.clip(np.sqrt(np.median(squares) / MEDIAN_CHI2_3), 1.0, np.exp(_REACH))
    return out
