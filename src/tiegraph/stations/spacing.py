"""How far the points of a shot stand apart: by their distance from what took them, because that is what decides it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.stations.tuning import SpacingTuning


def spacing_of(xyz: np.ndarray, from_origin: bool, tuning: SpacingTuning) -> np.ndarray:
    """(N,) the usual spacing of points (N, 3) as far away as each: a stray point has that of its distance, not its own.

    ``from_origin``: the points are in the frame of what took them; else one spacing for all.
    """
    some = slice(None, None, max(1, len(xyz) // tuning.asked))
    third = cKDTree(xyz).query(xyz[some], k=min(4, len(xyz)))[0][:, -1]  # a disc that wide holds three others
    if not from_origin:
        return np.full(len(xyz), float(np.median(third)))
    away = np.linalg.norm(xyz, axis=1)
    order = np.argsort(away[some], kind="stable")
    parts = np.array_split(order, min(tuning.bands, len(order)))
    middle = [float(np.median(away[some][p])) for p in parts]
    return np.interp(away, middle, [float(np.median(third[p])) for p in parts])
