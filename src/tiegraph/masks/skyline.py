"""The sky of one image by its border, the curve along which sky and ground differ most (Shen and Wang 2013), and
false skies: the model has points there, whether seen in this image or not, for sky hides nothing. So a pale wall that
was called sky in every image is detected, by its windows and by the scene behind it.
"""

import cv2
import numpy as np
import pycolmap

from tiegraph.masks import SKY, USE
from tiegraph.masks.frames import closed, dilated, eroded, full_size, grey, opened
from tiegraph.masks.tuning import Tuning


def border_sky(image: np.ndarray, tuning: Tuning, ego: np.ndarray | None = None) -> np.ndarray | None:
    """Sky (h, w) bool of an image (h, w, 3) u1 BGR from the top down to a border; None if none is plausible.

    A sky is calmer and brighter than the part below it, and not yellow. Clouds, bridges and up cameras break it:
    this gives the seeds from which the sky's appearance is learnt, not the mask. ``ego`` (h, w) bool: where the
    platform, or the surround of a fisheye lens, reaches down from the top of the image, the sky begins below it.
    """
    scale = 160 / max(image.shape[:2])  # longer side at which the border is searched: it gives seeds, not masks
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    free = np.ones(small.shape[:2], bool)
    if ego is not None:
        free = ~np.logical_and.accumulate(full_size(ego, small.shape[:2]), axis=0)
    brightness = grey(small).astype(np.float32)
    x, y = cv2.Sobel(brightness, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(brightness, cv2.CV_32F, 0, 1, ksize=3)
    gradient = np.sqrt(x * x + y * y)
    gradient[0] = 0  # a border on the first row leaves nothing
    gradient[dilated(~free, 5)] = 0  # the platform's own edge is no border
    # Shen and Wang, section 3: from 5 to 600 in steps of 5; above 300 no border was ever chosen here
    thresholds = np.arange(5.0, 300.0, 10.0, dtype=np.float32)
    edges = gradient[None] > thresholds[:, None, None]
    borders = np.where(edges.any(axis=1), edges.argmax(axis=1), len(brightness))  # (T, w) first ground row
    borders = np.unique(borders, axis=0)
    sky = _best(small, borders, free, tuning)
    if sky is None or not _believable(small, gradient, sky & free, ~sky & free, tuning):
        return None
    sky = eroded(sky & free, tuning.fine_px)
    return full_size(sky, image.shape[:2])


def _best(image: np.ndarray, borders: np.ndarray, free: np.ndarray, tuning: Tuning) -> np.ndarray | None:
    """The sky of the border with the largest energy J (equation 7), (h, w) bool; None if no border leaves two parts."""
    height, width = image.shape[:2]
    pixels = image.astype(np.float64)
    products = (pixels[..., :, None] * pixels[..., None, :]).reshape(height, width, 9)
    moments = np.concatenate([np.ones((height, width, 1)), pixels, products], axis=2) * free[..., None]
    below_row = np.concatenate([np.zeros((1, width, 13)), np.cumsum(moments, axis=0)])  # sums of the rows above
    total = below_row[-1].sum(axis=0)
    sums = below_row[borders, np.arange(width)].sum(axis=1)  # (T, 13)
    share = sums[:, 0] / max(total[0], 1)
    usable = (share > tuning.part) & (share < 0.85)
    if not usable.any():
        return None
    # Shen and Wang, section 3, have the sky count twice
    energy = 1 / (2.0 * _spread(sums) + _spread(total - sums) + 1e-9)
    best = int(np.argmax(np.where(usable, energy, -1)))
    return np.arange(height)[:, None] < borders[best]


def _spread(sums: np.ndarray) -> np.ndarray:
    """|Sigma| + |lambda_1| of the colours, (T,), from sums (T, 13) of one, the colours and their products."""
    count = np.maximum(sums[:, 0], 1)
    mean = sums[:, 1:4] / count[:, None]
    covariance = sums[:, 4:].reshape(-1, 3, 3) / count[:, None, None] - mean[:, :, None] * mean[:, None, :]
    values = np.maximum(np.linalg.eigvalsh(covariance), 0)
    return values.prod(axis=1) + values[:, -1]


def _believable(image: np.ndarray, gradient: np.ndarray, sky: np.ndarray, ground: np.ndarray, tuning: Tuning) -> bool:
    inner = eroded(sky, tuning.window_px)
    if not inner.any() or not ground.any():
        return False
    yellow, brightness = cv2.cvtColor(image, cv2.COLOR_BGR2Lab)[..., 2], grey(image)
    if brightness[sky].mean() < max(60.0, brightness[ground].mean() + tuning.faint_grey):
        return False
    if np.median(yellow[sky]) > 128 + 10.0:  # sand and sunlit plaster are yellow
        return False
    return float(gradient[inner].mean()) < 0.5 * float(gradient[ground].mean())


def textureless_sky(image: np.ndarray, matched: np.ndarray, tuning: Tuning) -> np.ndarray | None:
    """Sky (h, w) bool in an image that looks up: large, calm, bright areas without a matched feature; None = none.

    ``matched`` (h, w) bool: round the features that were found again in another frame.
    """
    brightness = grey(image).astype(np.float32)
    around = (tuning.window_px, tuning.window_px)
    mean = cv2.blur(brightness, around)
    deviation = np.sqrt(np.maximum(cv2.blur(brightness * brightness, around) - mean * mean, 0))
    calm = eroded((deviation < 4.0) & ~matched, tuning.fine_px).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(calm, connectivity=4)
    light = np.bincount(labels.ravel(), brightness.ravel(), minlength=count) / np.maximum(stats[:, cv2.CC_STAT_AREA], 1)
    sky = (stats[:, cv2.CC_STAT_AREA] >= 0.03 * calm.size) & (light >= 90.0)  # darker ones are bridges
    sky[0] = False
    return sky[labels] if sky.any() else None


def places(image: pycolmap.Image, camera: pycolmap.Camera, points: np.ndarray, tuning: Tuning) -> np.ndarray:
    """Where points (P, 3) of a model lie in a registered image, hidden or not: (K, 2) f4 shares of width and height."""
    pose = image.cam_from_world().matrix()
    local = points @ pose[:, :3].T + pose[:, 3]
    local = local[local[:, 2] > 0]
    local = local[np.abs(local[:, :2]).max(axis=1) < tuning.sky.widest * local[:, 2]]
    share = np.asarray(camera.img_from_cam(local)).reshape(-1, 2) / (camera.width, camera.height)
    return share[((share >= 0) & (share < 1)).all(axis=1)].astype(np.float32)


def without_points(classes: np.ndarray, points: np.ndarray, tuning: Tuning) -> np.ndarray:
    """Classes (h, w) u1 without the pieces of sky that points of the model lie in; ``points`` as of ``places``."""
    sky = (classes == SKY).astype(np.uint8)
    if not sky.any() or sky.all() or len(points) < tuning.witnesses:
        return classes
    height, width = sky.shape
    hit = np.zeros((height, width), np.uint8)
    column, row = (points * (width, height)).astype(int).T
    hit[row.clip(0, height - 1), column.clip(0, width - 1)] = 1
    outside = float(hit[sky == 0].mean())
    count, labels = cv2.connectedComponents(opened(sky, tuning.window_px).astype(np.uint8), connectivity=4)
    solid = np.zeros(sky.shape, bool)
    for piece in range(1, count):
        own = labels == piece
        inner = eroded(closed(own, tuning.sky.hole_px), tuning.band_px)
        found = int(hit[inner].sum())
        if found >= tuning.witnesses and found > tuning.dense * outside * inner.sum():
            solid |= own
    grown = dilated(solid, tuning.window_px)  # what the opening took off
    return np.where(grown & (sky > 0), USE, classes).astype(np.uint8)
