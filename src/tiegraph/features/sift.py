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
    small = shrunk(gray, settings.max_image_size)
    to_full = np.array([gray.shape[1] / small.shape[1], gray.shape[0] / small.shape[0]])
    # Without the precise upscale OpenCV's key points lie 0.25 pixels too far right and down.
    sift = cv2.SIFT.create(
        nfeatures=0,
        nOctaveLayers=tuning.octave_layers,
        contrastThreshold=settings.contrast,
        enable_precise_upscale=True,
    )
    # One call: computing the descriptors of the kept ones alone would build the pyramid a second time.
    found, descriptors = sift.detectAndCompute(small, None)
    if not found:
        return np.zeros((0, 4), np.float32), np.zeros((0, 128), np.uint8)
    keypoints = np.empty((len(found), 4))
    keypoints[:, :2] = (np.array([k.pt for k in found]) + 0.5) * to_full
    # OpenCV's size is twice the sigma of the key point.
    keypoints[:, 2] = np.array([k.size for k in found]) / 2 * np.sqrt(to_full.prod())
    keypoints[:, 3] = np.radians([k.angle for k in found])
    # Strongest first; ties by place, so that OpenCV's threads cannot change the order.
    response = np.array([k.response for k in found])
    order = np.lexsort((keypoints[:, 3], keypoints[:, 0], keypoints[:, 1], -response))
    # OpenCV would cut to the strongest before it looks at a mask: we mask first.
    chosen = order[on_mask(keypoints[order, :3], mask, tuning)][: settings.max_features]
    return keypoints[chosen].astype(np.float32), root_sift(descriptors[chosen])


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
    if mask is None:
        return np.ones(len(keypoints), bool)
    # The distance of a pixel's centre to that of the nearest masked pixel; what lies outside the image is no matter.
    free = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    column, row = np.floor(keypoints[:, :2]).astype(int).T
    distance = free[np.clip(row, 0, mask.shape[0] - 1), np.clip(column, 0, mask.shape[1] - 1)]
    whole = np.asarray(distance > tuning.support_sigmas * keypoints[:, 2])
    return whole if whole.sum() >= tuning.enough_free else np.asarray(distance > 0)


def shrunk(gray: np.ndarray, max_image_size: int) -> np.ndarray:
    """The image, or a smaller one whose longer side is ``max_image_size``."""
    factor = max_image_size / max(gray.shape)
    if factor >= 1:
        return gray
    size = (max(1, round(gray.shape[1] * factor)), max(1, round(gray.shape[0] * factor)))
    return cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
