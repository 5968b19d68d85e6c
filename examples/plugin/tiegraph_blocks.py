"""Dense engine ``blocks``: OpenCV's block matching on rectified pairs, fast and coarse; tiegraph triangulates."""

from functools import partial

import cv2
import numpy as np

from tiegraph.dense.engine import rectified_engine
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning

SIDE = 9  # of a block, pixels


def match(
    left: np.ndarray, right: np.ndarray, disparities: int, settings: DenseSettings, tuning: Tuning, use: np.ndarray
) -> np.ndarray:
    """Disparities (h, w) f4 of left (h, w) in right (h, w + disparities); NaN = none."""
    count = -(-disparities // 16) * 16  # as OpenCV wants it
    right = cv2.copyMakeBorder(right, 0, 0, count - disparities, 0, cv2.BORDER_REPLICATE)
    left = cv2.copyMakeBorder(left, 0, 0, count, 0, cv2.BORDER_REPLICATE)
    found = cv2.StereoBM.create(count, SIDE).compute(left, right)[:, count:]
    return np.where(found > 0, found / np.float32(16), np.float32(np.nan))


ENGINE = partial(rectified_engine, matcher=match)
