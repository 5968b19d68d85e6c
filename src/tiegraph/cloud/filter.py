"""Outlier filters in object space (paper 004, section 6): statistical and radius outlier removal as in PCL.

Distances are counted in each point's own spacing, because the spacing varies within a cloud.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.cloud.settings import CloudSettings
from tiegraph.cloud.tuning import Tuning

_CHUNK = 200_000  # points asked at once: bounds the memory of the neighbour table


@dataclass(frozen=True)
class FilterResult:
    """keep (M,) bool, and how many points each filter dropped."""

    keep: np.ndarray
    statistical: int
    radius: int


def filter_points(
    xyz: np.ndarray, spacing: np.ndarray, settings: CloudSettings, tuning: Tuning, around: np.ndarray | None = None
) -> FilterResult:
    """Both filters on points (M, 3) with spacing (M,); ``around`` (K, 3): points of the surroundings, counted as
    neighbours only, so that the border of a tile is not a border of the cloud.

    *Statistical*: the mean distance to the nearest ``neighbours`` is at most the mean of all plus ``statistical_ratio``
    deviations. *Radius*: ``radius_neighbours`` other points lie within ``radius_voxels`` spacings.
    """
    count, wanted = settings.neighbours, settings.radius_neighbours
    if len(xyz) == 0:
        return FilterResult(np.zeros(0, bool), 0, 0)
    tree = cKDTree(xyz if around is None else np.concatenate([xyz, around]))
    statistical = settings.statistical_ratio > 0 and tree.n > count
    mean, furthest = np.zeros(len(xyz)), np.zeros(len(xyz))
    for s in range(0, len(xyz) if statistical or wanted else 0, _CHUNK):
        part = slice(s, s + _CHUNK)
        # The distance to the n-th neighbour says whether n are within the radius.
        distance = np.asarray(tree.query(xyz[part], k=1 + max(count if statistical else 0, wanted))[0])
        furthest[part] = distance[:, wanted]
        mean[part] = distance[:, 1 : count + 1] @ np.full(count, 1 / count) if statistical else 0
    near = _statistical_inliers(mean / spacing, settings.statistical_ratio, tuning.held_medians)
    dense = furthest <= settings.radius_voxels * spacing
    keep = near & dense
    return FilterResult(keep, int(np.count_nonzero(~near)), int(np.count_nonzero(near & ~dense)))


def _statistical_inliers(mean: np.ndarray, ratio: float, held_medians: float) -> np.ndarray:
    held = np.minimum(mean, held_medians * np.median(mean))
    return mean <= held.mean() + ratio * held.std()
