"""How much worse positions are than their sigmas say: factors by level of the stated sigma, and their correlation.

Receivers state sigmas that hold from one epoch to the next; multipath and float ambiguities wander over seconds. Each
level of the stated sigma gets one factor from the residuals of its fixes (variance components), and one for the
correlation of neighbours in time, so that many rows of one wandering solution do not outweigh a few good ones.
"""

import numpy as np

from tiegraph.sfm.tuning.world import NoiseTuning

MEDIAN_CHI2_3 = 2.366  # median of chi-square with three degrees of freedom


def factors(residual: np.ndarray, level: np.ndarray, time_s: np.ndarray, tuning: NoiseTuning) -> np.ndarray:
    """(K,) by which sigmas are to be multiplied, from residuals over sigma (K, 3); at least 1.

    The median of squares per level, so that single outliers are left to the robust loss; times sqrt((1 + r) / (1 - r))
    for the correlation r of neighbours in time (the effective number of a first-order process).
    """
    out = np.ones(len(level))
    for rows in _levels(level):
        if len(rows) < tuning.min_rows:
            rows_of = np.ones(len(level), bool) if len(level) >= tuning.min_rows else np.zeros(len(level), bool)
            if rows_of.any():
                out[rows] = _scatter(residual)
            continue
        r = correlation(residual[rows], time_s[rows], tuning)
        out[rows] = min(_scatter(residual[rows]) * float(np.sqrt((1 + r) / (1 - r))), tuning.max_factor)
    return out


def _levels(level: np.ndarray) -> list[np.ndarray]:
    return [np.flatnonzero(level == v) for v in np.unique(level)]


def _scatter(residual: np.ndarray) -> float:
    squares = np.sum(residual**2, axis=1)
    return max(1.0, float(np.sqrt(np.median(squares) / MEDIAN_CHI2_3)))


def correlation(residual: np.ndarray, time_s: np.ndarray, tuning: NoiseTuning) -> float:
    """Correlation of residuals (K, 3) with those of the next in time, not negative; 0 without times.

    Not about their mean: an offset common to all is the strongest correlation there is.
    """
    known = np.flatnonzero(np.isfinite(time_s))
    if len(known) < tuning.min_rows:
        return 0.0
    length = np.linalg.norm(residual, axis=1, keepdims=True)
    short = residual * np.minimum(1.0, np.median(length) / np.maximum(length, 1e-12))  # an outlier must not decide
    in_order = short[known[np.argsort(time_s[known], kind="stable")]]
    a, b = in_order[:-1], in_order[1:]
    return float(np.clip(2 * np.sum(a * b) / max(np.sum(a**2 + b**2), 1e-12), 0.0, tuning.max_correlation))
