"""What describes a place of a surface: voxels, normals, and fast point feature histograms (FPFH)."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.geometry.coarse import CoarseTuning

_BINS = 11  # of each of the three angles, as in Rusu's definition
_CHUNK = 20_000  # points whose neighbours are looked at together: bounds the memory


@dataclass(frozen=True)
class Shape:
    """A thinned cloud: ``xyz`` (N, 3), unit ``normal`` (N, 3), FPFH ``described`` (N, 33) of unit length; ``oriented``:
    normals point to where the surface was seen from (else their signs say nothing)."""

    xyz: np.ndarray
    normal: np.ndarray
    described: np.ndarray
    oriented: bool

    def flipped(self) -> np.ndarray:
        """(N, 33) the descriptors as they were if all normals pointed the other way."""
        parts = np.split(self.described, 3, axis=1)
        return np.concatenate([parts[0], parts[1][:, ::-1], parts[2][:, ::-1]], axis=1)


def thinned(xyz: np.ndarray, side: float, normal: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray | None]:
    """The mean point (M, 3) of every voxel that has points (N, 3), and the sum (M, 3) of their normals (N, 3)."""
    cell = np.floor((xyz - xyz.min(axis=0)) / side).astype(np.int64)
    size = cell.max(axis=0) + 1
    _, group = np.unique((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2], return_inverse=True)
    count = np.bincount(group)

    def sums(rows: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(group, rows[:, k], len(count)) for k in range(3)], axis=1)

    return sums(xyz) / count[:, None], None if normal is None else sums(np.nan_to_num(normal))


def side_for(xyz: np.ndarray, points: int) -> float:
    """Side of the voxels of which about so many hold points (N, 3); all points, if there are fewer."""
    low, high = 0.0, float(np.ptp(xyz, axis=0).max())
    if not high:
        return 0.0
    side = high / 2
    for _ in range(12):  # to half a per mille of the side
        low, high = (side, high) if len(thinned(xyz, side)[0]) > points else (low, side)
        side = (low + high) / 2
    return side


def normals(xyz: np.ndarray, neighbours: int) -> np.ndarray:
    """(N, 3) unit normals of the planes through the nearest points; their signs say nothing."""
    tree, out = cKDTree(xyz), np.empty((len(xyz), 3))
    for start in range(0, len(xyz), _CHUNK):
        part = slice(start, start + _CHUNK)
        near = xyz[tree.query(xyz[part], k=min(neighbours, len(xyz)))[1]]
        off = near - near.mean(axis=1, keepdims=True)
        out[part] = np.linalg.eigh(np.swapaxes(off, 1, 2) @ off)[1][:, :, 0]
    return out


def shape_of(xyz: np.ndarray, side: float, tuning: CoarseTuning, towards: np.ndarray, oriented: bool) -> Shape:
    """Describe a cloud (N, 3) thinned to voxels of a side; ``towards`` (N, 3): the side of the surface that is meant,
    at least the same for neighbours; ``oriented``: that from which it was seen."""
    places, side_meant = thinned(xyz, side, towards)
    normal = normals(places, tuning.normal_neighbours)
    normal *= np.where(_dot(normal, np.asarray(side_meant)) < 0, -1.0, 1.0)[:, None]
    described = _fpfh(places, normal, side * tuning.radius, tuning.neighbours)
    return Shape(xyz=places, normal=normal, described=described, oriented=oriented)


def _fpfh(xyz: np.ndarray, normal: np.ndarray, radius: float, neighbours: int) -> np.ndarray:
    """(N, 33) of unit length: histograms of a point and, by their nearness, of its neighbours (Rusu 2009, eq. 2). The
    root of the shares is taken, so that rare angles count (Hellinger's distance)."""
    count = min(neighbours + 1, len(xyz))
    away, near = cKDTree(xyz).query(xyz, k=count, distance_upper_bound=radius)
    away, near = away[:, 1:], near[:, 1:]
    known = np.isfinite(away)
    near = np.where(known, near, 0)
    single = np.zeros((len(xyz), 3 * _BINS))
    for start in range(0, len(xyz), _CHUNK):
        part = slice(start, start + _CHUNK)
        single[part] = _histograms(xyz[part], normal[part], xyz[near[part]], normal[near[part]], known[part])
    weight = np.where(known, 1 / np.maximum(away, 1e-3 * radius), 0.0)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
    both = single + np.stack([np.einsum("nk,nk->n", weight, column[near]) for column in single.T], axis=1)
    return np.sqrt(both / np.maximum(both.sum(axis=1, keepdims=True), 1e-12))


def _histograms(
    xyz: np.ndarray, normal: np.ndarray, others: np.ndarray, other_normal: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """(N, 33) shares of the three angles between points (N, 3) and their neighbours (N, K, 3)."""
    line = others - xyz[:, None]
    line /= np.maximum(np.linalg.norm(line, axis=2, keepdims=True), 1e-12)
    own = np.broadcast_to(normal[:, None], line.shape)
    swapped = np.abs(_dot(own, line)) < np.abs(_dot(other_normal, line))  # the source's normal is nearer to the line
    u = np.where(swapped[..., None], other_normal, own)
    target = np.where(swapped[..., None], own, other_normal)
    line = np.where(swapped[..., None], -line, line)
    v = np.cross(line, u)
    long = np.linalg.norm(v, axis=2)
    known = known & (long > 1e-9)
    v /= np.maximum(long, 1e-12)[..., None]
    w = np.cross(u, v)
    angles = (
        (_dot(v, target) + 1) / 2,
        (_dot(u, line) + 1) / 2,
        np.arctan2(_dot(w, target), _dot(u, target)) / (2 * np.pi) + 0.5,
    )
    rows = np.broadcast_to(np.arange(len(xyz))[:, None], known.shape)[known]
    out = []
    for angle in angles:
        # Shared between two bins by nearness: angles of a gentle relief would else all fall into one.
        place = np.clip(angle[known] * (_BINS - 1), 0, _BINS - 1 - 1e-9)
        at = place.astype(int)
        counts = np.zeros(len(xyz) * _BINS)
        for step, part in ((0, at + 1 - place), (1, place - at)):
            counts += np.bincount(rows * _BINS + at + step, part, minlength=len(counts))
        out.append(counts.reshape(-1, _BINS) / np.maximum(known.sum(axis=1), 1)[:, None])
    return np.concatenate(out, axis=1)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...k,...k->...", a, b)
