"""Images that are hardly worth keeping: blurred against their neighbours, or the same picture as the one before."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks.frames import grey, read_small
from tiegraph.masks.morphology import eroded
from tiegraph.masks.platform import moved_share
from tiegraph.masks.tuning import QualityTuning, Tuning


@dataclass(frozen=True)
class Quality:
    """Figures of one image: ``sharpness`` is the share of the detail that is fine, ``moved`` the share of its texture
    that moved since the image before; NaN where there is nothing to measure."""

    sharpness: float
    moved: float


def image_quality(image: Path, before: Path | None, use: np.ndarray, tuning: Tuning) -> Quality:
    """Quality of an image, on the pixels (h, w) bool that its mask uses, at any size; ``before`` is its predecessor."""
    here = read_small(image, tuning.frames.work_px)
    keep = cv2.resize(use.astype(np.uint8), here.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
    sharp = _sharpness(grey(here), keep, tuning.quality)
    if before is None:
        return Quality(sharp, float("nan"))
    other = read_small(before, tuning.frames.compare_px)
    same = cv2.resize(here, other.shape[1::-1], interpolation=cv2.INTER_AREA)
    return Quality(sharp, moved_share(other, same, tuning.moved))


def _sharpness(brightness: np.ndarray, use: np.ndarray, tuning: QualityTuning) -> float:
    # Detail of one pixel against detail of four: blur takes the first away, darkness and haze take both.
    if use.mean() < tuning.min_used:
        return float("nan")
    fine = cv2.GaussianBlur(brightness.astype(np.float32), (0, 0), 0.7)  # the noise of pixels is taken out first
    medium, coarse = (cv2.GaussianBlur(fine, (0, 0), s) for s in (1.4, 5.6))
    inner = eroded(use, tuning.rim_px)
    if not inner.any():
        return float("nan")
    energy = float(np.mean(np.square(medium - coarse)[inner]))
    return float(np.sqrt(np.mean(np.square(fine - medium)[inner]) / energy)) if energy > 0 else float("nan")


def flags(quality: Sequence[Quality], tuning: QualityTuning) -> list[str]:
    """For the images of one camera in order: why an image is hardly worth keeping, with its figure; "" if it is."""
    sharp = np.array([q.sharpness for q in quality])
    found, reach = [], tuning.neighbours
    for k, own in enumerate(quality):
        around = np.delete(sharp[max(0, k - reach) : k + reach + 1], min(k, reach))
        around = around[np.isfinite(around)]
        relative = own.sharpness / np.median(around) if len(around) >= tuning.least_neighbours else float("nan")
        if relative < tuning.blurred:
            found.append(f"blurred: {relative:.2f} of its neighbours' sharpness")
        elif own.moved < tuning.similar:
            found.append(f"similar: {100 * own.moved:.0f} % of its texture moved since the image before")
        else:
            found.append("")
    return found
