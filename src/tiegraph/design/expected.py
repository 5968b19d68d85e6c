"""How many preview matches a candidate pair is expected to have that was never previewed."""

from __future__ import annotations

import numpy as np

from tiegraph.design.tuning import ExpectedTuning
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.pairs import Pairs


def expected_matches(pairs: Pairs, ties: PreviewMatches | None, tuning: ExpectedTuning) -> np.ndarray:
    """(P,) preview matches of each pair, measured or expected, at least 1.

    Counted matches first; else the score; else what previewed pairs of that predicted overlap have on average (a
    monotone curve through bins); else the median of what is known. A measured count below the ``floor`` of what the
    overlap promises is lifted to that.
    """
    counted = counted_matches(pairs, ties)
    measured = np.where(np.isnan(counted), pairs.score, counted)
    by_overlap = _curve(pairs.overlap, measured, tuning)(pairs.overlap)
    usual = float(np.nanmedian(measured)) if np.isfinite(measured).any() else 1.0
    out = np.where(np.isfinite(measured), np.fmax(measured, tuning.floor * by_overlap), by_overlap)
    return np.maximum(np.where(np.isfinite(out), out, usual), 1.0)


def counted_matches(pairs: Pairs, ties: PreviewMatches | None) -> np.ndarray:
    """(P,) preview matches of the pairs that were previewed, NaN for the others."""
    if ties is None or not len(ties):
        return np.full(len(pairs), np.nan)
    row = ties.find(pairs.i, pairs.j)
    return np.where(row >= 0, ties.counts()[row], np.nan)


class _Curve:
    """Matches by overlap, linear between bins and through zero."""

    def __init__(self, overlap: np.ndarray, matches: np.ndarray) -> None:
        self.overlap, self.matches = overlap, matches

    def __call__(self, overlap: np.ndarray) -> np.ndarray:
        value = np.interp(np.nan_to_num(overlap), self.overlap, self.matches)
        return np.where(np.isnan(overlap), np.nan, value)


def _curve(overlap: np.ndarray, measured: np.ndarray, tuning: ExpectedTuning) -> _Curve:
    both = np.isfinite(overlap) & np.isfinite(measured)
    bins = min(tuning.bins, int(both.sum()) // tuning.least_a_bin)
    if bins < 1:
        return _Curve(np.array([0.0, 1.0]), np.array([0.0, tuning.at_full_overlap]))
    order = np.argsort(overlap[both], kind="stable")
    groups = np.array_split(order, bins)
    at = np.array([overlap[both][g].mean() for g in groups])
    value = _rising(np.array([measured[both][g].mean() for g in groups]))
    at, first = np.unique(np.r_[0.0, at], return_index=True)
    return _Curve(at, np.r_[0.0, value][first])


def _rising(value: np.ndarray) -> np.ndarray:
    """The nearest sequence that never falls (pooling of neighbours)."""
    blocks: list[list[float]] = []  # mean, size
    for v in value:
        blocks.append([float(v), 1.0])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            (a, m), (b, n) = blocks[-2:]
            blocks[-2:] = [[(a * m + b * n) / (m + n), m + n]]
    return np.concatenate([np.full(int(n), v) for v, n in blocks])
