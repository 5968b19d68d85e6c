"""From an image file and its mask file to features: what one task of the features stage does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np

from tiegraph.errors import InputError, choose
from tiegraph.features.colmap import extract_colmap
from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.sift import extract_sift
from tiegraph.features.tuning import SiftTuning
from tiegraph.scene.images import read_pixels

Extractor = Callable[[np.ndarray, np.ndarray | None, FeaturesSettings, SiftTuning], tuple[np.ndarray, np.ndarray]]
EXTRACTORS: dict[str, Extractor] = {"opencv": extract_sift, "colmap": extract_colmap}


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
