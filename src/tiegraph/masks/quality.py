"""Images that are hardly worth keeping: blurred against their neighbours, or the same picture as the one before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks.ego import moved_share
from tiegraph.masks.frames import grey, read_small

BLURRED = 0.5
"""An image is blurred if its sharpness is below this share of the median of its neighbours in the sequence."""
SIMILAR = 0.05
"""An image is similar if less than this share of its textured area moved since the one before."""
_NEIGHBOURS = 4  # to each side
_COMPARE_PX = 320
_EMPTY = 0.02  # share of the image that must be used for a figure


@dataclass(frozen=True)
class Quality:
    """Figures of one image: ``sharpness`` is the share of the detail that is fine, ``moved`` the share of its texture
    that moved since the image before; NaN where there is nothing to measure."""

    sharpness: float
    moved: float


def image_quality(image: Path, before: Path | None, use: np.ndarray) -> Quality:
    """Quality of an image, on the pixels (h, w) bool that its mask uses, at any size; ``before`` is its predecessor."""
    here = read_small(image)
    keep = cv2.resize(use.astype(np.uint8), here.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
    sharp = _sharpness(grey(here), keep)
    if before is None:
        return Quality(sharp, float("nan"))
    other = read_small(before, _COMPARE_PX)
    return Quality(sharp, moved_share(other, cv2.resize(here, other.shape[1::-1], interpolation=cv2.INTER_AREA)))


def _sharpness(brightness: np.ndarray, use: np.ndarray) -> float:
    # Detail of one pixel against detail of four: blur takes the first away, darkness and haze take both.
    if use.mean() < _EMPTY:
        return float("nan")
    fine = cv2.GaussianBlur(brightness.astype(np.float32), (0, 0), 0.7)
    medium, coarse = (cv2.GaussianBlur(fine, (0, 0), s) for s in (1.4, 5.6))
    inner = cv2.erode(use.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    if not inner.any():
        return float("nan")
    energy = float(np.mean(np.square(medium - coarse)[inner]))
    return float(np.sqrt(np.mean(np.square(fine - medium)[inner]) / energy)) if energy > 0 else float("nan")


def flags(quality: Sequence[Quality]) -> list[str]:
    """For the images of one camera in order: why an image is hardly worth keeping, with its figure; "" if it is."""
    sharp = np.array([q.sharpness for q in quality])
    found = []
    for k, own in enumerate(quality):
        around = np.delete(sharp[max(0, k - _NEIGHBOURS) : k + _NEIGHBOURS + 1], min(k, _NEIGHBOURS))
        around = around[np.isfinite(around)]
        relative = own.sharpness / np.median(around) if len(around) >= 2 else float("nan")
        if relative < BLURRED:
            found.append(f"blurred: {relative:.2f} of its neighbours' sharpness")
        elif own.moved < SIMILAR:
            found.append(f"similar: {100 * own.moved:.0f} % of its texture moved since the image before")
        else:
            found.append("")
    return found
