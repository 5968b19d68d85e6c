"""SIFT by COLMAP's own extractor (VLFeat), one image at a time.

Not ``pycolmap.extract_features``: that leaves out images with a missing mask, reads a mask of another size as if it
fitted, and numbers images by the order its threads finish. One extractor call runs no worker threads, so its errors are
plain exceptions and no child process is needed.
"""

from __future__ import annotations

import numpy as np
import pycolmap

from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.sift import check_input, on_mask, shrunk
from tiegraph.features.tuning import SiftTuning


def extract_colmap(
    gray: np.ndarray, mask: np.ndarray | None, settings: FeaturesSettings, tuning: SiftTuning
) -> tuple[np.ndarray, np.ndarray]:
    """As ``extract_sift``, by COLMAP: keypoints (K, 4) f4 (largest last) and descriptors (K, 128) u1.

    The limit of features counts before the mask is applied and without second orientations, as in COLMAP.
    """
    check_input(gray, mask)
    small = shrunk(gray, settings.max_image_size)
    to_full = np.array([gray.shape[1] / small.shape[1], gray.shape[0] / small.shape[0]])
    level, pycolmap.logging.minloglevel = pycolmap.logging.minloglevel, 1  # it announces each extractor
    try:
        extractor = pycolmap.FeatureExtractor.create(_options(settings, tuning), pycolmap.Device.cpu)
        points, descriptors = extractor.extract_from_uint8_array(np.ascontiguousarray(small))
    finally:
        pycolmap.logging.minloglevel = level
    keypoints = np.array([[p.x, p.y, p.compute_scale(), p.compute_orientation()] for p in points]).reshape(-1, 4)
    keypoints[:, :2] *= to_full
    keypoints[:, 2] *= np.sqrt(to_full.prod())
    inside = on_mask(keypoints, mask, tuning)
    return keypoints[inside].astype(np.float32), np.asarray(descriptors.data, np.uint8).reshape(-1, 128)[inside]


def _options(settings: FeaturesSettings, tuning: SiftTuning) -> pycolmap.FeatureExtractionOptions:
    options = pycolmap.FeatureExtractionOptions(num_threads=1, use_gpu=False)
    options.sift.max_num_features = settings.max_features
    options.sift.octave_resolution = tuning.octave_layers
    options.sift.peak_threshold = settings.contrast / tuning.octave_layers
    return options
