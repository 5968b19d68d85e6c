"""The sky of one image by its border: the curve along which sky and ground differ most (Shen and Wang 2013)."""

import cv2
import numpy as np

from tiegraph.masks.morphology import dilated, eroded, scaled
from tiegraph.masks.tuning_learnt import SkylineTuning

_GAMMA = 2.0  # Shen and Wang, section 3: it is part of their energy J


def border_sky(image: np.ndarray, tuning: SkylineTuning, ego: np.ndarray | None = None) -> np.ndarray | None:
    """Sky (h, w) bool of an image (h, w, 3) u1 BGR from the top down to a border; None if none is believable.

    A sky is calmer and brighter than what is below it, and not yellow. Clouds, bridges and up cameras break the border:
    this gives the seeds from which the sky's appearance is learnt, not the mask. ``ego`` (h, w) bool: where the
    platform, or the surround of a fisheye lens, reaches down from the top of the image, the sky begins below it.
    """
    scale = tuning.border_px / max(image.shape[:2])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    free = np.ones(small.shape[:2], bool)
    if ego is not None:
        free = ~np.logical_and.accumulate(scaled(ego, small.shape[:2]), axis=0)
    brightness = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.float32)
    x, y = cv2.Sobel(brightness, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(brightness, cv2.CV_32F, 0, 1, ksize=3)
    gradient = np.sqrt(x * x + y * y)
    gradient[0] = 0  # a border on the first row leaves nothing
    gradient[dilated(~free, tuning.platform_px)] = 0
    thresholds = np.arange(tuning.first_threshold, tuning.end_threshold, tuning.threshold_step, dtype=np.float32)
    edges = gradient[None] > thresholds[:, None, None]
    borders = np.where(edges.any(axis=1), edges.argmax(axis=1), len(brightness))  # (T, w) first ground row
    borders = np.unique(borders, axis=0)
    sky = _best(small, borders, free, tuning)
    if sky is None or not _believable(small, gradient, sky & free, ~sky & free, tuning):
        return None
    sky = eroded(sky & free, tuning.rim_px)
    return cv2.resize(sky.astype(np.uint8), image.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0


def _best(image: np.ndarray, borders: np.ndarray, free: np.ndarray, tuning: SkylineTuning) -> np.ndarray | None:
    """The sky of the border with the largest energy J (equation 7), (h, w) bool; None if no border leaves two parts."""
    height, width = image.shape[:2]
    pixels = image.astype(np.float64)
    products = (pixels[..., :, None] * pixels[..., None, :]).reshape(height, width, 9)
    moments = np.concatenate([np.ones((height, width, 1)), pixels, products], axis=2) * free[..., None]
    below_row = np.concatenate([np.zeros((1, width, 13)), np.cumsum(moments, axis=0)])  # sums of the rows above
    total = below_row[-1].sum(axis=0)
    sums = below_row[borders, np.arange(width)].sum(axis=1)  # (T, 13)
    share = sums[:, 0] / max(total[0], 1)
    usable = (share > tuning.min_share) & (share < tuning.max_share)
    if not usable.any():
        return None
    energy = 1 / (_GAMMA * _spread(sums) + _spread(total - sums) + 1e-9)
    best = int(np.argmax(np.where(usable, energy, -1)))
    return np.arange(height)[:, None] < borders[best]


def _spread(sums: np.ndarray) -> np.ndarray:
    """|Sigma| + |lambda_1| of the colours, (T,), from sums (T, 13) of one, the colours and their products."""
    count = np.maximum(sums[:, 0], 1)
    mean = sums[:, 1:4] / count[:, None]
    covariance = sums[:, 4:].reshape(-1, 3, 3) / count[:, None, None] - mean[:, :, None] * mean[:, None, :]
    values = np.maximum(np.linalg.eigvalsh(covariance), 0)
    return values.prod(axis=1) + values[:, -1]


def _believable(
    image: np.ndarray, gradient: np.ndarray, sky: np.ndarray, ground: np.ndarray, tuning: SkylineTuning
) -> bool:
    inner = eroded(sky, tuning.inner_px)
    if not inner.any() or not ground.any():
        return False
    yellow = cv2.cvtColor(image, cv2.COLOR_BGR2Lab)[..., 2]
    brightness = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    if brightness[sky].mean() < max(tuning.min_grey, brightness[ground].mean() + tuning.brighter_grey):
        return False
    if np.median(yellow[sky]) > 128 + tuning.most_yellow:
        return False
    return float(gradient[inner].mean()) < tuning.textureless * float(gradient[ground].mean())


def textureless_sky(image: np.ndarray, matched: np.ndarray, tuning: SkylineTuning) -> np.ndarray | None:
    """Sky (h, w) bool in an image that looks up: large, calm, bright areas without a matched feature; None = none.

    ``matched`` (h, w) bool: round the features that were found again in another frame.
    """
    brightness = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    around = (tuning.up_window_px, tuning.up_window_px)
    mean = cv2.blur(brightness, around)
    deviation = np.sqrt(np.maximum(cv2.blur(brightness * brightness, around) - mean * mean, 0))
    calm = eroded((deviation < tuning.up_textureless_grey) & ~matched, tuning.rim_px).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(calm, connectivity=4)
    light = np.bincount(labels.ravel(), brightness.ravel(), minlength=count) / np.maximum(stats[:, cv2.CC_STAT_AREA], 1)
    sky = (stats[:, cv2.CC_STAT_AREA] >= tuning.up_large * calm.size) & (light >= tuning.up_bright_grey)
    sky[0] = False
    return sky[labels] if sky.any() else None
