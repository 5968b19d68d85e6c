"""From an image file and its mask file to features: what one task of the features stage does.

SIFT by COLMAP's own extractor (VLFeat, or on a GPU), one image at a time. Not ``pycolmap.extract_features``: that
leaves out images with a missing mask, reads a mask of another size as if it fitted, and numbers images by the order its
threads finish. One extractor call runs no worker threads, so its errors are plain exceptions and no child process is
needed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import pycolmap

from tiegraph.errors import InputError, choose
from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.sift import check_input, extract_sift, most_features, on_mask, shrunk
from tiegraph.features.tuning import SiftTuning
from tiegraph.gpu import device, on_gpu
from tiegraph.scene.decoding import read_pixels

Extractor = Callable[[np.ndarray, np.ndarray | None, FeaturesSettings, SiftTuning], tuple[np.ndarray, np.ndarray]]


def extract_image(
    image: Path, mask: Path | None, settings: FeaturesSettings, tuning: SiftTuning
) -> tuple[np.ndarray, np.ndarray]:
    """Keypoints (K, 4) f4 and descriptors (K, 128) u1 of an image file, none where the mask file is 0.

    Raises InputError for an image or mask that is missing, unreadable, or of different sizes.
    """
    extractor = cast(Extractor, choose("feature engine", settings.engine, EXTRACTORS))
    gray = read_gray(image)
    return extractor(gray, None if mask is None else read_mask(mask, gray.shape), settings, tuning)


def read_gray(image: Path) -> np.ndarray:
    """(H, W) u1 as stored in the file: an EXIF rotation is not applied, as COLMAP does not."""
    gray = read_pixels(image)
    if gray is None:
        raise InputError(f"image {image} cannot be read: take it out of the folder or restore it")
    return gray


def read_mask(mask: Path, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) bool, True = use (any value but 0). Raises InputError unless it is there, readable and of this shape."""
    if not mask.is_file():
        raise InputError(f"mask {mask} is missing: run the masks stage again, or set masks.source to none")
    values = read_pixels(mask)
    if values is None:
        raise InputError(f"mask {mask} cannot be read: it must be a PNG image, 0 = ignore")
    if values.shape != shape:
        sizes = f"{values.shape[1]}x{values.shape[0]}, its image {shape[1]}x{shape[0]}"
        raise InputError(f"mask {mask} is {sizes} pixels: make it the size of the image")
    return values > 0


# --- SIFT by COLMAP's own extractor ----------------------------------------------------------------------------------


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
        options = pycolmap.FeatureExtractionOptions(num_threads=1, use_gpu=on_gpu())
        options.sift.max_num_features = int(most_features(gray.size / 1e6, settings.max_features, tuning))
        options.sift.octave_resolution = tuning.octave_layers
        options.sift.peak_threshold = settings.contrast / tuning.octave_layers
        extractor = pycolmap.FeatureExtractor.create(options, device())
        points, descriptors = extractor.extract_from_uint8_array(np.ascontiguousarray(small))
    finally:
        pycolmap.logging.minloglevel = level
    keypoints = np.array([[p.x, p.y, p.compute_scale(), p.compute_orientation()] for p in points]).reshape(-1, 4)
    keypoints[:, :2] *= to_full
    keypoints[:, 2] *= np.sqrt(to_full.prod())
    inside = on_mask(keypoints, mask, tuning)
    return keypoints[inside].astype(np.float32), np.asarray(descriptors.data, np.uint8).reshape(-1, 128)[inside]


EXTRACTORS: dict[str, Extractor] = {"opencv": extract_sift, "colmap": extract_colmap}
