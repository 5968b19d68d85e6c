"""Sky that cannot be sky: the model has points there, and nothing is seen through a sky but more sky.

A point seen by other images need not be visible in this one to contradict it: sky hides nothing. So a pale wall that
was called sky in every image is still found out, by its windows and by what is behind it.
"""

import cv2
import numpy as np
import pycolmap

from tiegraph.masks import SKY, USE
from tiegraph.masks.tuning import SkyPointsTuning


def places(image: pycolmap.Image, camera: pycolmap.Camera, points: np.ndarray, tuning: SkyPointsTuning) -> np.ndarray:
    """Where points (P, 3) of a model lie in a registered image, hidden or not: (K, 2) f4 shares of width and height."""
    pose = image.cam_from_world().matrix()
    local = points @ pose[:, :3].T + pose[:, 3]
    local = local[local[:, 2] > 0]
    local = local[np.abs(local[:, :2]).max(axis=1) < tuning.widest * local[:, 2]]
    share = np.asarray(camera.img_from_cam(local)).reshape(-1, 2) / (camera.width, camera.height)
    return share[((share >= 0) & (share < 1)).all(axis=1)].astype(np.float32)


def without_points(classes: np.ndarray, points: np.ndarray, tuning: SkyPointsTuning) -> np.ndarray:
    """Classes (h, w) u1 without the pieces of sky that points of the model lie in; ``points`` as of ``places``."""
    sky = (classes == SKY).astype(np.uint8)
    if not sky.any() or sky.all() or len(points) < tuning.least_points:
        return classes
    height, width = sky.shape
    hit = np.zeros((height, width), np.uint8)
    column, row = (points * (width, height)).astype(int).T
    hit[row.clip(0, height - 1), column.clip(0, width - 1)] = 1
    outside = float(hit[sky == 0].mean())
    apart = cv2.morphologyEx(sky, cv2.MORPH_OPEN, _square(tuning.joint, sky.shape))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(apart, connectivity=4)
    solid = np.zeros(sky.shape, bool)
    for piece in range(1, count):
        window = _window(stats[piece], sky.shape, tuning.hole)
        if np.count_nonzero(hit[window]) < tuning.least_points:
            continue
        own = labels[window] == piece
        filled = cv2.morphologyEx(own.astype(np.uint8), cv2.MORPH_CLOSE, _square(tuning.hole, sky.shape))
        inner = cv2.erode(filled, _square(tuning.edge, sky.shape), borderValue=1) > 0
        found = int(hit[window][inner].sum())
        if found >= tuning.least_points and found > tuning.dense * outside * inner.sum():
            solid[window] |= own
    grown = cv2.dilate(solid.astype(np.uint8), _square(tuning.joint, sky.shape)) > 0  # what the opening took off
    return np.where(grown & (sky > 0), USE, classes).astype(np.uint8)


def _square(share: float, shape: tuple[int, ...]) -> np.ndarray:
    side = 2 * round(share * max(shape) / 2) + 1
    return np.ones((side, side), np.uint8)


def _window(stats: np.ndarray, shape: tuple[int, ...], share: float) -> tuple[slice, slice]:
    """The box of a piece, with room for closing it, a ``share`` of the longer side."""
    room = round(share * max(shape))
    left, top = max(0, stats[cv2.CC_STAT_LEFT] - room), max(0, stats[cv2.CC_STAT_TOP] - room)
    right = stats[cv2.CC_STAT_LEFT] + stats[cv2.CC_STAT_WIDTH] + room
    return slice(top, stats[cv2.CC_STAT_TOP] + stats[cv2.CC_STAT_HEIGHT] + room), slice(left, right)
