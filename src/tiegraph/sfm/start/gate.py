"""Is a model that started from rough poses good enough, or must it be mapped from nothing?"""

from __future__ import annotations

import numpy as np
import pycolmap

from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjust import impossible_camera
from tiegraph.sfm.model import MIN_OBSERVATIONS, observations
from tiegraph.sfm.placement.placement import AGREES
from tiegraph.sfm.placement.verified import Verified, agreement, seen_by

# Measured on models that are right to some centimetres (canal, canal_demo, PandaSet, KITTI, Herz-Jesus-P25, oppaiyama,
# fountain-P11): 0.957 to 1.000 of the pairs agree, 0.97 to 1.00 of the tied images see points, 0.20 to 0.69 px.
MIN_AGREEING = 0.9  # share of the verified pairs whose matches the model explains
MIN_SEEING = 0.9  # share of the images with two verified pairs that see points
MAX_ERROR_PX = 2.0  # mean reprojection error; observations are cut at 4 px


def why_not(model: pycolmap.Reconstruction, scene: Scene, verified: Verified, piece: np.ndarray) -> str:
    """Why the model of a ``piece`` (N,) bool of the images is not good enough; "" if it is."""
    own = {k + 1: s.camera for k, s in enumerate(scene.all_sensors) if s.camera is not None}
    lens = impossible_camera(own, model.cameras, set(own) & set(model.cameras))
    if lens is not None:
        return f"no lens is like what became of camera {scene.all_sensors[lens - 1].name}"
    degree = np.bincount(verified.pairs.ravel(), minlength=len(scene))
    tied = piece & (degree >= 2)
    seeing = observations(model, scene) >= MIN_OBSERVATIONS
    share = float(np.mean(seeing[tied])) if tied.any() else 0.0
    if share < MIN_SEEING:
        return f"only {seeing[tied].sum()} of {tied.sum()} tied images see {MIN_OBSERVATIONS} of its points"
    agreed = agreement(verified, seen_by(model, scene))
    judged = agreed[:, 1] > 0
    good = agreed[judged, 0] >= AGREES * agreed[judged, 1]
    if not judged.any() or good.mean() < MIN_AGREEING:
        return f"it contradicts {np.sum(~good)} of {len(good)} verified pairs of images"
    error = float(model.compute_mean_reprojection_error())
    return f"its reprojection error is {error:.1f} px" if error > MAX_ERROR_PX else ""
