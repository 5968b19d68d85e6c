"""The pairs that stay whatever a design is after: those that hold every image, and every part, to the rest.

A pair may fail: previews promise, matching at full resolution tells. So one pair is not enough to hold an image. Across
every cut of the graph of candidates, that around a single image and that between two halves of the survey alike, the
strongest pairs stay until so many as are ``wanted`` of them are expected to be verified, or all of them.
"""

from __future__ import annotations

import numpy as np

from tiegraph.design.tuning import HoldingTuning
from tiegraph.scene.graph import forest, parts


def holding(
    i: np.ndarray, j: np.ndarray, strength: np.ndarray, chance: np.ndarray, nodes: int, tuning: HoldingTuning
) -> list[np.ndarray]:
    """Places of the pairs i, j (P,) that stay, in rounds; ``chance`` (P,) of being verified rises with ``strength``.

    Each round is a maximum spanning forest of the pairs left over, so k rounds hold the k strongest pairs across every
    cut (Nagamochi and Ibaraki 1992). A pair is done with when its ends are joined in so many forests that the weakest
    pairs on the ways between them are together worth ``wanted`` sure ones: each cut it crosses is crossed by those too.
    """
    left, sure = np.arange(len(i)), np.zeros(len(i))
    rounds: list[np.ndarray] = []
    steps = (*zip(tuning.chances, tuning.chances), (tuning.sure, 1.0))
    while len(left):
        tree = left[forest(i[left], j[left], strength[left], nodes)]
        rounds.append(tree)
        left = np.setdiff1d(left, tree)
        weakest = np.zeros(len(left))
        for least, worth in steps:
            sound = tree[chance[tree] >= least]
            part = parts(i[sound], j[sound], nodes)
            weakest[part[i[left]] == part[j[left]]] = worth
        sure[left] += weakest
        left = left[sure[left] < tuning.wanted]
    return rounds
