"""Small patches of disparity are errors (paper 004, section 5.2.2)."""

import cv2
import numpy as np

_SUBPIXEL = 16  # steps of a pixel in 16 bits; the disparities of one image may span 2000 pixels
_SHIFT_PX = 16  # the sub-pixel part of a disparity of 0 may be negative


def without_speckles(disparity: np.ndarray, size_px: int, jump_px: float) -> np.ndarray:
    """Disparity (h, w) f4 > -16, NaN = none, without patches of fewer than ``size_px`` pixels enclosed by jumps of more
    than ``jump_px``."""
    fixed = np.where(np.isfinite(disparity), (disparity + _SHIFT_PX) * _SUBPIXEL, 0).astype(np.int16)
    cv2.filterSpeckles(fixed, 0, size_px, jump_px * _SUBPIXEL)
    return np.where(fixed > 0, disparity, np.float32(np.nan))
