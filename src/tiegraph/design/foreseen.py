"""The matches a pair may be expected to have, from the points of the preview model that both images should see.

Only a part of the candidates is ever previewed. Which tracks an unseen pair would join cannot be told from its expected
number of matches alone; the model's points can tell, for all candidates in the same way.
"""

from __future__ import annotations

import numpy as np

from tiegraph.scene.ties import Sights, Ties

_MIX = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))  # splitmix64


def foreseen_ties(i: np.ndarray, j: np.ndarray, expected: np.ndarray, sights: Sights) -> Ties:
    """Ties of pairs i < j (P,): of the points both images see, as many as matches are expected (P,), chosen at random
    but always the same ones. Pairs without a common point have none and are left out."""
    kept_i, kept_j, matches = [], [], []
    for a, b, count in zip(i.tolist(), j.tolist(), expected.tolist()):
        common, left, right = np.intersect1d(sights.of(a), sights.of(b), assume_unique=True, return_indices=True)
        if not len(common):
            continue
        chosen = _uniform(common, a, b) < count / len(common)
        kept_i.append(a)
        kept_j.append(b)
        matches.append(np.stack([left[chosen], right[chosen]], axis=1).astype(np.uint16))
    return Ties.make(np.array(kept_i, int), np.array(kept_j, int), matches)


def _uniform(point: np.ndarray, a: int, b: int) -> np.ndarray:
    """(K,) numbers in [0, 1) that depend on points and pair alone."""
    with np.errstate(over="ignore"):
        x = point.astype(np.uint64) * _MIX[0] + np.uint64(a) * _MIX[1] + np.uint64(b) * _MIX[2]
        x = (x ^ (x >> np.uint64(30))) * _MIX[1]
        x = (x ^ (x >> np.uint64(27))) * _MIX[2]
        x ^= x >> np.uint64(31)
    return (x >> np.uint64(11)).astype(np.float64) / float(1 << 53)
