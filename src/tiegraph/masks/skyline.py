"""The sky of one image by its border: the curve along which sky and ground differ most (Shen and Wang 2013)."""

from __future__ import annotations

import cv2
import numpy as np

# Shen and Wang, section 3: thresholds from 5 to 600 in steps of 5, gamma = 2. Above 300 no border was ever chosen here.
_THRESHOLDS = np.arange(5, 300, 10, dtype=np.float32)
_GAMMA = 2.0
_SMALL_PX = 160  # longer side at which the border is sought: it gives seeds, not masks
_MIN_SHARE, _MAX_SHARE = 0.02, 0.85
_BRIGHTER = 12.0  # grey levels that the sky is brighter than what is below it
_MIN_SKY_GREY = 60.0
_CALM_GREY, _BRIGHT_GREY, _LARGE = 4.0, 90.0, 0.03  # of the sky above an upward camera
_CALM = 0.5  # texture of the sky, as a share of that below


def border_sky(image: np.ndarray) -> np.ndarray | None:
    """Sky (h, w) bool of an image (h, w, 3) u1 BGR from the top down to a border; None if none is believable.

    A sky is calmer and brighter than what is below it. Clouds, bridges and up cameras break the border: this gives
    the seeds from which the sky's appearance is learnt, not the mask.
    """
    scale = _SMALL_PX / max(image.shape[:2])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    brightness = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.float32)
    x, y = cv2.Sobel(brightness, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(brightness, cv2.CV_32F, 0, 1, ksize=3)
    gradient = np.sqrt(x * x + y * y)
    gradient[0] = 0  # a border on the first row leaves nothing
    edges = gradient[None] > _THRESHOLDS[:, None, None]
    borders = np.where(edges.any(axis=1), edges.argmax(axis=1), len(brightness))  # (T, w) first ground row
    borders = np.unique(borders, axis=0)
    sky = _best(small, borders)
    if sky is None or not _believable(brightness, gradient, sky):
        return None
    sky = cv2.erode(sky.astype(np.uint8), np.ones((3, 3), np.uint8))
    return cv2.resize(sky, image.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0


def _best(image: np.ndarray, borders: np.ndarray) -> np.ndarray | None:
    """The sky of the border with the largest energy J (equation 7), (h, w) bool; None if no border leaves two parts."""
    height, width = image.shape[:2]
    pixels = image.astype(np.float64)
    moments = np.concatenate([pixels, (pixels[..., :, None] * pixels[..., None, :]).reshape(height, width, 9)], axis=2)
    below_row = np.concatenate([np.zeros((1, width, 12)), np.cumsum(moments, axis=0)])  # sums of the rows above
    total = below_row[-1].sum(axis=0)
    sums = below_row[borders, np.arange(width)].sum(axis=1)  # (T, 12)
    count = borders.sum(axis=1)
    share = count / (height * width)
    usable = (share > _MIN_SHARE) & (share < _MAX_SHARE)
    if not usable.any():
        return None
    energy = 1 / (_GAMMA * _spread(sums, count) + _spread(total - sums, height * width - count) + 1e-9)
    best = int(np.argmax(np.where(usable, energy, -1)))
    return np.arange(height)[:, None] < borders[best]


def _spread(sums: np.ndarray, count: np.ndarray) -> np.ndarray:
    """|Sigma| + |lambda_1| of the colours, (T,), from sums (T, 12) over ``count`` pixels."""
    count = np.maximum(count, 1)
    mean = sums[:, :3] / count[:, None]
    covariance = sums[:, 3:].reshape(-1, 3, 3) / count[:, None, None] - mean[:, :, None] * mean[:, None, :]
    values = np.maximum(np.linalg.eigvalsh(covariance), 0)
    return values.prod(axis=1) + values[:, -1]


def _believable(brightness: np.ndarray, gradient: np.ndarray, sky: np.ndarray) -> bool:
    above, below = brightness[sky], brightness[~sky]
    if above.mean() < max(_MIN_SKY_GREY, below.mean() + _BRIGHTER):
        return False
    inner = cv2.erode(sky.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    return bool(inner.any()) and float(gradient[inner].mean()) < _CALM * float(gradient[~sky].mean())


def calm_sky(image: np.ndarray, matched: np.ndarray) -> np.ndarray | None:
    """Sky (h, w) bool in an image that looks up: large, calm, bright areas without a matched feature; None = none.

    ``matched`` (h, w) bool: round the features that were found again in another frame.
    """
    brightness = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    mean = cv2.blur(brightness, (5, 5))
    deviation = np.sqrt(np.maximum(cv2.blur(brightness * brightness, (5, 5)) - mean * mean, 0))
    calm = cv2.erode(((deviation < _CALM_GREY) & ~matched).astype(np.uint8), np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(calm, connectivity=4)
    light = np.bincount(labels.ravel(), brightness.ravel(), minlength=count) / np.maximum(stats[:, cv2.CC_STAT_AREA], 1)
    sky = (stats[:, cv2.CC_STAT_AREA] >= _LARGE * calm.size) & (light >= _BRIGHT_GREY)
    sky[0] = False
    return sky[labels] if sky.any() else None
