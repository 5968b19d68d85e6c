"""What matching costs of a run, by measured times and no clock, so that a survey is designed alike on any machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# CPU seconds of a core that matches 4096 key points with 4096 in 0.05 s; only ratios count. They give the runs in
# benchmarks/results (8 to 300 images; rendered, vehicle, facades, telephone) within a factor of two.
_PAIR_S, _PRODUCT_S = 0.004, 2.8e-9  # of a pair, and of each product of its key points
_START_S, _IMAGE_S, _MEGAPIXEL_S = 15.0, 1.2, 1.5  # everything else from scan to report: of a run, an image, its pixels
_LARGE_MPX = 2.0  # more pixels cost little more: stages that work by the pixel reduce the images
_DENSITY = 12000.0  # key points a megapixel of used area, on rich texture
LITTLE = 0.2  # of the run: what to match all candidates may cost before it is worth choosing among them


@dataclass(frozen=True)
class Cost:
    """CPU seconds that to match ``pairs`` pairs takes, and all the rest of a run from scan to report."""

    pairs: int
    matching_s: float
    rest_s: float

    @property
    def share(self) -> float:
        """Of the whole run."""
        return self.matching_s / (self.matching_s + self.rest_s)

    @property
    def little(self) -> bool:
        """Whether choosing would save next to nothing."""
        return self.share < LITTLE

    def said(self) -> str:
        """For people, if it is little."""
        return (
            f"all {self.pairs} pairs: to match them takes about {max(100 * self.share, 1):.0f} % of the run, and below "
            f"{100 * LITTLE:.0f} % no pair is worth saving"
        )


def cost(i: np.ndarray, j: np.ndarray, keypoints: np.ndarray, megapixels: np.ndarray) -> Cost:
    """Of pairs i, j (P,) of images with so many key points (N,) and pixels (N,)."""
    matching_s = _PAIR_S * len(i) + _PRODUCT_S * float(np.sum(keypoints[i] * keypoints[j]))
    rest_s = _START_S + float(np.sum(_IMAGE_S + _MEGAPIXEL_S * np.minimum(megapixels, _LARGE_MPX)))
    return Cost(len(i), matching_s, rest_s)


def foreseen_keypoints(megapixels: np.ndarray, used: np.ndarray, most: int) -> np.ndarray:
    """(N,) key points to expect at full resolution in images of so many megapixels (N,), of which a share (N,) is used:
    rather too many, and at ``most`` so many."""
    return np.minimum(_DENSITY * megapixels * used, most)
