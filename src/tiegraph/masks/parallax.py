"""How near what matches is, from two images: sky has no parallax, a wall that looks like sky has as much as others.

No lens is known yet. Two focal lengths are tried, and what is far by one of them is not called near: on walls, kitchens
and car parks every match is near by both, on clouds hardly one.
"""

from __future__ import annotations

import cv2
import numpy as np

from tiegraph.masks.tuning_learnt import MatchabilityTuning

_SEED = 0


def nearness(a: np.ndarray, b: np.ndarray, shape: tuple[int, int], tuning: MatchabilityTuning) -> np.ndarray:
    """Parallax (K,) f4 of matches ``a``, ``b`` (K, 2) pixels of two images of ``shape`` = (h, w), as a share of that at
    the median depth of all: 0 = infinitely far, 1 = as near as the scene; NaN where it cannot be told."""
    found = np.stack([_by_focal(a, b, shape, f * max(shape), tuning) for f in tuning.focals])
    least = np.abs(found).argmin(axis=0)  # NaN counts as least: it is unknown if any does not know it
    return found[least, np.arange(len(a))].astype(np.float32)


def _by_focal(
    a: np.ndarray, b: np.ndarray, shape: tuple[int, int], focal: float, tuning: MatchabilityTuning
) -> np.ndarray:
    unknown = np.full(len(a), np.nan)
    centre = np.array(shape[::-1]) / 2
    ray_a, ray_b = (a - centre) / focal, (b - centre) / focal
    every = slice(None, None, -(-len(a) // tuning.motion_matches))
    cv2.setRNGSeed(_SEED)
    try:
        options = cv2.RANSAC, tuning.confidence, tuning.epipolar_px / focal, tuning.motion_trials
        essential, inliers = cv2.findEssentialMat(ray_a[every], ray_b[every], np.eye(3), *options)
        if essential is None or essential.shape != (3, 3):
            return unknown
        count, rotation, towards, _ = cv2.recoverPose(essential, ray_a[every], ray_b[every], np.eye(3), mask=inliers)
    except cv2.error:  # no geometry fits
        return unknown
    if count < tuning.min_in_front:
        return unknown
    far = np.column_stack([ray_a, np.ones(len(a))]) @ rotation.T
    x, y, z = towards.ravel()
    with np.errstate(all="ignore"):
        lever = (np.array([x, y]) * far[:, 2:] - far[:, :2] * z) / far[:, 2:] ** 2
        length = np.linalg.norm(lever, axis=1)
        inverse = ((ray_b - far[:, :2] / far[:, 2:]) * lever).sum(axis=1) / length**2
        middle = np.nanmedian(inverse)
        known = (middle > 0) & (focal * length * middle > tuning.min_parallax_px) & (far[:, 2] > 0)
        return np.where(known, inverse / middle, np.nan)
