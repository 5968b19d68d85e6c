"""Sky and overexposure of one image, merged with its camera's initial mask (paper 001, section a, final stage)."""

from __future__ import annotations

import cv2
import numpy as np

from tiegraph.masks.frames import grey
from tiegraph.masks.morphology import block_share, from_blocks
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Meguro2025Tuning

_SOBEL_GAIN = 8.0  # response of the 3x3 Sobel kernels to a ramp of one grey level a pixel


def edge_sky(brightness: np.ndarray, min_step: float) -> np.ndarray:
    """Sky (h, w) bool of a grey image (h, w) u1: in each column from the top down to the first strong Sobel edge.

    A column without such an edge is sky to the bottom, as in an upward camera under the open sky.
    """
    x = cv2.Sobel(brightness, cv2.CV_32F, 1, 0, ksize=3)
    y = cv2.Sobel(brightness, cv2.CV_32F, 0, 1, ksize=3)
    edge = x * x + y * y >= (_SOBEL_GAIN * min_step) ** 2
    return ~np.logical_or.accumulate(edge, axis=0)


def blue_sky(image: np.ndarray, tuning: Meguro2025Tuning) -> np.ndarray:
    """Pixels (h, w) bool of an image (h, w, 3) u1 BGR in the range of sky blue; none in a grey image."""
    return cv2.inRange(cv2.cvtColor(image, cv2.COLOR_BGR2HSV), tuning.blue_low, tuning.blue_high) > 0


def final_mask(
    image: np.ndarray, initial: np.ndarray | None, settings: MasksSettings, tuning: Meguro2025Tuning
) -> np.ndarray:
    """Mask (h, w) bool, True = use, of an image (h, w, 3) u1 BGR. Paper 001, section a, final stage, in its order.

    ``initial``: the camera's mask (h, w) bool of the first stage, None = nothing masked yet.
    """
    brightness = grey(image)
    # "Based on the detected edge positions, the top of the image is assumed to be the sky and is masked".
    edges = edge_sky(brightness, settings.sky_edge)
    # "Pixels within the typical range of sky colors ... are extracted as a blue sky mask".
    blue = blue_sky(image, tuning)
    # "the two types of sky masks ... are combined and merged with the initial mask": both as unions. The intersection
    # of the two finds half of CamVid's grey skies only.
    masked = edges | blue
    if initial is not None:
        masked = masked | ~initial
    # "overexposed regions, are identified through grayscale conversion and thresholding. The regions are excluded".
    masked = masked | (brightness >= settings.overexposed)
    # "the image is divided into blocks once more, and a pixel ratio check is performed to smooth the mask".
    blocks = block_share(masked, tuning.block_px) >= tuning.min_block
    return ~from_blocks(blocks, tuning.block_px, masked.shape)
