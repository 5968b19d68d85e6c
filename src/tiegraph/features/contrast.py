"""Images that show little contrast, of a sea floor, in a tunnel or at night: evened before features are looked for.

A detector's threshold is one number for all images (Lowe 2004: 0.03 of the grey range). In dim water nothing passes it
but what the lamp lights, though texture stands well above the noise everywhere. A lower threshold finds more in the
lit part alone: it is the contrast against the surroundings that counts.
"""

from __future__ import annotations

import cv2
import numpy as np

from tiegraph.features.tuning import ContrastTuning


def contrast(gray: np.ndarray, tuning: ContrastTuning) -> float:
    """What of its local contrast, grey levels, nine tenths of a grey image (H, W) u1 stay below: the standard deviation
    within blocks whose side is a share of the longer one."""
    side = max(round(max(gray.shape) * tuning.block), 2)
    size = (max(gray.shape[1] // side, 1), max(gray.shape[0] // side, 1))
    values = gray.astype(np.float32)
    mean, square = (cv2.resize(v, size, interpolation=cv2.INTER_AREA) for v in (values, values**2))
    return float(np.percentile(np.sqrt(np.maximum(square - mean**2, 0)), 90))


def evened(gray: np.ndarray, tuning: ContrastTuning, shown: float | None = None) -> np.ndarray:
    """The image, or one with its contrast evened tile by tile (Zuiderveld 1994, CLAHE) where it shows too little;
    ``shown``: its contrast, if that is known."""
    if (contrast(gray, tuning) if shown is None else shown) >= tuning.enough:
        return gray
    tiles = cv2.createCLAHE(clipLimit=tuning.limit, tileGridSize=(tuning.tiles, tuning.tiles))
    return np.asarray(tiles.apply(gray))
