"""Poses of stations from pairs: along the best tree first, then all pairs together by their information."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.stations.pairs import Pair
from tiegraph.stations.tuning import LoopTuning

_ITERATIONS, _STILL = 50, 1e-9  # rad and metres
_DIFFERENCE = 1e-6


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


def adjusted(members: list[int], pairs: list[Pair], count: int, tuning: LoopTuning) -> Part:
    """Adjust the stations that hang together; the first of ``members`` is held at its own frame."""
    start = _along_tree(members, pairs, count)
    if len(members) == 1:
        unknown = np.full((count, 6, 6), np.nan)
        return Part(members=members, pairs=[], poses=start, covariance=unknown, loop_m=np.zeros((0, 2)))
    free = {station: 6 * k for k, station in enumerate(members[1:])}
    roots = [np.linalg.cholesky(p.information).T for p in pairs]
    poses = start
    for _ in range(_ITERATIONS):
        jacobian, residual = _equations(pairs, roots, poses, free)
        # Cauchy's weight, of all six of a pair together.
        far = np.sum(residual.reshape(-1, 6) ** 2, axis=1) / (6 * tuning.robust**2)
        weight = np.repeat(1 / (1 + far), 6)
        step = -np.linalg.lstsq(jacobian * np.sqrt(weight)[:, None], residual * np.sqrt(weight), rcond=None)[0]
        poses = _moved(poses, free, step)
        if np.abs(step).max() < _STILL:
            break
    jacobian, residual = _equations(pairs, roots, poses, free)
    loops = np.array([[np.linalg.norm(_off(p, q)[3:]) for q in (start, poses)] for p in pairs])
    covariance = _covariances(jacobian, residual, free, members[0], count)
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


def _covariances(jacobian: np.ndarray, residual: np.ndarray, free: dict[int, int], held: int, count: int) -> np.ndarray:
    """(count, 6, 6), scaled by what the loops say of the pairs' own sigmas where that is more."""
    out = np.full((count, 6, 6), np.nan)
    out[held] = 0
    more = len(residual) - jacobian.shape[1]
    factor = max(1.0, float(residual @ residual) / more) if more > 0 else 1.0
    every = factor * np.linalg.pinv(jacobian.T @ jacobian)
    for station, k in free.items():
        out[station] = every[k : k + 6, k : k + 6]
    return out
