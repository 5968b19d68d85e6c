"""Which pairs agree with each other: loops of three, and what hangs together by pairs that no loop contradicts."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import rms_length
from tiegraph.scene import graph
from tiegraph.stations.pairs import Pair


def motion(error: np.ndarray, xyz: np.ndarray) -> float:
    """RMS by which an error (4, 4) moves points (N, 3)."""
    return rms_length(transforms.apply(error, xyz) - xyz)


def contradicted(pairs: Sequence[Pair], points: Sequence[np.ndarray], close_m: float) -> list[Pair]:
    """The pairs; those that are contradicted by more loops of three than bear them out, worst first, have a reason.

    ``points``: some (N, 3) of each station, which say how far an open loop moves it; ``close_m``: how far at most.
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
        if ends not in refused and not good[ends] and pair.overlap < 0.3:
            refused[ends] = f"no loop bears it out, and {pair.overlap:.0%} overlap is too little for a pair alone"
    return [p.refused(refused[p.first, p.second]) if (p.first, p.second) in refused else p for p in pairs]


def taken_apart(
    pairs: Sequence[Pair], left: dict[tuple[int, int], float], points: Sequence[np.ndarray], close_m: float
) -> list[Pair]:
    """The pairs, without those that join groups in more than one way.

    ``left``: by how much (metres) each believed pair contradicts the adjusted poses. Where one does by more than
    ``close_m``, a shape that repeats has been laid on itself, and loops of three may bear that out (a plain body on a
    round foot: two groups of stations joined in four ways, each with less than the noise between the surfaces). Then
    only groups within which every pair closes two loops are sure: one more than two wrong pairs and a right one make.
    Pairs between them go if a ring of groups that they close holds one that is contradicted; others stay.
    """
    worst = max(left.values(), default=0.0)
    if worst <= close_m:
        return list(pairs)
    by_ends = {(p.first, p.second): p for p in pairs if not p.why_not}
    closed = dict.fromkeys(by_ends, 0)
    for around, off in _loops(by_ends, points):
        for e in around:
            closed[e] += off <= close_m
    group = parts(len(points), [p for e, p in by_ends.items() if closed[e] >= 2])
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
        return graph.parts(i, j, int(group.max()) + 1)

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
    return graph.parts(i, j, count)


_DIFFERENCE = 1e-6  # rad and metres


@dataclass(frozen=True)
class Part:
    """Stations that hang together. Of all K stations poses (K, 4, 4) in the frame of the first member, NaN = another
    part, and covariance (K, 6, 6) of turn and shift about each station's middle against the first; of the believed
    pairs by how much their loops do not close before and after: (P, 2) metres in the middle of the overlap."""

    members: list[int]
    pairs: list[Pair]
    poses: np.ndarray
    covariance: np.ndarray
    loop_m: np.ndarray


def adjusted(members: list[int], pairs: list[Pair], count: int) -> Part:
    """Adjust the stations that hang together; the first of ``members`` is held at its own frame."""
    start = _along_tree(members, pairs, count)
    if len(members) == 1:
        unknown = np.full((count, 6, 6), np.nan)
        return Part(members=members, pairs=[], poses=start, covariance=unknown, loop_m=np.zeros((0, 2)))
    free = {station: 6 * k for k, station in enumerate(members[1:])}
    roots = [np.linalg.cholesky(p.information).T for p in pairs]
    poses = start
    for _ in range(50):
        jacobian, residual = _equations(pairs, roots, poses, free)
        # Cauchy's weight from three sigmas on, of all six of a pair together.
        far = np.sum(residual.reshape(-1, 6) ** 2, axis=1) / (6 * 3.0**2)
        weight = np.repeat(1 / (1 + far), 6)
        step = -np.linalg.lstsq(jacobian * np.sqrt(weight)[:, None], residual * np.sqrt(weight), rcond=None)[0]
        poses = _moved(poses, free, step)
        if np.abs(step).max() < 1e-9:  # rad and metres
            break
    jacobian, residual = _equations(pairs, roots, poses, free)
    loops = np.array([[np.linalg.norm(_off(p, q)[3:]) for q in (start, poses)] for p in pairs])
    more = len(residual) - jacobian.shape[1]  # what the loops say of the pairs' own sigmas counts where that is more
    factor = max(1.0, float(residual @ residual) / more) if more > 0 else 1.0
    every, covariance = factor * np.linalg.pinv(jacobian.T @ jacobian), np.full((count, 6, 6), np.nan)
    covariance[members[0]] = 0
    for station, k in free.items():
        covariance[station] = every[k : k + 6, k : k + 6]
    return Part(members=members, pairs=pairs, poses=poses, covariance=covariance, loop_m=loops)


def _equations(
    pairs: Sequence[Pair], roots: Sequence[np.ndarray], poses: np.ndarray, free: dict[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian (6 P, 6 F), by differences, and residuals (6 P,) of the pairs, in sigmas."""
    jacobian = np.zeros((6 * len(pairs), 6 * len(free)))
    residual = np.empty(6 * len(pairs))
    for n, (pair, root) in enumerate(zip(pairs, roots)):
        rows = slice(6 * n, 6 * n + 6)
        here = _off(pair, poses)
        residual[rows] = root @ here
        for station in (pair.first, pair.second):
            if station in free:
                for k in range(6):
                    there = _off(pair, _moved(poses, {station: 0}, _DIFFERENCE * np.eye(6)[k]))
                    jacobian[rows, free[station] + k] = root @ (there - here) / _DIFFERENCE
    return jacobian, residual


def _moved(poses: np.ndarray, free: dict[int, int], step: np.ndarray) -> np.ndarray:
    """Poses turned about their stations' middles and shifted by steps (6 F,)."""
    out = poses.copy()
    for station, k in free.items():
        out[station, :3, :3] = Rotation.from_rotvec(step[k : k + 3]).as_matrix() @ poses[station, :3, :3]
        out[station, :3, 3] += step[k + 3 : k + 6]
    return out


def _along_tree(members: Sequence[int], pairs: Sequence[Pair], count: int) -> np.ndarray:
    """Poses (count, 4, 4) by the tree of the pairs whose shift is known best (Prim)."""
    poses = np.full((count, 4, 4), np.nan)
    poses[members[0]] = np.eye(4)
    rest = sorted(pairs, key=lambda p: p.sigma_m)
    while True:
        known = np.isfinite(poses[:, 0, 0])
        pair = next((p for p in rest if known[p.first] != known[p.second]), None)
        if pair is None:
            return poses
        if known[pair.first]:
            poses[pair.second] = poses[pair.first] @ pair.first_from_second
        else:
            poses[pair.first] = poses[pair.second] @ transforms.invert(pair.first_from_second)


def _off(pair: Pair, poses: np.ndarray) -> np.ndarray:
    """(6,) turn and shift in the middle of the overlap by which poses differ from what the pair says."""
    said = transforms.invert(poses[pair.first]) @ poses[pair.second]
    error = said @ transforms.invert(pair.first_from_second)
    turn = Rotation.from_matrix(error[:3, :3]).as_rotvec()
    return np.r_[turn, transforms.apply(error, pair.middle[None])[0] - pair.middle]
