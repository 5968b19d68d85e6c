"""Matching of a rectified pair by OpenCV's semi-global matching (Hirschmueller 2008, block matching variant)."""

import cv2
import numpy as np

from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning

_MODES = {3: cv2.STEREO_SGBM_MODE_SGBM_3WAY, 5: cv2.STEREO_SGBM_MODE_SGBM, 8: cv2.STEREO_SGBM_MODE_HH}
_SUBPIXEL = 16  # OpenCV's fixed point: steps of a pixel in 16 bits; the disparities of one image may span 2000 pixels
_SHIFT_PX = 16  # the sub-pixel part of a disparity of 0 may be negative
LEFT_RIGHT_PX = 1  # disagreement between both directions, at most: paper 004, section 5.2.2
# Of the largest cost volume, pixels times disparities: a larger pair is matched at a coarser resolution.
MAX_CELLS = 800e6


def match_sgbm(
    left: np.ndarray,
    right: np.ndarray,
    disparities: int,
    settings: DenseSettings,
    tuning: Tuning,
    use: np.ndarray | None = None,
) -> np.ndarray:
    """Disparity (h, w) f4 px of each left pixel, NaN = none: the ``PairMatcher`` contract of ``dense.engine``; all
    pixels are matched, in ``use`` or not.

    left (h, w) u1; right (h, w + disparities) u1, whose column ``disparities`` lies under the left's column 0: left
    (x, y) shows what right (x + disparities - d, y) shows, 0 <= d < disparities.
    """
    count = -(-disparities // 16) * 16
    pad = count - disparities
    wide_right = cv2.copyMakeBorder(right, 0, 0, pad, 0, cv2.BORDER_REPLICATE)
    wide_left = cv2.copyMakeBorder(left, 0, 0, count, 0, cv2.BORDER_REPLICATE)
    forward = _run(wide_left, wide_right, count, settings)[:, count:]
    # The other way round: mirrored, the right image is the left one. It needs the left image's continuation.
    mirror_left = np.ascontiguousarray(cv2.copyMakeBorder(wide_right, 0, 0, 0, count, cv2.BORDER_REPLICATE)[:, ::-1])
    mirror_right = np.ascontiguousarray(cv2.copyMakeBorder(wide_left, 0, 0, 0, count, cv2.BORDER_REPLICATE)[:, ::-1])
    backward = _run(mirror_left, mirror_right, count, settings)[:, count:][:, ::-1]
    return without_speckles(_left_right(forward, backward, count))


def _run(left: np.ndarray, right: np.ndarray, count: int, settings: DenseSettings) -> np.ndarray:
    matcher = cv2.StereoSGBM_create(  # type: ignore[attr-defined]
        minDisparity=0,
        numDisparities=count,
        # OpenCV's rule gives 72 and 288 for blocks of 3 x 3, the most exact ones on the Middlebury pairs; larger ones
        # reach further over weak texture.
        blockSize=3,
        P1=120,
        P2=480,
        disp12MaxDiff=-1,
        preFilterCap=63,
        uniquenessRatio=5,
        speckleWindowSize=0,
        mode=_MODES[settings.paths],
    )
    fixed = matcher.compute(left, right)
    return np.where(fixed < 0, np.float32(np.nan), fixed.astype(np.float32) / _SUBPIXEL)


def _left_right(forward: np.ndarray, backward: np.ndarray, count: int) -> np.ndarray:
    """Forward disparities (h, w) whose right pixel leads back to nearly the left one; backward is (h, w + count)."""
    known = np.isfinite(forward)
    column = np.arange(forward.shape[1]) + count - np.rint(np.where(known, forward, 0)).astype(np.int64)
    back = np.take_along_axis(backward, np.clip(column, 0, backward.shape[1] - 1), axis=1)
    agrees = np.abs(back - forward) <= LEFT_RIGHT_PX  # NaN compares false
    return np.where(known & agrees, forward, np.float32(np.nan))


def without_speckles(disparity: np.ndarray) -> np.ndarray:
    """Disparity (h, w) f4 > -16, NaN = none, without patches of fewer than 100 pixels enclosed by jumps above one
    (paper 004, section 5.2.2)."""
    fixed = np.where(np.isfinite(disparity), (disparity + _SHIFT_PX) * _SUBPIXEL, 0).astype(np.int16)
    cv2.filterSpeckles(fixed, 0, 100, _SUBPIXEL)
    return np.where(fixed > 0, disparity, np.float32(np.nan))
