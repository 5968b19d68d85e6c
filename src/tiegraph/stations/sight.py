"""What one station saw where another looked through: a sign that they were laid on each other in a wrong place.

A measured point says that nothing stands between it and what took it. Points of another cloud that a fit puts there
contradict the fit, however well the surfaces meet elsewhere. Points behind a surface say nothing: they were hidden.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms
from tiegraph.stations.station import Station
from tiegraph.stations.tuning import SightTuning


def looked_through(a: Station, b: Station, a_from_b: np.ndarray, tuning: SightTuning) -> float:
    """Share of the points of either station that stand in free space of the other, of those that are in its view; the
    larger of both. NaN where it is not known from where a cloud was taken, or too few points are in view."""
    both = [_share(a, b, a_from_b, tuning), _share(b, a, transforms.invert(a_from_b), tuning)]
    return float(np.nanmax(both)) if np.isfinite(both).any() else np.nan


def _share(looking: Station, other: Station, fit: np.ndarray, tuning: SightTuning) -> float:
    """Of the other's points in view of the one that looks: the share nearer than all its own in their direction."""
    eye, side = looking.eye, looking.coarse.side
    if eye is None:
        return np.nan
    own, ray = _distances(looking.coarse.xyz - eye)
    away, towards = _distances(transforms.apply(fit, other.coarse.xyz) - eye)
    apart, at = cKDTree(ray).query(towards, k=tuning.neighbours)
    view = (apart * own[at] < tuning.apart * side).all(axis=1)  # chords as lengths at the distance of the own point
    if np.count_nonzero(view) < tuning.least_points:
        return np.nan
    before = away[view] < own[at[view]].min(axis=1) - tuning.before * side
    return float(before.mean())


def _distances(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (N,) and directions (N, 3) of vectors (N, 3)."""
    length = np.linalg.norm(xyz, axis=1)
    return length, xyz / np.maximum(length, 1e-12)[:, None]
