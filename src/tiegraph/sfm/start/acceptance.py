"""Is a model that started from rough poses good enough, or must it be mapped from nothing?"""

from __future__ import annotations

import numpy as np
import pycolmap

from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import impossible_camera
from tiegraph.sfm.model import observations
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.verified import VerifiedMatches, agreement, image_observations


def refusal(
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, piece: np.ndarray, tuning: Tuning
) -> str:
    """Why the model of a ``piece`` (N,) bool of the images is not good enough; "" if it is."""
    gate = tuning.start.acceptance
    own = {k + 1: s.camera for k, s in enumerate(scene.all_sensors) if s.camera is not None}
    lens = impossible_camera(own, model.cameras, set(own) & set(model.cameras), tuning.adjust)
    if lens is not None:
        return f"no lens is like what became of camera {scene.all_sensors[lens - 1].name}"
    degree = np.bincount(verified.pairs.ravel(), minlength=len(scene))
    tied = piece & (degree >= gate.tied_pairs)
    seeing = observations(model, scene) >= tuning.adjust.min_points
    share = float(np.mean(seeing[tied])) if tied.any() else 0.0
    if share < gate.min_seeing:
        return f"only {seeing[tied].sum()} of {tied.sum()} tied images see {tuning.adjust.min_points} of its points"
    agreed = agreement(verified, image_observations(model, scene, tuning.placement.agreement))
    judged = agreed[:, 1] > 0
    good = agreed[judged, 0] >= tuning.placement.consistency.agrees * agreed[judged, 1]
    if not judged.any() or good.mean() < gate.min_agreeing:
        return f"it contradicts {np.sum(~good)} of {len(good)} verified pairs of images"
    error = float(model.compute_mean_reprojection_error())
    return f"its reprojection error is {error:.1f} px" if error > gate.max_error_px else ""
