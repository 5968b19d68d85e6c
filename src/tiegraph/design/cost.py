"""What matching costs of a run, by measured times and no clock, so that a survey is designed alike on any machine."""

from dataclasses import dataclass

import numpy as np

from tiegraph.design.tuning import CostTuning


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

    def little(self, tuning: CostTuning) -> bool:
        """Whether choosing would save next to nothing."""
        return self.share < tuning.little

    def said(self, tuning: CostTuning) -> str:
        """For people, if it is little."""
        return (
            f"all {self.pairs} pairs: to match them takes about {max(100 * self.share, 1):.0f} % of the run, and below "
            f"{100 * tuning.little:.0f} % no pair is worth saving"
        )


def cost(i: np.ndarray, j: np.ndarray, keypoints: np.ndarray, megapixels: np.ndarray, tuning: CostTuning) -> Cost:
    """Of pairs i, j (P,) of images with so many key points (N,) and pixels (N,)."""
    matching_s = tuning.pair_s * len(i) + tuning.product_s * float(np.sum(keypoints[i] * keypoints[j]))
    each_s = tuning.image_s + tuning.megapixel_s * np.minimum(megapixels, tuning.large_mpx)
    rest_s = tuning.start_s + float(np.sum(each_s))
    return Cost(len(i), matching_s, rest_s)


def predicted_keypoints(megapixels: np.ndarray, used: np.ndarray, most: np.ndarray, tuning: CostTuning) -> np.ndarray:
    """(N,) key points to expect at full resolution in images of so many megapixels (N,), of which a share (N,) is used:
    rather too many, and no more than ``most`` (N,)."""
    return np.minimum(tuning.keypoints_a_megapixel * megapixels * used, most)
