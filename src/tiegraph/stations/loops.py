"""Which pairs agree with each other: loops of three, and what hangs together by pairs that no loop contradicts."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tiegraph.geometry import transforms
from tiegraph.stations.pairs import Pair
from tiegraph.stations.tuning import LoopTuning


def motion(error: np.ndarray, xyz: np.ndarray) -> float:
    """RMS by which an error (4, 4) moves points (N, 3)."""
    return float(np.sqrt(np.mean(np.sum((transforms.apply(error, xyz) - xyz) ** 2, axis=1))))


def contradicted(pairs: Sequence[Pair], points: Sequence[np.ndarray], close_m: float, tuning: LoopTuning) -> list[Pair]:
    """The pairs; those that are contradicted by more loops of three than bear them out, worst first, have a reason.

    ``points``: some (N, 3) of each station, which say what a loop that does not close moves; ``close_m``: how far at
    most.
    """
    by_ends = {(p.first, p.second): p for p in pairs if not p.why_not}
    loops = _loops(by_ends, points)
    refused: dict[tuple[int, int], str] = {}
    while True:
        good = dict.fromkeys(by_ends, 0)
        bad = dict.fromkeys(by_ends, 0)
        for around, off in loops:
            if not any(e in refused for e in around):
                for e in around:
                    (good if off <= close_m else bad)[e] += 1
        worst = max(by_ends, key=lambda e: (bad[e] - good[e], bad[e], e), default=None)
        if worst is None or bad[worst] <= good[worst]:
            break
        refused[worst] = f"{bad[worst]} loops of three contradict it and {good[worst]} bear it out"
    for ends, pair in by_ends.items():
        if ends not in refused and not good[ends] and pair.overlap < tuning.alone_overlap:
            refused[ends] = f"no loop bears it out, and {pair.overlap:.0%} overlap is too little for a pair alone"
    return [p.refused(refused[p.first, p.second]) if (p.first, p.second) in refused else p for p in pairs]


def _loops(
    pairs: dict[tuple[int, int], Pair], points: Sequence[np.ndarray]
) -> list[tuple[list[tuple[int, int]], float]]:
    """The ends of the three pairs of each loop, and by how much it does not close, metres."""
    out = []
    neighbours: dict[int, set[int]] = {}
    for i, j in pairs:
        neighbours.setdefault(i, set()).add(j)
    for i in sorted(neighbours):
        for j, k in combinations(sorted(neighbours[i]), 2):
            if (j, k) in pairs:
                around = pairs[i, j].first_from_second @ pairs[j, k].first_from_second
                error = around @ transforms.invert(pairs[i, k].first_from_second)
                out.append(([(i, j), (j, k), (i, k)], motion(error, points[i])))
    return out


def parts(count: int, pairs: Sequence[Pair]) -> np.ndarray:
    """(count,) the number of the part that each station hangs together with."""
    i, j = np.array([(p.first, p.second) for p in pairs if not p.why_not], int).reshape(-1, 2).T
    return connected_components(coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count)), directed=False)[1]
