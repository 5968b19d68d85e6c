"""How well the adjustment knows what lies between two frames, by how far they are apart: the shape of a survey."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pycolmap
from scipy.spatial.distance import pdist, squareform

from tiegraph.sfm.covariance import PositionSigma

BETWEEN = "sigma of what lies between two frames, units of the model"
_COLUMNS = ["apart", "sigma", "pairs of frames"]
_STEPS = 2  # rows for each doubling of the distance


def between_frames(model: pycolmap.Reconstruction, sigma: PositionSigma, min_pairs: int) -> Mapping[str, dict]:
    """Table by distance of the sigma of the vector between two frames (root mean square over pairs), model units.

    {} without a covariance. After the best similarity of the whole, as all of ``PositionSigma``: the sigma of the scale
    is not in it. Distances of fewer than ``min_pairs`` pairs are left out.
    """
    if sigma.covariance is None:
        return {}
    count = len(sigma.frame_ids)
    places = np.array([_centre(model.frame(k)) for k in sigma.frame_ids])
    # of C (F, 3, F, 3) the traces of its blocks (F, F): var(p_j - p_i) = C_ii + C_jj - 2 C_ij
    shared = np.einsum("iaja->ij", sigma.covariance.reshape(count, 3, count, 3))
    own = np.diag(shared)
    variance = squareform(own[:, None] + own[None, :] - shared - shared.T, checks=False)
    apart = pdist(places)
    there = apart > 0
    step = np.round(_STEPS * np.log2(apart[there])).astype(int)
    apart, variance = apart[there], np.clip(variance[there], 0, None)
    rows = []
    for k in np.unique(step):
        of = step == k
        if of.sum() >= min_pairs:
            rows.append([float(np.median(apart[of])), float(np.sqrt(variance[of].mean())), int(of.sum())])
    return {BETWEEN: {"columns": _COLUMNS, "rows": rows}} if rows else {}


def _centre(frame: pycolmap.Frame) -> np.ndarray:
    """(3,) place of a frame in the world."""
    pose = frame.rig_from_world
    return np.full(3, np.nan) if pose is None else np.asarray(pose.inverse().translation, float)
