"""Rotations of all units from those of pairs: clusters joined by votes, then robust least squares; loops of three.

No pair is believed alone: two clusters of units are joined by the rotation that most weight of all ties between them
agrees on, best backed first. Repeated walls turn a pair by the angle that fits the wrong window, each pair by another
one (measured on canal: 8 to 180 degrees), while true ties agree within a degree.
"""

import heapq
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, identity
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from tiegraph.filter.tuning import LoopTuning
from tiegraph.geometry import transforms


@dataclass(frozen=True)
class RotationAverage:
    """Rotations of U units and what E edges make of them."""

    unit_from_world: np.ndarray  # (U, 3, 3)
    residual_deg: np.ndarray  # (E,) edge against the rotations; NaN without a rotation
    reliable: np.ndarray  # (E,) bool: the ends hang together by closed loops of three that need not this edge

    def predicted(self, m: int, n: int) -> np.ndarray:
        """n_from_m (3, 3)."""
        return self.unit_from_world[n] @ self.unit_from_world[m].T


def average(
    units: int, ends: np.ndarray, rotations: np.ndarray, weight: np.ndarray, bound_deg: float, tuning: LoopTuning
) -> RotationAverage:
    """Average n_from_m rotations (E, 3, 3) of edges ``ends`` (E, 2); one of weight 0 has none and is only judged."""
    there = np.flatnonzero(weight > 0)
    rotation = _Clusters(units, ends[there], rotations[there], weight[there], bound_deg, tuning.voters).join()
    rotation = _polished(rotation, ends[there], rotations[there], weight[there], tuning)
    residual = np.full(len(ends), np.nan)
    residual[there] = _angles(rotation, ends[there], rotations[there])
    agreeing = np.zeros(len(ends), bool)
    agreeing[there] = residual[there] < bound_deg
    return RotationAverage(rotation, residual, _reliable(units, ends, agreeing))


def _angles(rotation: np.ndarray, ends: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    predicted = rotation[ends[:, 1]] @ np.swapaxes(rotation[ends[:, 0]], 1, 2)
    return transforms.angle_deg(predicted, rotations)


class _Clusters:
    """Units joined into clusters, the best backed first."""

    def __init__(
        self, units: int, ends: np.ndarray, rotations: np.ndarray, weight: np.ndarray, bound_deg: float, voters: int
    ) -> None:
        self.ends, self.rotations, self.weight = ends, rotations, weight
        self.bound_deg, self.voters = bound_deg, voters
        self.rotation = np.tile(np.eye(3), (units, 1, 1))  # unit_from_cluster
        self.label = np.arange(units)
        self.members: list[list[int]] = [[k] for k in range(units)]
        self.ties: list[dict[int, list[int]]] = [{} for _ in range(units)]
        for e, (m, n) in enumerate(ends.tolist()):
            self.ties[m].setdefault(n, []).append(e)
            self.ties[n].setdefault(m, []).append(e)

    def join(self) -> np.ndarray:
        """Rotations (U, 3, 3) once nothing is left to join."""
        heap = [(-self._vote(a, b)[0], a, b) for a in range(len(self.ties)) for b in self.ties[a] if a < b]
        heapq.heapify(heap)
        while heap:
            key, a, b = heapq.heappop(heap)
            if b not in self.ties[a]:
                continue  # one of them is part of another cluster now
            score, b_from_a = self._vote(a, b)
            if score < -key - 1e-9:
                heapq.heappush(heap, (-score, a, b))
                continue
            if len(self.members[a]) < len(self.members[b]):
                a, b, b_from_a = b, a, b_from_a.T
            for other in self._absorb(a, b, b_from_a):
                low, high = min(a, other), max(a, other)
                heapq.heappush(heap, (-self._vote(low, high)[0], low, high))
        return self.rotation

    def _absorb(self, a: int, b: int, b_from_a: np.ndarray) -> list[int]:
        """Make cluster b part of a; the clusters whose ties with a changed."""
        self.rotation[self.members[b]] = self.rotation[self.members[b]] @ b_from_a
        self.label[self.members[b]] = a
        self.members[a] += self.members[b]
        self.members[b] = []
        del self.ties[a][b], self.ties[b][a]
        changed = sorted(self.ties[b])
        for other in changed:
            joined = self.ties[a].get(other, []) + self.ties[b][other]
            self.ties[a][other] = self.ties[other][a] = joined
            del self.ties[other][b]
        self.ties[b] = {}
        return changed

    def _vote(self, a: int, b: int) -> tuple[float, np.ndarray]:
        """(weight that agrees, b_from_a) of the rotation between two clusters that most ties agree on."""
        edges = np.array(self.ties[a][b])
        if len(edges) > self.voters:
            edges = edges[np.argsort(-self.weight[edges], kind="stable")[: self.voters]]
        m, n = self.ends[edges].T
        turned = np.swapaxes(self.rotation[n], 1, 2) @ self.rotations[edges] @ self.rotation[m]
        turned = np.where((self.label[m] == a)[:, None, None], turned, np.swapaxes(turned, 1, 2))
        if len(edges) == 1:
            return float(self.weight[edges[0]]), turned[0]
        close = transforms.angle_deg(turned[:, None], turned[None]) < self.bound_deg
        scores = close @ self.weight[edges]
        best = int(np.argmax(scores))
        mean = Rotation.from_matrix(turned[close[best]]).mean(self.weight[edges][close[best]])
        return float(scores[best]), mean.as_matrix()


def _polished(
    rotation: np.ndarray, ends: np.ndarray, rotations: np.ndarray, weight: np.ndarray, tuning: LoopTuning
) -> np.ndarray:
    """Geman-McClure least squares on the rotation group (Chatterjee, Govindu 2013): one sparse solve a round."""
    if len(ends) == 0:
        return rotation
    units, rows = len(rotation), np.arange(len(ends))
    m, n = ends.T
    incidence = csr_matrix(
        (np.r_[np.ones(len(ends)), -np.ones(len(ends))], (np.r_[rows, rows], np.r_[n, m])), shape=(len(ends), units)
    )
    for _ in range(tuning.rounds):
        # rotation_n exp(x_n) = R_mn rotation_m exp(x_m): x_n - x_m = log(rotation_n^T R_mn rotation_m)
        log = Rotation.from_matrix(np.swapaxes(rotation[n], 1, 2) @ rotations @ rotation[m]).as_rotvec()
        size = np.degrees(np.linalg.norm(log, axis=1))
        robust = weight / (1 + (size / tuning.kernel_deg) ** 2) ** 2
        weighted = incidence.multiply(robust[:, None]).tocsr()
        normal = (incidence.T @ weighted + 1e-9 * weight.sum() * identity(units)).tocsc()
        step = splu(normal).solve(weighted.T @ log)
        rotation = rotation @ Rotation.from_rotvec(step).as_matrix()
        if np.abs(step).max() < 1e-6:
            break
    return rotation


def _reliable(units: int, ends: np.ndarray, agreeing: np.ndarray) -> np.ndarray:
    """(E,) bool: both ends in one part of the graph of agreeing edges that lie in triangles of agreeing edges."""
    m, n = ends[agreeing].T
    graph = coo_matrix((np.ones(2 * len(m)), (np.r_[m, n], np.r_[n, m])), shape=(units, units)).tocsr()
    looped = (graph @ graph).multiply(graph > 0)
    parts = connected_components(looped, directed=False)[1]
    return parts[ends[:, 0]] == parts[ends[:, 1]]
