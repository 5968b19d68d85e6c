"""Pairs whose rotation contradicts that of all others, by their matches as bearing vectors, which are read from
COLMAP's database pair by pair, in whichever process needs them.

Each pair gives the rotation between its images, and if the rig is known, between its frames. All together determine the
rotation of every frame. A deviating pair is refused if closed loops determine the rotation of its frames without it,
and if few of its matches agree with that: a plane allows two rotations, and a pair may have the wrong one. If loops
close badly, by wrong focal lengths or a rig that is not rigid, the tolerance widens, or no pair is refused.

No pair is trusted alone: two clusters of units are joined by the rotation with the largest total weight of agreeing
ties, best supported first, before robust least squares. Repeated walls rotate a pair by the angle that fits the wrong
window, each pair by another one (measured on canal: 8 to 180 degrees), while true ties agree within a degree.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.sparse import coo_matrix, csr_matrix, identity
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.filter.tuning import LoopTuning
from tiegraph.geometry import transforms
from tiegraph.geometry.align import MAD
from tiegraph.geometry.transforms import cross
from tiegraph.scene.atomic import cached_by_file
from tiegraph.scene.colmapdatabase import Rows
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import camera_from_dict, camera_to_dict, pixel_rays
from tiegraph.scene.scene import Scene

_CACHED_IMAGES = 512  # of about 100 kB each, in every worker

Camera = tuple[tuple[str, object], ...]  # items of ``camera_to_dict``, so that rays can be cached by it


@dataclass(frozen=True)
class Matches:
    """The verified matches of a database, in a form that can be sent to other processes: the camera of each sensor, and
    the sensor (N,) of each image; of a pair at most ``most`` matches are read, spread evenly."""

    database: str
    cameras: tuple[Camera, ...]
    sensor: np.ndarray
    most: int

    @staticmethod
    def of(database: Path, scene: Scene, most: int) -> Matches:
        """Those of a scene. Raises InputError for a sensor without a camera."""
        cameras = []
        for k, sensor in enumerate(scene.all_sensors):
            if sensor.camera is None:
                raise InputError(f"sensor {k} has no camera: no image of it was found, remove it from the rig")
            said = camera_to_dict(sensor.camera) or {}
            cameras.append(tuple(sorted((n, tuple(v) if isinstance(v, list) else v) for n, v in said.items())))
        return Matches(str(database), cameras=tuple(cameras), sensor=np.asarray(scene.sensor_key), most=most)

    def rays(self, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Unit rays (K, 3), (K, 3) of the matches of images i and j in the frames of their sensors."""
        matches = _connection(self.database).verified_of(i + 1, j + 1)
        if len(matches) > self.most:
            matches = matches[np.linspace(0, len(matches) - 1, self.most).astype(int)]
        rays = (_rays(self.database, k, self.cameras[self.sensor[k]]) for k in (i, j))
        first, second = (own[matches[:, side]] for side, own in enumerate(rays))
        return first, second

    def focal_px(self) -> float:
        """Mean focal length."""
        return float(np.mean([_camera(c).mean_focal_length() for c in self.cameras]))


def _camera(camera: Camera) -> pycolmap.Camera:
    made = camera_from_dict(dict(camera))
    assert made is not None
    return made


@cached_by_file(maxsize=2)
def _connection(database: str) -> Rows:
    return Rows(Path(database), any_thread=True)


@cached_by_file(maxsize=_CACHED_IMAGES)
def _rays(database: str, image: int, camera: Camera) -> np.ndarray:
    """(K, 3) unit rays of an image's key points in the sensor frame."""
    points = _connection(database).keypoints_of(image + 1)
    return np.nan_to_num(pixel_rays(_camera(camera), points)) if len(points) else np.zeros((0, 3))


def forget() -> None:
    """Close the database and drop cached rays of this process."""
    _connection.cache_clear()
    _rays.cache_clear()


_SEED = 0

Map = Callable[..., list[Any]]  # (function, items, *args) -> results in the order of the items


