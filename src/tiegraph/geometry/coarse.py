"""A cloud laid on another without a start: descriptors of the surface, matches, and what of them is consistent.

A cloud is thinned, its normals are told, and the neighbourhood of each point is described by the angles between normals
(fast point feature histograms, FPFH: Rusu, Blodow, Beetz 2009). Most matches of such descriptors are wrong. Those that
are true are found by what a rigid motion keeps, the distances between points and the angles between normals, without
any random choice (second order compatibility, SC2-PCR: Chen, Sun, Yang, Tao 2022); so the same clouds give the same
result.

Arrays only: which motion is believed is for the engine that asks.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.settings import Section


class CoarseTuning(Section):
    """A cloud laid on another without a start. Lengths are in sides of the voxels that thin the clouds."""

    points: int = Field(2500, ge=100)
    """Of a thinned cloud, about: the consistency of matches costs the square of their number."""
    normal_neighbours: int = Field(16, ge=3)
    """Points that tell a normal."""
    radius: float = Field(5.0, gt=1)
    """Of the neighbourhood that is described: 5 voxels, as usual for FPFH."""
    neighbours: int = Field(64, ge=8)
    """Of a neighbourhood, at most: a surface has 80 voxels in that radius."""
    nearest: int = Field(2, ge=1)
    """Most alike points of the other cloud that a point is matched with."""
    matches: int = Field(1500, ge=10)
    """That are asked for consistency, the most alike first: 2 million pairs of matches."""
    play: float = Field(1.5, gt=0)
    """By which the distances of two points in both clouds may differ: half a voxel of error at each of four ends."""
    least_apart: float = Field(4.0, gt=0)
    """Two matches nearer than this agree in any case, and say nothing of each other."""
    normal_play_deg: float = Field(25.0, gt=0, lt=90)
    """By which the angles between two normals may differ: a normal of 16 noisy points is known to 10 degrees."""
    seeds: int = Field(100, ge=1)
    """Matches whose companions are tried for a motion: those that most others bear out."""
    companions: int = Field(30, ge=3)
    """Of a seed, by the number of matches that bear out both."""
    least_matches: int = Field(6, ge=3)
    """Consistent matches, for a motion to be told at all."""
    hypotheses: int = Field(6, ge=1)
    """Motions told, the one that most matches agree with first."""
    apart: float = Field(4.0, gt=0)
    """Two motions that move no point of the cloud further apart than this are one."""


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


_UPWARDS = np.array([0.36, 0.48, 0.8])  # the side of surfaces where nothing tells it: walls have one too


@dataclass(frozen=True)
class Motion:
    """A motion told by matches: ``target_from_source`` (4, 4) and how many matches agree with it."""

    target_from_source: np.ndarray
    matches: int


def motions(source: Shape, target: Shape, side: float, tuning: CoarseTuning) -> list[Motion]:
    """Rigid motions of a shape onto another, borne out by most matches first; [] where no matches agree.

    ``side``: of the voxels that both were thinned to.
    """
    pairs = _matched(source, target, tuning)
    if len(pairs) < tuning.least_matches:
        return []
    a, b = source.xyz[pairs[:, 0]], target.xyz[pairs[:, 1]]
    agree = _compatible(source, target, pairs, side, tuning)
    second = agree * (agree @ agree)
    found: list[Motion] = []
    order = np.argsort(-second.sum(axis=1), kind="stable")
    for seed in order[: tuning.seeds]:
        near = np.argsort(-second[seed], kind="stable")[: tuning.companions]
        near = near[second[seed, near] > 0]
        if len(near) < 3:
            continue
        fit = umeyama(a[near], b[near], second[seed, near], with_scale=False).matrix
        for _ in range(3):
            fits = np.linalg.norm(transforms.apply(fit, a) - b, axis=1) < tuning.play * side
            if fits.sum() < tuning.least_matches:
                break
            fit = umeyama(a[fits], b[fits], with_scale=False).matrix
        if fits.sum() >= tuning.least_matches:
            found.append(Motion(fit, int(fits.sum())))
    found.sort(key=lambda m: -m.matches)
    return _different(found, source.xyz, tuning.apart * side, tuning.hypotheses)


def _different(found: list[Motion], xyz: np.ndarray, apart: float, most: int) -> list[Motion]:
    """The first of those that move the corners of a cloud to the same places."""
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    corners = np.array(np.meshgrid(*zip(low, high))).reshape(3, -1).T
    kept: list[tuple[Motion, np.ndarray]] = []
    for motion in found:
        there = transforms.apply(motion.target_from_source, corners)
        if all(np.linalg.norm(there - other, axis=1).max() > apart for _, other in kept):
            kept.append((motion, there))
        if len(kept) == most:
            break
    return [motion for motion, _ in kept]


def _matched(source: Shape, target: Shape, tuning: CoarseTuning) -> np.ndarray:
    """(M, 2) rows of source and target that look alike, each among the most alike of the other's, the best first."""
    known = [source.described]
    if not (source.oriented and target.oriented):
        known.append(source.flipped())
    rows = []
    for described in known:
        tree, back = cKDTree(target.described), cKDTree(described)
        off, at = tree.query(described, k=tuning.nearest)
        off, at = off.reshape(len(described), -1), at.reshape(len(described), -1)
        here = back.query(target.described, k=2 * tuning.nearest)[1]
        for k in range(at.shape[1]):
            own = np.arange(len(described))
            mutual = (here[at[:, k]] == own[:, None]).any(axis=1)
            rows.append(np.column_stack([own, at[:, k], off[:, k]])[mutual])
    every = np.concatenate(rows)
    every = every[np.argsort(every[:, 2], kind="stable")][: tuning.matches]
    return np.unique(every[:, :2].astype(int), axis=0)


