"""Outlier filters in object space (paper 004, section 6): statistical and radius outlier removal as in PCL.

Distances are counted in each point's own spacing, because the spacing varies within a cloud.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.cloud.settings import CloudSettings

_CHUNK = 200_000  # points asked at once: bounds the memory of the neighbour table


@dataclass(frozen=True)
class Filtered:
    """keep (M,) bool, and how many points each filter dropped."""

    keep: np.ndarray
    statistical: int
    radius: int


def filter_points(
    xyz: np.ndarray, spacing: np.ndarray, settings: CloudSettings, around: np.ndarray | None = None
) -> Filtered:
    """Both filters on points (M, 3) with spacing (M,); ``around`` (K, 3): points of the surroundings, counted as
    neighbours only, so that the border of a tile is not a border of the cloud."""
    if len(xyz) == 0:
        return Filtered(np.zeros(0, bool), 0, 0)
    tree = cKDTree(xyz if around is None else np.concatenate([xyz, around]))
    near = statistical_inliers(xyz, spacing, tree, settings.neighbours, settings.statistical_ratio)
    dense = radius_inliers(xyz, settings.radius_voxels * spacing, tree, settings.radius_neighbours)
    keep = near & dense
    return Filtered(keep, int(np.count_nonzero(~near)), int(np.count_nonzero(near & ~dense)))


def statistical_inliers(
    xyz: np.ndarray, spacing: np.ndarray, tree: cKDTree, neighbours: int, ratio: float
) -> np.ndarray:
    """(M,) bool: mean distance to the nearest ``neighbours`` at most the mean of all plus ``ratio`` deviations."""
    if ratio == 0 or tree.n <= neighbours:
        return np.ones(len(xyz), bool)
    mean = np.empty(len(xyz))
    for s in range(0, len(xyz), _CHUNK):
        part = slice(s, s + _CHUNK)
        mean[part] = np.asarray(tree.query(xyz[part], k=neighbours + 1)[0])[:, 1:].mean(axis=1)
    mean = mean / spacing
    # A few points very far away would enlarge the deviation and save the others: distances are held at 10 medians.
    held = np.minimum(mean, 10 * np.median(mean))
    return mean <= held.mean() + ratio * held.std()


def radius_inliers(xyz: np.ndarray, radius: np.ndarray, tree: cKDTree, neighbours: int) -> np.ndarray:
    """(M,) bool: at least ``neighbours`` other points within radius (M,)."""
    if neighbours == 0:
        return np.ones(len(xyz), bool)
    found = np.empty(len(xyz), bool)
    for s in range(0, len(xyz), _CHUNK):
        part = slice(s, s + _CHUNK)
        # The distance to the n-th neighbour answers without listing all within the radius.
        limit = 1.001 * float(radius[part].max())
        distance = tree.query(xyz[part], k=[neighbours + 1], distance_upper_bound=limit)[0]
        found[part] = np.asarray(distance)[:, 0] <= radius[part]
    return found
