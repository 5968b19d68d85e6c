"""Which pairs agree with each other: loops of three, and what hangs together by pairs that no loop contradicts."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tiegraph.geometry import transforms
from tiegraph.geometry.align import rms_length
from tiegraph.stations.pairs import Pair
from tiegraph.stations.tuning import LoopTuning


def motion(error: np.ndarray, xyz: np.ndarray) -> float:
    """RMS by which an error (4, 4) moves points (N, 3)."""
    return rms_length(transforms.apply(error, xyz) - xyz)


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


def taken_apart(
    pairs: Sequence[Pair],
    left: dict[tuple[int, int], float],
    points: Sequence[np.ndarray],
    close_m: float,
    tuning: LoopTuning,
) -> list[Pair]:
    """The pairs, without those that join groups in more than one way.

    ``left``: by how much (metres) each believed pair contradicts the adjusted poses. Where one does by more than
    ``close_m``, a shape that repeats has been laid on itself, and loops of three may bear that out (a plain body on a
    round foot: two groups of stations joined in four ways, each with less than the noise between the surfaces). Then
    only groups within which every pair closes ``sure_loops`` loops are sure. Pairs between them go if a ring of groups
    that they close holds one that is contradicted; those that close none stay.
    """
    worst = max(left.values(), default=0.0)
    if worst <= close_m:
        return list(pairs)
    by_ends = {(p.first, p.second): p for p in pairs if not p.why_not}
    closed = dict.fromkeys(by_ends, 0)
    for around, off in _loops(by_ends, points):
        for e in around:
            closed[e] += off <= close_m
    group = parts(len(points), [p for e, p in by_ends.items() if closed[e] >= tuning.sure_loops])
    why = f"pairs between these groups of clouds contradict each other by up to {worst:.3g} m: the shape repeats"
    between = {e: p for e, p in by_ends.items() if group[e[0]] != group[e[1]]}
    ring = _rings(list(between), group)
    wrong = {ring[e] for e in between if e in ring and left[e] > close_m}
    torn = {e for e in between if ring.get(e) in wrong}
    torn |= {e for e in by_ends if e not in between and left[e] > close_m}
    return [p.refused(why) if (p.first, p.second) in torn else p for p in pairs]


def _rings(between: Sequence[tuple[int, int]], group: np.ndarray) -> dict[tuple[int, int], int]:
    """Of pairs between groups those that close rings of groups, with the number of what such rings hold together."""

    def hanging(ends: Sequence[tuple[int, int]]) -> np.ndarray:
        i, j = np.array([(group[a], group[b]) for a, b in ends], int).reshape(-1, 2).T
        count = int(group.max()) + 1
        return connected_components(coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count)), directed=False)[1]

    def closes(ends: tuple[int, int]) -> bool:
        rest = hanging([e for e in between if e != ends])
        return bool(rest[group[ends[0]]] == rest[group[ends[1]]])

    closing = [e for e in between if closes(e)]
    label = hanging(closing)
    return {e: int(label[group[e[0]]]) for e in closing}


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
