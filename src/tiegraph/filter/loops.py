"""Pairs whose rotation contradicts that of all others.

Each pair tells the rotation between its images, and where the rig is known, between its frames. All together tell the
rotation of every frame (``averaging``). A pair that is off is refused if closed loops tell the rotation of its frames
without it, and if few of its matches agree with that: a plane allows two rotations, and a pair may tell the wrong one.
Where loops close badly, by wrong focal lengths or a rig that is not rigid, the tolerance widens, or no pair is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap

from tiegraph.filter.averaging import average
from tiegraph.filter.bearings import Matches
from tiegraph.filter.settings import FilterSettings
from tiegraph.filter.tuning import LoopTuning
from tiegraph.geometry.rays import cross
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

_SEED = 0

Map = Callable[..., list[Any]]  # (function, items, *args) -> results in the order of the items


@dataclass(frozen=True)
class Loops:
    """Of each pair (P,) bool whether it is refused, or kept though it contradicts and no loop tells; notes."""

    refused: np.ndarray
    undecided: np.ndarray
    notes: tuple[str, ...] = ()


def by_loops(
    scene: Scene, pairs: Pairs, matches: Matches, settings: FilterSettings, tuning: LoopTuning, run_map: Map
) -> Loops:
    """Judge pairs by loops of rotations. ``run_map(function, items, *args)`` runs items anywhere."""
    bound = settings.max_error_px / matches.focal_px()
    unit, turned = _units(scene)
    outside = np.flatnonzero(unit[pairs.i] != unit[pairs.j])
    i, j = pairs.i[outside].astype(int), pairs.j[outside].astype(int)
    found: list[PairRotation] = run_map(pair_rotation, list(zip(i.tolist(), j.tolist())), matches, bound, tuning)
    support = np.array([f.support for f in found], int)
    rotation = np.array([f.rotation for f in found]).reshape(-1, 3, 3)
    rotation = np.swapaxes(turned[j], 1, 2) @ rotation @ turned[i]  # of the units
    near = _neighbours(scene, scene.frame[i], scene.frame[j], tuning.neighbour_steps)
    weight = np.minimum(support, tuning.votes_a_pair) * np.where(near, tuning.neighbour_weight, 1.0)
    used, ends = np.unique(np.stack([unit[i], unit[j]], axis=1), return_inverse=True)
    ends = ends.reshape(-1, 2)
    loops = average(len(used), ends, rotation, weight, settings.max_loop_deg, tuning)
    told = np.isfinite(loops.residual_deg) & loops.reliable
    basis = told & near if np.any(told & near) else told
    spread = float(np.median(loops.residual_deg[basis])) if basis.any() else 0.0
    tolerance = max(settings.max_loop_deg, tuning.sigmas * spread)
    off = (weight > 0) & ~(loops.residual_deg < tolerance)
    refused, undecided = (np.zeros(len(pairs), bool) for _ in range(2))
    undecided[outside] = off & ~loops.reliable
    notes = []
    if undecided.any():
        notes.append(f"{int(undecided.sum())} pairs have no loops to tell by and contradict others: kept")
    if tolerance > tuning.noisy_deg:
        said = f"rotations of pairs contradict each other by {spread:.1f} deg (median): focal lengths, or the rig, are"
        return Loops(refused, undecided, (f"{said} probably wrong. No pair was refused", *notes))
    doubtful = np.flatnonzero(off & loops.reliable)
    asked = [
        (int(i[k]), int(j[k]), turned[j[k]] @ loops.predicted(*ends[k].tolist()) @ turned[i[k]].T) for k in doubtful
    ]
    agree = np.array(run_map(agreeing, asked, matches, bound, tuning), int)
    refused[outside[doubtful]] = agree < tuning.as_good * support[doubtful]
    return Loops(refused, undecided, tuple(notes))


def _units(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """(N,) what turns as one: the frame, or an image for itself where its place in the rig is unknown; (N, 3, 3)
    rotation sensor_from_unit of each image."""
    poses = [s.sensor_from_rig for s in scene.all_sensors]
    known = np.array([p is not None for p in poses])[scene.sensor_key] | (scene.sensor == 0)
    unit = np.where(known, scene.frame, scene.frames + np.arange(len(scene)))
    turned = np.stack([np.eye(3) if p is None else p[:3, :3] for p in poses])
    return unit, turned[scene.sensor_key]


def _neighbours(scene: Scene, a: np.ndarray, b: np.ndarray, steps: int) -> np.ndarray:
    """(K,) bool: frames of one pass at most so many steps apart."""
    apart = np.abs(scene.sequence_index[a].astype(int) - scene.sequence_index[b])
    return (scene.sequence[a] == scene.sequence[b]) & (scene.sequence[a] >= 0) & (apart <= steps)


@dataclass(frozen=True)
class PairRotation:
    """Rotation (3, 3) from the first to the second image of a pair and the matches it explains, 0 = it has none."""

    rotation: np.ndarray
    support: int


def pair_rotation(pair: tuple[int, int], matches: Matches, bound_rad: float, tuning: LoopTuning) -> PairRotation:
    """The rotation between two images by five-point RANSAC and least squares."""
    a, b = matches.rays(*pair)
    options = pycolmap.RANSACOptions(max_error=bound_rad, random_seed=_SEED)
    options.max_num_trials, options.min_num_trials = tuning.trials, 60
    found = pycolmap.estimate_relative_pose(a, b, options) if len(a) >= tuning.least_matches else None
    if not found:
        return PairRotation(np.eye(3), 0)
    inliers = np.asarray(found["inlier_mask"], bool)
    better = pycolmap.refine_relative_pose(found["cam2_from_cam1"], a, b, inliers)
    return PairRotation((better or found)["cam2_from_cam1"].rotation.matrix(), int(inliers.sum()))


def agreeing(item: tuple[int, int, np.ndarray], matches: Matches, bound_rad: float, tuning: LoopTuning) -> int:
    """The most matches of a pair that a rotation (3, 3) explains; translations are sampled from two of them each."""
    a, b = matches.rays(*item[:2])
    turned = a @ item[2].T
    normal = cross(turned, b)
    length = np.linalg.norm(normal, axis=1)
    usable = np.flatnonzero(length > bound_rad)  # nearly parallel rays do not tell where the other image is
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
