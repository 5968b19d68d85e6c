"""Operations on binary images. Masks are bool, (h, w)."""

import cv2
import numpy as np


def opened_closed(white: np.ndarray, size_px: int) -> np.ndarray:
    """Opening, then closing, with a square of ``size_px``: small white areas go, then small black ones."""
    return closed(opened(white, size_px), size_px)


def without_small(white: np.ndarray, min_area: float) -> np.ndarray:
    """White areas (connected over edges and corners) of fewer than ``min_area`` pixels turned black."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(white.astype(np.uint8), connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= min_area
    large[0] = False  # label 0 is black
    return large[labels]


def block_share(white: np.ndarray, size_px: int) -> np.ndarray:
    """Share of white pixels in each block of ``size_px``, (ceil(h / size), ceil(w / size)) f8.

    Blocks at the right and at the bottom may be smaller.
    """
    height, width = white.shape
    rows, columns = np.arange(0, height, size_px), np.arange(0, width, size_px)
    counts = np.add.reduceat(np.add.reduceat(white.astype(np.int64), rows, axis=0), columns, axis=1)
    tall = np.diff(np.r_[rows, height])
    wide = np.diff(np.r_[columns, width])
    return counts / np.outer(tall, wide)


def from_blocks(blocks: np.ndarray, size_px: int, shape: tuple[int, int]) -> np.ndarray:
    """Blocks (r, c) spread to pixels ``shape`` = (h, w)."""
    return np.kron(blocks, np.ones((size_px, size_px), blocks.dtype))[: shape[0], : shape[1]]


def masked_neighbours(blocks: np.ndarray) -> np.ndarray:
    """Number of white blocks among the four beside each block, outside the image none, (r, c) i8."""
    padded = np.pad(blocks.astype(np.int8), 1)
    return padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]


def scaled(mask: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A mask (h, w) bool at another ``shape``, nearest pixel."""
    if mask.shape == shape:
        return mask
    return cv2.resize(mask.astype(np.uint8), (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST) > 0


def dilated(mask: np.ndarray, size_px: int) -> np.ndarray:
    """A mask (h, w) bool grown by half of ``size_px`` to each side."""
    return cv2.dilate(mask.astype(np.uint8), _square(size_px)) > 0


def eroded(mask: np.ndarray, size_px: int) -> np.ndarray:
    """A mask (h, w) bool shrunk by half of ``size_px`` at each side, but not at the border of the image."""
    return cv2.erode(mask.astype(np.uint8), _square(size_px)) > 0


def opened(mask: np.ndarray, size_px: int) -> np.ndarray:
    """A mask (h, w) bool without what is narrower than ``size_px``."""
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _square(size_px)) > 0


def closed(mask: np.ndarray, size_px: int) -> np.ndarray:
    """A mask (h, w) bool with its gaps narrower than ``size_px``."""
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, _square(size_px)) > 0


def _square(size_px: int) -> np.ndarray:
    return np.ones((size_px, size_px), np.uint8)