def average(
    units: int, ends: np.ndarray, rotations: np.ndarray, weight: np.ndarray, bound_deg: float, tuning: LoopTuning
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Average n_from_m rotations (E, 3, 3) of edges ``ends`` (E, 2); one of weight 0 has none and is only judged.

    Returns unit_from_world (U, 3, 3); of each edge the angle against these rotations in degrees, NaN without one of
    its own, and whether its ends are connected by closed loops of three without it.
    """
    there = np.flatnonzero(weight > 0)
    edges, own = ends[there], rotations[there]
    rotation = _Clusters(units, edges, own, weight[there], bound_deg, tuning.voters).join()
    rotation = _polished(rotation, edges, own, weight[there], tuning)
    residual = np.full(len(ends), np.nan)
    predicted = rotation[edges[:, 1]] @ np.swapaxes(rotation[edges[:, 0]], 1, 2)
    residual[there] = transforms.angle_deg(predicted, own)
    return rotation, residual, _reliable(units, ends, residual < bound_deg)


class _Clusters:
    """Units joined into clusters, the best supported first."""

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


def by_loops(
    scene: Scene, pairs: Pairs, matches: Matches, tuning: LoopTuning, run_map: Map
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Judge pairs by loops of rotations: of each pair (P,) bool whether it is refused, or kept though it contradicts
    others and no loop decides; notes. ``run_map(function, items, *args)`` runs items anywhere."""
    bound = tuning.max_error_px / matches.focal_px()
    unit, turned = _units(scene)
    outside = np.flatnonzero(unit[pairs.i] != unit[pairs.j])
    i, j = pairs.i[outside].astype(int), pairs.j[outside].astype(int)
    found: list[tuple[np.ndarray, int]] = run_map(
        pair_rotation, list(zip(i.tolist(), j.tolist())), matches, bound, tuning
    )
    support = np.array([explained for _, explained in found], int)
    rotation = np.array([turn for turn, _ in found]).reshape(-1, 3, 3)
    rotation = np.swapaxes(turned[j], 1, 2) @ rotation @ turned[i]  # of the units
    a, b = scene.frame[i], scene.frame[j]
    apart = np.abs(scene.sequence_index[a].astype(int) - scene.sequence_index[b])
    near = (scene.sequence[a] == scene.sequence[b]) & (scene.sequence[a] >= 0) & (apart <= tuning.neighbour_steps)
    weight = np.minimum(support, tuning.votes_a_pair) * np.where(near, tuning.neighbour_weight, 1.0)
    used, ends = np.unique(np.stack([unit[i], unit[j]], axis=1), return_inverse=True)
    ends = ends.reshape(-1, 2)
    averaged, residual_deg, reliable = average(len(used), ends, rotation, weight, tuning.max_deg, tuning)
    told = np.isfinite(residual_deg) & reliable
    basis = told & near if np.any(told & near) else told
    spread = float(np.median(residual_deg[basis])) if basis.any() else 0.0
    tolerance = max(tuning.max_deg, LIMIT * MAD * spread)
    off = (weight > 0) & ~(residual_deg < tolerance)
    refused, undecided = (np.zeros(len(pairs), bool) for _ in range(2))
    undecided[outside] = off & ~reliable
    notes = []
    if undecided.any():
        notes.append(f"{int(undecided.sum())} pairs contradict others, but no loops decide: kept")
    if tolerance > tuning.noisy_deg:
        said = f"rotations of pairs contradict each other by {spread:.1f} deg (median): focal lengths, or the rig, are"
        return refused, undecided, (f"{said} probably wrong. No pair was refused", *notes)
    doubtful = np.flatnonzero(off & reliable)
    predicted = averaged[ends[doubtful, 1]] @ np.swapaxes(averaged[ends[doubtful, 0]], 1, 2)
    predicted = turned[j[doubtful]] @ predicted @ np.swapaxes(turned[i[doubtful]], 1, 2)
    asked = list(zip(i[doubtful].tolist(), j[doubtful].tolist(), predicted))
    agree = np.array(run_map(agreeing, asked, matches, bound, tuning), int)
    refused[outside[doubtful]] = agree < tuning.as_good * support[doubtful]
    return refused, undecided, tuple(notes)


def _units(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """(N,) units of one rotation (a frame, or an image of unknown mounting); (N, 3, 3) sensor_from_unit."""
    poses = [s.sensor_from_rig for s in scene.all_sensors]
    known = np.array([p is not None for p in poses])[scene.sensor_key] | (scene.sensor == 0)
    unit = np.where(known, scene.frame, scene.frames + np.arange(len(scene)))
    turned = np.stack([np.eye(3) if p is None else p[:3, :3] for p in poses])
    return unit, turned[scene.sensor_key]


def pair_rotation(
    pair: tuple[int, int], matches: Matches, bound_rad: float, tuning: LoopTuning
) -> tuple[np.ndarray, int]:
    """The rotation (3, 3) from the first to the second image of a pair by five-point RANSAC and least squares, and the
    matches it explains, 0 = it has none."""
    a, b = matches.rays(*pair)
    options = pycolmap.RANSACOptions(max_error=bound_rad, random_seed=_SEED)
    options.max_num_trials, options.min_num_trials = tuning.trials, 60
    found = pycolmap.estimate_relative_pose(a, b, options) if len(a) >= tuning.least_matches else None
    if not found:
        return np.eye(3), 0
    inliers = np.asarray(found["inlier_mask"], bool)
    better = pycolmap.refine_relative_pose(found["cam2_from_cam1"], a, b, inliers)
    return (better or found)["cam2_from_cam1"].rotation.matrix(), int(inliers.sum())


def agreeing(item: tuple[int, int, np.ndarray], matches: Matches, bound_rad: float, tuning: LoopTuning) -> int:
    """The most matches of a pair that a rotation (3, 3) explains; translations are sampled from two of them each."""
    a, b = matches.rays(*item[:2])
    turned = a @ item[2].T
    normal = cross(turned, b)
    length = np.linalg.norm(normal, axis=1)
    usable = np.flatnonzero(length > bound_rad)  # nearly parallel rays do not determine the translation
    if len(usable) < tuning.least_matches:
        return len(a) - len(usable)
    picks = np.random.default_rng(_SEED).choice(usable, (tuning.directions, 2))
    way = cross(*(normal[picks[:, k]] / length[picks[:, k], None] for k in (0, 1)))
    size = np.linalg.norm(way, axis=1)
    way = way[size > 1e-6] / size[size > 1e-6, None]
    # Sampson distance on the unit sphere, of all matches and all ways at once
    error = normal @ way.T
    squared = 2 - (turned @ way.T) ** 2 - (b @ way.T) ** 2 - 2 * error**2
    return int((error**2 < bound_rad**2 * np.maximum(squared, 1e-24)).sum(axis=0).max(initial=0))
