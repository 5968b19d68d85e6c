"""Corners of what is printed black on white, to hundredths of a pixel, by OpenCV."""

import cv2
import numpy as np

CENTRE = 0.5  # OpenCV counts pixels from the centre of the first one, COLMAP from its corner
_REFINED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 0.001)


def refined(pixels: np.ndarray, xy: np.ndarray, free_px: float, share: float, bounds_px: tuple[int, int]) -> np.ndarray:
    """Corners (K, 2) of an image (H, W) u1, OpenCV's pixels, each where all edges about it meet.

    About each so much (``free_px``) is free of other edges; half the window is a ``share`` of that, within bounds.
    """
    half = int(np.clip(round(share * free_px), *bounds_px))
    places = np.array(xy, np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(pixels, places, (half, half), (-1, -1), _REFINED).reshape(-1, 2)
