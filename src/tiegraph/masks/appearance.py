"""What sky, water and the static scene look like in this survey: one table over colour, brightness and texture.

Learnt from seeds of the survey itself (Achar et al. 2011: self-supervised segmentation of river scenes), so it needs
no labels and no weights, and looking up a pixel costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

_LIGHT, _COLOUR, _TEXTURE = 16, 12, 5  # bins of L, of a and b each, of texture
_COLOUR_STEP = 5.0  # a and b: grey levels a bin, about neutral
_TEXTURE_EDGES = np.array([0.8, 2.0, 4.5, 10.0], np.float32)  # standard deviation of L, grey levels
_SMOOTH_BINS = (0.8, 0.7, 0.7, 0.6)
_SHARED_PX = 50_000  # about one image
_FLOOR = 1e-5  # probability of a bin no seed ever fell into
BINS = _LIGHT * _COLOUR * _COLOUR * _TEXTURE


def bins(image: np.ndarray) -> np.ndarray:
    """Bin (h, w) i4 of each pixel of an image (h, w, 3) u1 BGR."""
    light, a, b = cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2Lab))
    fine = light.astype(np.float32)
    mean = cv2.blur(fine, (5, 5))
    variance = cv2.blur(fine * fine, (5, 5)) - mean * mean
    texture = sum(variance > edge for edge in _TEXTURE_EDGES * _TEXTURE_EDGES)
    return _LIGHTS[light] + _STEPS[a] * _COLOUR + _STEPS[b] + texture


_STEPS = np.clip((np.arange(256) - 128) / _COLOUR_STEP + _COLOUR / 2, 0, _COLOUR - 1).astype(np.int32) * _TEXTURE
_LIGHTS = (np.arange(256) // (256 // _LIGHT) * _COLOUR * _COLOUR * _TEXTURE).astype(np.int32)


@dataclass(frozen=True)
class Appearance:
    """Log probability (BINS,) f4 of each bin for some classes."""

    table: dict[int, np.ndarray]

    def ratio(self, found: np.ndarray, label: int, other: int) -> np.ndarray:
        """Log of P(bin | label) / P(bin | other) for bins of any shape; 0 if either was not learnt."""
        if label not in self.table or other not in self.table:
            return np.zeros(found.shape, np.float32)
        return (self.table[label] - self.table[other])[found]


def learn(counts: dict[int, np.ndarray], shared: dict[int, np.ndarray] | None = None) -> Appearance:
    """From counts (BINS,) of seed pixels by class; classes without seeds are left out.

    ``shared``: counts of all cameras; they are as good as ``_SHARED_PX`` of a camera's own.
    """
    table = {}
    for label in counts:
        own, every = _share(counts[label]), None if shared is None else _share(shared[label])
        if own is None:
            own = every
        elif every is not None:
            weight = counts[label].sum() / (counts[label].sum() + _SHARED_PX)
            own = weight * own + (1 - weight) * every
        if own is not None:
            table[label] = np.log((1 - _FLOOR * BINS) * own + _FLOOR).astype(np.float32)
    return Appearance(table)


def _share(count: np.ndarray) -> np.ndarray | None:
    if count.sum() == 0:
        return None
    smooth = gaussian_filter(count.reshape(_LIGHT, _COLOUR, _COLOUR, _TEXTURE).astype(np.float64), _SMOOTH_BINS)
    return smooth.ravel() / smooth.sum()
