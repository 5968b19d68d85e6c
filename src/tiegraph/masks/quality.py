"""Images that are hardly worth keeping: blurred compared with their neighbours, or the same as the one before."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks.frames import grey, read_small
from tiegraph.masks.morphology import eroded
from tiegraph.masks.platform import moved_share
from tiegraph.masks.tuning import QualityTuning, Tuning


def image_quality(image: Path, before: Path | None, use: np.ndarray, tuning: Tuning) -> tuple[float, float]:
    """Sharpness of an image, the share of its detail that is fine, and the share of its texture that moved since the
    one ``before``; on the pixels (h, w) bool that its mask uses, at any size. NaN where there is nothing to measure."""
    here = read_small(image, tuning.frames.work_px)
    keep = cv2.resize(use.astype(np.uint8), here.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
    sharp = _sharpness(grey(here), keep, tuning.quality)
    if before is None:
        return sharp, float("nan")
    other = read_small(before, tuning.frames.compare_px)
    same = cv2.resize(here, other.shape[1::-1], interpolation=cv2.INTER_AREA)
    return sharp, moved_share(other, same, tuning.moved)


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


def flags(quality: Sequence[tuple[float, float]], tuning: QualityTuning) -> list[str]:
    """By ``image_quality`` of the images of a camera in order: why one is hardly worth keeping, with its figure; "" if
    it is."""
    sharp = np.array([sharpness for sharpness, _ in quality])
    found, reach = [], tuning.neighbours
    for k, (sharpness, moved) in enumerate(quality):
        around = np.delete(sharp[max(0, k - reach) : k + reach + 1], min(k, reach))
        around = around[np.isfinite(around)]
        relative = sharpness / np.median(around) if len(around) >= tuning.least_neighbours else float("nan")
        if relative < tuning.blurred:
            found.append(f"blurred: {relative:.2f} of its neighbours' sharpness")
        elif moved < tuning.similar:
            found.append(f"similar: {100 * moved:.0f} % of its texture moved since the image before")
        else:
            found.append("")
    return found
