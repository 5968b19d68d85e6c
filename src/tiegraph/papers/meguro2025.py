"""Structural similarity of two images, and the initial mask of a camera from it (paper 001, section a, first stage)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks.frames import two_frames
from tiegraph.masks.morphology import block_share, from_blocks, masked_neighbours, without_small
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Meguro2025Tuning, Tuning

# Wang et al. 2004, section III, define it so: window of 11 pixels with sigma 1.5, K1 = 0.01, K2 = 0.03, grey levels
# L = 255.
_WINDOW_PX, _SIGMA_PX = 11, 1.5
_C1, _C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2

_MANY_NEIGHBOURS = 3  # "three or more adjacent blocks": paper 001 prints it


def ssim(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Structural similarity (h, w) f4 in -1..1 of two grey images (h, w) u1. Wang et al. 2004, equation 13."""
    x, y = a.astype(np.float32), b.astype(np.float32)

    def mean(image: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(image, (_WINDOW_PX, _WINDOW_PX), _SIGMA_PX, borderType=cv2.BORDER_REFLECT)

    mu_x, mu_y = mean(x), mean(y)
    var_x, var_y, cov = mean(x * x) - mu_x**2, mean(y * y) - mu_y**2, mean(x * y) - mu_x * mu_y
    luminance = (2 * mu_x * mu_y + _C1) / (mu_x**2 + mu_y**2 + _C1)
    return luminance * (2 * cov + _C2) / (var_x + var_y + _C2)


def initial_mask(a: np.ndarray, b: np.ndarray, similarity: float, tuning: Meguro2025Tuning) -> np.ndarray:
    """Mask (h, w) bool, True = use, of two grey images (h, w) u1 of one camera. Paper 001, section a, first stage."""
    # "Pixels with high similarity are considered outside the region of interest ... and are masked".
    masked = ssim(a, b) > similarity
    # "Blocks with a ratio of masked pixels below a certain threshold are excluded".
    blocks = block_share(masked, tuning.block_px) >= tuning.min_block
    # "a labeling process removes small isolated regions, such as noise, while retaining larger, contiguous regions".
    blocks = without_small(blocks, tuning.min_region_blocks)
    # "If three or more adjacent blocks are marked as "1" (i.e., masked), the central block is also set to "0"": read
    # as COLMAP's 0 (ignore), since "also" says that the block joins its neighbours. Unmasking it instead would hollow
    # out every region the step before retained. Adjacent = sharing a side: counted with corners, straight edges grow.
    blocks = blocks | (masked_neighbours(blocks) >= _MANY_NEIGHBOURS)
    return ~from_blocks(blocks, tuning.block_px, masked.shape)


def prepare_ssim(images: Sequence[Path], settings: MasksSettings, tuning: Tuning) -> np.ndarray | None:
    """The initial mask of a camera, (h, w) bool at reduced size; None if there are no two frames to compare."""
    frames = two_frames(images, tuning.frames)
    return None if frames is None else initial_mask(*frames, settings.similarity, tuning.meguro2025)
