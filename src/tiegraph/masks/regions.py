"""Regions without an edge inside: what belongs together whatever a table says of its single pixels."""

from __future__ import annotations

import cv2
import numpy as np

from tiegraph.masks.tuning_learnt import RegionsTuning


def textureless_regions(brightness: np.ndarray, tuning: RegionsTuning) -> np.ndarray:
    """Regions (h, w) i4 of a grey image (h, w) u1 that no edge crosses, from 1; 0 = edges and small pieces."""
    fine = cv2.GaussianBlur(brightness.astype(np.float32), (0, 0), tuning.smooth_sigma_px)
    x, y = cv2.Sobel(fine, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(fine, cv2.CV_32F, 0, 1, ksize=3)
    calm = (x * x + y * y < (8 * tuning.edge_grey) ** 2).astype(np.uint8)  # 8: gain of the Sobel kernel
    _, labels, stats, _ = cv2.connectedComponentsWithStats(calm, connectivity=4)
    kept = stats[:, cv2.CC_STAT_AREA] >= tuning.min_share * calm.size
    kept[0] = False
    return np.where(kept, np.cumsum(kept), 0).astype(np.int32)[labels]


def pooled(ratio: np.ndarray, regions: np.ndarray, tuning: RegionsTuning) -> np.ndarray:
    """The mean (h, w) of log ratios (h, w) over the region of each pixel; 0 outside of regions."""
    clipped = np.clip(ratio, -tuning.clip, tuning.clip).ravel()
    count = np.bincount(regions.ravel())
    mean = np.bincount(regions.ravel(), clipped) / np.maximum(count, 1)
    mean[0] = 0
    return mean[regions]