def _compatible(source: Shape, target: Shape, pairs: np.ndarray, side: float, tuning: CoarseTuning) -> np.ndarray:
    """(M, M) 1 where a rigid motion can hold both matches, else 0."""
    i, j = pairs.T
    lengths = [cdist(shape.xyz[k], shape.xyz[k]) for shape, k in ((source, i), (target, j))]
    agree = np.abs(lengths[0] - lengths[1]) < tuning.play * side
    agree &= np.minimum(*lengths) > tuning.least_apart * side
    turn = [np.clip(shape.normal[k] @ shape.normal[k].T, -1, 1) for shape, k in ((source, i), (target, j))]
    if not (source.oriented and target.oriented):
        turn = [np.abs(t) for t in turn]
    agree &= np.abs(np.arccos(turn[0]) - np.arccos(turn[1])) < np.radians(tuning.normal_play_deg)
    return agree.astype(np.float32)


@dataclass(frozen=True)
class Start:
    """``target_from_source`` (4, 4), the matches that agree with it, and the share of the source that lies within a
    voxel of the target, there and in the next best place."""

    target_from_source: np.ndarray
    matches: int
    share: float
    rival: float


def start_of(source: np.ndarray, target: np.ndarray, tuning: CoarseTuning) -> Start:
    """Where a cloud (N, 3) lies on another (M, 3), by their shapes. Raises ValueError if nothing tells it."""
    middles = [np.median(xyz, axis=0) for xyz in (source, target)]
    a, b = source - middles[0], target - middles[1]
    if not min(np.ptp(xyz, axis=0).max() for xyz in (a, b)) > 0:
        raise ValueError("the points of a cloud stand in one place: no surface")
    side = max(
        min(side_for(xyz, tuning.points) for xyz in (a, b)),
        max(side_for(xyz, 4 * tuning.points) for xyz in (a, b)),  # points that the larger one may have
    )
    shapes = [shape_of(xyz, side, tuning, np.broadcast_to(_UPWARDS, xyz.shape), False) for xyz in (a, b)]
    tree = cKDTree(shapes[1].xyz)
    found = []
    for motion in motions(shapes[0], shapes[1], side, tuning):
        moved = transforms.apply(motion.target_from_source, shapes[0].xyz)
        found.append((float(np.mean(tree.query(moved)[0] < side)), motion))
    if not found:
        raise ValueError("no place where the shapes of both clouds agree: give them a near start, or more overlap")
    found.sort(key=lambda row: (-row[0], -row[1].matches))
    share, best = found[0]
    fit = best.target_from_source.copy()
    fit[:3, 3] += middles[1] - fit[:3, :3] @ middles[0]
    rival = found[1][0] if len(found) > 1 else 0.0
    return Start(target_from_source=fit, matches=best.matches, share=share, rival=rival)
