"""What sky, water and the static scene look like in this survey: one table over colour, brightness and texture.

Learnt from seeds of the survey itself (Achar et al. 2011: self-supervised segmentation of river scenes), so it needs
no labels and no weights, and looking up a pixel costs nothing.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from tiegraph.masks.tuning_learnt import AppearanceTuning


def bins(image: np.ndarray, tuning: AppearanceTuning) -> np.ndarray:
    """Bin (h, w) i4 of each pixel of an image (h, w, 3) u1 BGR."""
    lights, _, colours, textures = tuning.shape
    levels = np.arange(256)
    # Grey levels of a and b a bin
    steps = np.clip((levels - 128) / 5.0 + colours / 2, 0, colours - 1).astype(np.int32) * textures
    of_light = (levels * lights // 256 * colours * colours * textures).astype(np.int32)
    edges = np.array(tuning.texture_edges_grey, np.float32)
    light, a, b = cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2Lab))
    fine = light.astype(np.float32)
    around = (tuning.texture_px, tuning.texture_px)
    mean = cv2.blur(fine, around)
    variance = cv2.blur(fine * fine, around) - mean * mean
    texture = sum(variance > edge for edge in edges * edges)
    return of_light[light] + steps[a] * colours + steps[b] + texture


@dataclass(frozen=True)
class Appearance:
    """Log probability (bins,) f4 of each bin for some classes."""

    table: dict[int, np.ndarray]

    def ratio(self, found: np.ndarray, label: int, other: int) -> np.ndarray:
        """Log of P(bin | label) / P(bin | other) for bins of any shape; 0 if either was not learnt."""
        if label not in self.table or other not in self.table:
            return np.zeros(found.shape, np.float32)
        return (self.table[label] - self.table[other])[found]


def learn(
    counts: dict[int, np.ndarray], tuning: AppearanceTuning, shared: dict[int, np.ndarray] | None = None
) -> Appearance:
    """From counts (bins,) of seed pixels by class; classes without seeds are left out.

    ``shared``: counts of all cameras; they are as good as ``shared_px`` of a camera's own.
    """
    table = {}
    for label in counts:
        own, every = _share(counts[label], tuning), None if shared is None else _share(shared[label], tuning)
        if own is None:
            own = every
        elif every is not None:
            # Seeds of all cameras are as good as about one image of its own
            weight = counts[label].sum() / (counts[label].sum() + 50_000)
            own = weight * own + (1 - weight) * every
        if own is not None:
            table[label] = np.log((1 - tuning.floor * tuning.bins) * own + tuning.floor).astype(np.float32)
    return Appearance(table)


def _share(count: np.ndarray, tuning: AppearanceTuning) -> np.ndarray | None:
    if count.sum() == 0:
        return None
    # Bins of L, a, b and texture
    smooth = gaussian_filter(count.reshape(tuning.shape).astype(np.float64), (0.8, 0.7, 0.7, 0.6))
    return smooth.ravel() / smooth.sum()
