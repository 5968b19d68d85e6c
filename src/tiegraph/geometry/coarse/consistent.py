"""Motions that many matches of two shapes agree with, by second order compatibility (SC2-PCR: Chen et al. 2022)."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.geometry.coarse import CoarseTuning
from tiegraph.geometry.coarse.shape import Shape, shape_of, side_for

_UPWARDS = np.array([0.36, 0.48, 0.8])  # the side of surfaces where nothing tells it: walls have one too
_WIDER = 4  # times the points of the tuning, that the larger of two clouds may have


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
    lengths = [_distances(shape.xyz[k]) for shape, k in ((source, i), (target, j))]
    agree = np.abs(lengths[0] - lengths[1]) < tuning.play * side
    agree &= np.minimum(*lengths) > tuning.least_apart * side
    turn = [np.clip(shape.normal[k] @ shape.normal[k].T, -1, 1) for shape, k in ((source, i), (target, j))]
    if not (source.oriented and target.oriented):
        turn = [np.abs(t) for t in turn]
    agree &= np.abs(np.arccos(turn[0]) - np.arccos(turn[1])) < np.radians(tuning.normal_play_deg)
    return agree.astype(np.float32)


def _distances(xyz: np.ndarray) -> np.ndarray:
    square = np.sum(xyz**2, axis=1)
    return np.sqrt(np.maximum(square[:, None] + square - 2 * xyz @ xyz.T, 0))


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
        max(side_for(xyz, _WIDER * tuning.points) for xyz in (a, b)),
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
