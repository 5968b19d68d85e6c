"""What in the pictures matches and what never does: features of neighbouring frames, before anything else is known.

A wall is found again in the next frame, water is not, however much texture it shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks.frames import grey, read_small

_LONGER_PX = 400
_MOST_FEATURES = 800
_RATIO = 0.75  # of the best and second best distance
_MIN_INLIERS = 20  # fewer: the two frames show different scenes, and nothing is said of either
_MIN_MOVE_PX = 2.0  # what does not move is the platform's
_EPIPOLAR_PX = 1.0
_SEED = 0


@dataclass(frozen=True)
class Evidence:
    """Features of one image: ``xy`` (K, 2) f4 in shares of width and height; ``matched`` (K,) in the other one."""

    image: Path
    xy: np.ndarray
    matched: np.ndarray


def pair_evidence(first: Path, second: Path) -> tuple[Evidence, ...]:
    """Which features of each of two images are found again in the other; () if too few are to say anything."""
    a, b = _features(first), _features(second)
    if a is None or b is None:
        return ()
    (xy_a, seen_a, shape_a), (xy_b, seen_b, shape_b) = a, b
    likeness = seen_a @ seen_b.T
    partner = likeness.argmax(axis=1)
    rows = np.arange(len(seen_a))
    best = 2 - 2 * likeness[rows, partner]
    mutual = likeness.argmax(axis=0)[partner] == rows
    likeness[rows, partner] = -1
    good = mutual & (best < _RATIO**2 * (2 - 2 * likeness.max(axis=1)))
    moved = np.linalg.norm(xy_a - xy_b[partner], axis=1) > _MIN_MOVE_PX
    chosen = np.flatnonzero(good & moved)
    if len(chosen) < _MIN_INLIERS:
        return ()
    found = chosen[_agreeing(xy_a[chosen], xy_b[partner[chosen]])]
    if len(found) < _MIN_INLIERS:
        return ()
    return _seen(first, xy_a, shape_a, found), _seen(second, xy_b, shape_b, partner[found])


def _agreeing(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which of the matches (K, 2) one epipolar geometry explains, (K,) bool."""
    cv2.setRNGSeed(_SEED)
    try:
        _, inliers = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, _EPIPOLAR_PX, 0.999, 1000)
    except cv2.error:  # where no geometry fits any sample, OpenCV 5 stops at an assertion of its own (model.empty())
        return np.zeros(len(a), bool)
    return np.zeros(len(a), bool) if inliers is None else inliers.ravel() > 0


def _seen(image: Path, xy: np.ndarray, shape: tuple[int, int], found: np.ndarray) -> Evidence:
    matched = np.zeros(len(xy), bool)
    matched[found] = True
    return Evidence(image, (xy / np.array(shape[::-1], np.float32)).astype(np.float32), matched)


def _features(path: Path) -> tuple[np.ndarray, np.ndarray, tuple[int, int]] | None:
    image = grey(read_small(path, _LONGER_PX))
    sift = cv2.SIFT_create(_MOST_FEATURES, contrastThreshold=0.02)  # type: ignore[attr-defined]
    points, seen = sift.detectAndCompute(image, None)
    if seen is None or len(seen) < _MIN_INLIERS:
        return None
    root = np.sqrt(seen / np.maximum(seen.sum(axis=1, keepdims=True), 1e-6))
    return np.array([p.pt for p in points], np.float32), root, (image.shape[0], image.shape[1])


def choose_pairs(cameras: Sequence[Sequence[Path]], most: int) -> list[list[tuple[Path, Path]]]:
    """Neighbouring images of each camera, spread over its sequence, ``most`` pairs for all cameras together."""
    each = max(2, most // max(1, len(cameras)))
    chosen = []
    for images in cameras:
        starts = np.unique(np.linspace(0, max(0, len(images) - 2), min(each, max(0, len(images) - 1))).astype(int))
        chosen.append([(images[k], images[k + 1]) for k in starts])
    return chosen
