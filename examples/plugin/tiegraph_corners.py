"""Features ``corners``: corners of Harris with upright SIFT descriptors of one size, for images of one scale."""

import cv2
import numpy as np

from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.sift import root_sift
from tiegraph.features.tuning import SiftTuning

SCALE = 4.0  # pixels, one sigma
APART = 3  # pixels between two corners
UNTIL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.01)


def extract(
    gray: np.ndarray, mask: np.ndarray | None, settings: FeaturesSettings, tuning: SiftTuning
) -> tuple[np.ndarray, np.ndarray]:
    """Keypoints (K, 4) f4: x, y (pixels from the image's corner), scale (pixels), orientation (radians), and
    descriptors (K, 128) u1, the clearest first."""
    use = None if mask is None else mask.astype(np.uint8)
    corners = cv2.goodFeaturesToTrack(gray, settings.max_features, 0.005, APART, mask=use, useHarrisDetector=True)
    if corners is None:
        return np.zeros((0, 4), np.float32), np.zeros((0, 128), np.uint8)
    places = cv2.cornerSubPix(gray, corners, (APART, APART), (-1, -1), UNTIL).reshape(-1, 2).tolist()
    found, descriptors = cv2.SIFT.create().compute(gray, [cv2.KeyPoint(x, y, 2 * SCALE, 0.0) for x, y in places])
    return np.array([(k.pt[0] + 0.5, k.pt[1] + 0.5, SCALE, 0.0) for k in found], np.float32), root_sift(descriptors)
