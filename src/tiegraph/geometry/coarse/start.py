"""Where a cloud lies on another, near enough for ICP to go on from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms
from tiegraph.geometry.coarse.consistent import motions
from tiegraph.geometry.coarse.shape import shape_of, side_for
from tiegraph.geometry.coarse.tuning import CoarseTuning

_UPWARDS = np.array([0.36, 0.48, 0.8])  # the side of surfaces where nothing tells it: walls have one too
_WIDER = 4  # times the points of the tuning, that the larger of two clouds may have


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
