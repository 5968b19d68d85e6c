"""Small patches of disparity are errors (paper 004, section 5.2.2)."""

from __future__ import annotations

import cv2
import numpy as np

SPECKLE_PX = 100  # paper 004, section 5.2.2: patches below 100 pixels with jumps above 1 pixel are errors
_SUBPIXEL = 16  # steps of a pixel in 16 bits; the disparities of one image may span 2047 pixels


def without_speckles(disparity: np.ndarray, size: int = SPECKLE_PX) -> np.ndarray:
    """Disparity (h, w) f4 >= 0, NaN = none, without patches of fewer than ``size`` pixels enclosed by jumps of more
    than a pixel."""
    fixed = np.where(np.isfinite(disparity), disparity * _SUBPIXEL, -_SUBPIXEL).astype(np.int16)
    cv2.filterSpeckles(fixed, -_SUBPIXEL, size, _SUBPIXEL)
    return np.where(fixed < 0, np.float32(np.nan), disparity)
