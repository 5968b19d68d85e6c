"""Mask source ``caption``: the lowest rows of an image are text that the camera has written, and are not used."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.sources import MaskSource, each, nothing
from tiegraph.masks.tuning import Tuning

SHARE = 0.06  # of the height


def look(image: Path, prepared: Any, settings: MasksSettings, tuning: Tuning, name: str) -> np.ndarray:
    """(H, W) bool, True = use."""
    pixels = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
    use = np.ones(pixels.shape, bool)
    use[round((1 - SHARE) * len(use)) :] = False
    return use


SOURCE = MaskSource(prepare=each(nothing), look=look)
