"""SIFT by OpenCV, in the form COLMAP's own extractor writes (Lowe 2004; RootSIFT: Arandjelovic & Zisserman 2012)."""

from __future__ import annotations

import cv2
import numpy as np

from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.tuning import SiftTuning

# COLMAP stores root-SIFT scaled by 512 in one byte (colmap/feature/utils.cc); its matcher counts on that length.
DESCRIPTOR_NORM = 512.0


def extract_sift(
    gray: np.ndarray, mask: np.ndarray | None, settings: FeaturesSettings, tuning: SiftTuning
) -> tuple[np.ndarray, np.ndarray]:
    """SIFT features of a grey image (H, W) u1; none are kept where ``mask`` (H, W) bool is False.

    Returns keypoints (K, 4) f4: x, y (pixels, corner convention), scale (pixels, one sigma), orientation (radians, from
    +x to +y), strongest first, and descriptors (K, 128) u1. K = 0 is legal: a blank or masked image.
    """
    check_input(gray, mask)
    if mask is None or mask.all():
        return _strongest(gray, None, settings, tuning, settings.max_features)[0]
    # A descriptor costs more than the rest of a feature: as many are made as the mask can be expected to need.
    share = float(mask.mean())
    if share > _LEAST_FREE:
        features, settled = _strongest(gray, mask, settings, tuning, int(_SPARE * settings.max_features / share))
        if settled:
            return features
    return _strongest(gray, mask, settings, tuning, 0)[0]


# These change what a feature costs, never which are found.
_SPARE = 1.25  # features described for each that is to be kept, where the mask leaves all alike
_LEAST_FREE = 0.2  # share of an image; with less, the search would often have to be repeated

Features = tuple[np.ndarray, np.ndarray]


def _strongest(
    gray: np.ndarray, mask: np.ndarray | None, settings: FeaturesSettings, tuning: SiftTuning, limit: int
) -> tuple[Features, bool]:
    """The features that ``extract_sift`` returns, of the ``limit`` strongest of the whole image (0: of all); and
    whether those of all would be the same."""
    small = shrunk(gray, settings.max_image_size)
    to_full = np.array([gray.shape[1] / small.shape[1], gray.shape[0] / small.shape[0]])
    # Without the precise upscale OpenCV's key points lie 0.25 pixels too far right and down.
    sift = cv2.SIFT.create(
        nfeatures=limit,
        nOctaveLayers=tuning.octave_layers,
        contrastThreshold=settings.contrast,
        enable_precise_upscale=True,
    )
    # One call: computing the descriptors of the kept ones alone would build the pyramid a second time.
    found, descriptors = sift.detectAndCompute(small, None)
    if not found:
        return (np.zeros((0, 4), np.float32), np.zeros((0, 128), np.uint8)), True
    keypoints = np.empty((len(found), 4))
    keypoints[:, :2] = (np.array([k.pt for k in found]) + 0.5) * to_full
    # OpenCV's size is twice the sigma of the key point.
    keypoints[:, 2] = np.array([k.size for k in found]) / 2 * np.sqrt(to_full.prod())
    keypoints[:, 3] = np.radians([k.angle for k in found])
    # Strongest first; ties by place, so that OpenCV's threads cannot change the order.
    response = np.array([k.response for k in found])
    order = np.lexsort((keypoints[:, 3], keypoints[:, 0], keypoints[:, 1], -response))
    # OpenCV would cut to the strongest before it looks at a mask: we mask first.
    free, whole = _free(keypoints[order, :3], mask, tuning)
    chosen = order[free][: settings.max_features]
    settled = not 0 < limit <= len(found) or whole >= max(settings.max_features, tuning.enough_free)
    return (keypoints[chosen].astype(np.float32), root_sift(descriptors[chosen])), settled


def root_sift(descriptors: np.ndarray) -> np.ndarray:
    """Square root of L1-normalised SIFT (K, 128), times 512, one byte each: COLMAP's L1_ROOT."""
    descriptors = np.asarray(descriptors, np.float32)
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12)
    return np.clip(np.rint(DESCRIPTOR_NORM * np.sqrt(descriptors / total)), 0, 255).astype(np.uint8)


def check_input(gray: np.ndarray, mask: np.ndarray | None) -> None:
    """Raise ValueError unless the image is grey 8-bit and the mask a boolean array of its size."""
    if gray.ndim != 2 or gray.dtype != np.uint8:
        raise ValueError(f"SIFT needs a grey 8-bit image, got {gray.shape} {gray.dtype}")
    if mask is not None and (mask.shape != gray.shape or mask.dtype != bool):
        raise ValueError(f"mask {mask.shape} {mask.dtype} does not fit the image {gray.shape}")


def on_mask(keypoints: np.ndarray, mask: np.ndarray | None, tuning: SiftTuning) -> np.ndarray:
    """(K,) bool: which key points (K, 3 or more: x, y in corner convention, scale) have a free support.

    That is a circle of ``support_sigmas`` scales in which the mask (H, W) is True; where fewer than ``enough_free``
    have one, their pixels count. All are kept without a mask.
    """
    return _free(keypoints, mask, tuning)[0]


def _free(keypoints: np.ndarray, mask: np.ndarray | None, tuning: SiftTuning) -> tuple[np.ndarray, int]:
    """What ``on_mask`` returns, and how many key points have a free support."""
    if mask is None:
        return np.ones(len(keypoints), bool), len(keypoints)
    # The distance of a pixel's centre to that of the nearest masked pixel; what lies outside the image is no matter.
    free = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    column, row = np.floor(keypoints[:, :2]).astype(int).T
    distance = free[np.clip(row, 0, mask.shape[0] - 1), np.clip(column, 0, mask.shape[1] - 1)]
    whole = np.asarray(distance > tuning.support_sigmas * keypoints[:, 2])
    count = int(whole.sum())
    return whole if count >= tuning.enough_free else np.asarray(distance > 0), count


def shrunk(gray: np.ndarray, max_image_size: int) -> np.ndarray:
    """The image, or a smaller one whose longer side is ``max_image_size``."""
    factor = max_image_size / max(gray.shape)
    if factor >= 1:
        return gray
    size = (max(1, round(gray.shape[1] * factor)), max(1, round(gray.shape[0] * factor)))
    return cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
