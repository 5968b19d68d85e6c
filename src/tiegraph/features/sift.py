"""From an image file and its mask file to SIFT features, one image at a time: by OpenCV, in the form of COLMAP's own
extractor (Lowe 2004; RootSIFT: Arandjelovic & Zisserman 2012).

Not ``pycolmap.extract_features``: that leaves out images with a missing mask, reads a mask of another size as if it
fitted, and numbers images by the order its threads finish.

Images with little contrast, of a sea floor, in a tunnel or at night, are equalised first. A detector's threshold is
one number for all images (Lowe 2004: 0.03 of the grey range). In dim water only the part lit by the lamp exceeds it,
though texture is well above the noise everywhere. A lower threshold finds more in the lit part only: the
contrast against the surroundings counts.

A network in the user's ONNX file has the inputs and outputs of those that COLMAP publishes for ALIKED (Zhao et al.
2023); it runs here, because COLMAP's wheels are built without ONNX Runtime. Its descriptors have signs. They become
bytes of SIFT's number and length, so that whatever stores and matches SIFT serves them: the mean of each (one of 128
dimensions) is replaced by one that all share. The distance of two is then that of the network times one number, and
Lowe's ratio is the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.errors import InputError
from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.tuning import ContrastTuning, SiftTuning, Tuning
from tiegraph.plugins import chosen
from tiegraph.scene.decoding import read_pixels
from tiegraph.scene.onnxfile import session

# COLMAP stores root-SIFT scaled by 512 in one byte (colmap/feature/utils.cc); its matcher counts on that length.
DESCRIPTOR_NORM = 512.0


def contrast(gray: np.ndarray, tuning: ContrastTuning) -> float:
    """Local contrast, grey levels, that nine tenths of a grey image (H, W) u1 do not exceed: the standard deviation
    within blocks whose side is a share of the longer one."""
    side = max(round(max(gray.shape) * tuning.block), 2)
    size = (max(gray.shape[1] // side, 1), max(gray.shape[0] // side, 1))
    step = max(side // 16, 1)  # 256 pixels tell the contrast of a block
    values = gray[::step, ::step].astype(np.float32)
    mean, square = (cv2.resize(v, size, interpolation=cv2.INTER_AREA) for v in (values, values**2))
    return float(np.percentile(np.sqrt(np.maximum(square - mean**2, 0)), 90))


def evened(gray: np.ndarray, tuning: ContrastTuning, shown: float | None = None) -> np.ndarray:
    """The image, or one with its contrast equalised tile by tile (Zuiderveld 1994, CLAHE) if it is too low;
    ``shown``: its contrast, if that is known."""
    if (contrast(gray, tuning) if shown is None else shown) >= tuning.enough:
        return gray
    return np.asarray(cv2.createCLAHE(clipLimit=tuning.limit).apply(gray))


def extract_sift(
    gray: np.ndarray, mask: np.ndarray | None, settings: FeaturesSettings, tuning: SiftTuning
) -> tuple[np.ndarray, np.ndarray]:
    """SIFT features of a grey image (H, W) u1; none are kept where ``mask`` (H, W) bool is False.

    Returns keypoints (K, 4) f4: x, y (pixels, corner convention), scale (pixels, one sigma), orientation (radians, from
    +x to +y), the clearest first, and descriptors (K, 128) u1. K = 0 is legal: a blank or masked image.

    The search begins at the image's own resolution. Only an image with too few features there is doubled like Lowe's:
    the content of a camera of many megapixels between its pixels is noise and sharpening, and it costs the most.
    """
    check_input(gray, mask)
    most = int(most_features(gray.size / 1e6, settings.max_features, tuning))
    image = shrunk(gray, settings.max_image_size)
    enough = tuning.enough_found * most
    if image.size >= enough * tuning.crowded_px:
        half = shrunk(image, max(image.shape) // 2)  # OpenCV doubles its input
        # The mean of four pixels has half their noise: a feature of half the contrast is as far above it.
        sift = _sift(settings.contrast / 2, tuning)
        found = sift.detect(half, None)
        keypoints, chosen = _clearest(found, half, gray, mask, tuning)
        if len(chosen) >= enough:
            chosen = chosen[:most]
            _, descriptors = sift.compute(half, [found[k] for k in chosen])
            return keypoints[chosen], root_sift(descriptors)
    # One call: computing only the descriptors of the kept ones would build the pyramid a second time.
    found, descriptors = _sift(settings.contrast, tuning).detectAndCompute(image, None)
    keypoints, chosen = _clearest(found, image, gray, mask, tuning)
    if not len(chosen):
        return np.zeros((0, 4), np.float32), np.zeros((0, 128), np.uint8)
    return keypoints[chosen[:most]], root_sift(descriptors[chosen[:most]])


def _sift(contrast: float, tuning: SiftTuning) -> cv2.SIFT:
    # Without the precise upscale OpenCV's key points lie 0.25 pixels too far right and down.
    return cv2.SIFT.create(
        nOctaveLayers=tuning.octave_layers,
        contrastThreshold=contrast,
        edgeThreshold=tuning.edges,
        enable_precise_upscale=True,
    )


def _clearest(
    found: Sequence[cv2.KeyPoint], image: np.ndarray, gray: np.ndarray, mask: np.ndarray | None, tuning: SiftTuning
) -> tuple[np.ndarray, np.ndarray]:
    """Key points (K, 4) f4 of the full image, of those found in a smaller one, and which of them are not masked,
    by their signal to noise, the clearest first.

    The noise of pixels, smoothed with a key point's scale, falls as that scale rises: response times scale is its
    signal to noise. In a drone's photographs the strongest by response alone were sharpening, and few were found
    again (benchmarks/README.md, *Key points*). Ties by place, so that OpenCV's threads cannot change the order.
    """
    scale = np.array([gray.shape[1] / image.shape[1], gray.shape[0] / image.shape[0]])
    out = np.array([[*k.pt, k.size, k.angle, k.response] for k in found]).reshape(-1, 5)
    out[:, :2] = (out[:, :2] + 0.5) * scale
    out[:, 2] *= np.sqrt(scale.prod()) / 2  # OpenCV's size is twice the sigma of the key point
    out[:, 3] = np.radians(out[:, 3])
    order = np.lexsort((out[:, 3], out[:, 0], out[:, 1], -out[:, 4] * out[:, 2]))
    return out[:, :4].astype(np.float32), order[on_mask(out[order, :3], mask, tuning)]


def most_features(megapixels: np.ndarray | float, limit: int, tuning: SiftTuning) -> np.ndarray:
    """Largest number of features of an image of so many megapixels, for a limit of large images; same shape."""
    return np.rint(limit * np.clip(megapixels / tuning.large_mpx, tuning.least_kept, 1))


def root_sift(descriptors: np.ndarray) -> np.ndarray:
    """Square root of L1-normalised SIFT (K, 128), times 512, one byte each: COLMAP's L1_ROOT."""
    descriptors = np.asarray(descriptors, np.float32)
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12)
    return np.clip(np.rint(DESCRIPTOR_NORM * np.sqrt(descriptors / total)), 0, 255).astype(np.uint8)


def check_input(gray: np.ndarray, mask: np.ndarray | None) -> None:
    """Raise ValueError unless the image is grey 8-bit and the mask a boolean array of its size."""
    if gray.ndim != 2 or gray.dtype != np.uint8:
        raise ValueError(f"SIFT needs a grey 8-bit image, got {gray.shape} {gray.dtype}")
    if mask is not None and (mask.shape != gray.shape or mask.dtype != bool):
        raise ValueError(f"mask {mask.shape} {mask.dtype} does not fit the image {gray.shape}")


def on_mask(keypoints: np.ndarray, mask: np.ndarray | None, tuning: SiftTuning) -> np.ndarray:
    """(K,) bool: which key points (K, 3 or more: x, y in corner convention, scale) have a free support.

    That is a circle of ``support_sigmas`` scales in which the mask (H, W) is True; where fewer than ``enough_free``
    have one, their pixels count. All are kept without a mask.
    """
    if mask is None:
        return np.ones(len(keypoints), bool)
    # The distance of a pixel's centre to that of the nearest masked pixel; the outside of the image does not matter.
    free = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    column, row = np.floor(keypoints[:, :2]).astype(int).T
    distance = free[np.clip(row, 0, mask.shape[0] - 1), np.clip(column, 0, mask.shape[1] - 1)]
    whole = np.asarray(distance > tuning.support_sigmas * keypoints[:, 2])
    return whole if whole.sum() >= tuning.enough_free else np.asarray(distance > 0)


def shrunk(gray: np.ndarray, max_image_size: int) -> np.ndarray:
    """The image, or a smaller one whose longer side is ``max_image_size``."""
    factor = max_image_size / max(gray.shape)
    if factor >= 1:
        return gray
    size = (max(1, round(gray.shape[1] * factor)), max(1, round(gray.shape[0] * factor)))
    return cv2.resize(gray, size, interpolation=cv2.INTER_AREA)


Extractor = Callable[[np.ndarray, np.ndarray | None, FeaturesSettings, SiftTuning], tuple[np.ndarray, np.ndarray]]


def extract_image(
    image: Path, mask: Path | None, settings: FeaturesSettings, tuning: Tuning
) -> tuple[np.ndarray, np.ndarray]:
    """Keypoints (K, 4) f4 and descriptors (K, 128) u1 of an image file, none where the mask file is 0. An image with
    little contrast is equalised first.

    Raises InputError for an image or mask that is missing, unreadable, or of different sizes.
    """
    extractor: Extractor = chosen("features", settings.engine, EXTRACTORS)
    gray = evened(read_gray(image), tuning.contrast)
    return extractor(gray, None if mask is None else read_mask(mask, gray.shape), settings, tuning.sift)


def read_gray(image: Path) -> np.ndarray:
    """(H, W) u1 as stored in the file: an EXIF rotation is not applied, as COLMAP does not."""
    gray = read_pixels(image)
    if gray is None:
        raise InputError(f"image {image} cannot be read: remove it from the folder or restore it")
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


# --- learned features ------------------------------------------------------------------------------------------------


def extract_onnx(
    gray: np.ndarray, mask: np.ndarray | None, settings: FeaturesSettings, tuning: SiftTuning
) -> tuple[np.ndarray, np.ndarray]:
    """As ``extract_sift``, by the network ``settings.model``: the scale is its pixel, the orientation 0."""
    check_input(gray, mask)
    assert settings.model is not None  # by the settings
    small = shrunk(gray, min(settings.max_image_size, tuning.network_px))
    to_full = np.array([gray.shape[1] / small.shape[1], gray.shape[0] / small.shape[0]])
    most = int(most_features(gray.size / 1e6, settings.max_features, tuning))
    xy, descriptors = detected(small, settings.model, most, tuning.least_score)
    keypoints = np.zeros((len(xy), 4), np.float32)
    keypoints[:, :2], keypoints[:, 2] = xy * to_full, np.sqrt(to_full.prod())
    inside = on_mask(keypoints, mask, tuning)
    return keypoints[inside], descriptors[inside]


EXTRACTORS: dict[str, Extractor] = {"opencv": extract_sift, "onnx": extract_onnx}


# ---------------------------------------------------------------- by a network


_INPUTS, _OUTPUTS = ("image", "max_keypoints", "min_score"), ("keypoints", "descriptors", "scores")
_STEP = 32  # pixels: the network reduces an image by it, so its sides are multiples
_COUNT, _NORM = 128, 512.0  # SIFT's bytes and their length
_SHARE = 128.0  # of that length, the part that distinguishes: more of it would leave the range of a byte


def network(model: Path) -> Any:
    """The network of a file. Raises InputError unless it has COLMAP's inputs and outputs, EngineMissing without ONNX
    Runtime."""
    found = session(model, "features.engine = onnx")
    for kind, has, wanted in (("inputs", found.get_inputs(), _INPUTS), ("outputs", found.get_outputs(), _OUTPUTS)):
        names = [value.name for value in has]
        if set(names) != set(wanted):
            raise InputError(
                f"{model}: its {kind} are {', '.join(names)}, but those of COLMAP's files for ALIKED are "
                f"{', '.join(wanted)}: give such a file as features.model"
            )
    return found


def detected(gray: np.ndarray, model: Path, most: int, min_score: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (K, 2) f4 in a grey image (H, W) u1 in corner convention, the clearest first, and descriptors (K, 128) u1.

    Raises InputError for a network that does not run on it or finds something else.
    """
    height, width = gray.shape
    padded = cv2.copyMakeBorder(gray, 0, -height % _STEP, 0, -width % _STEP, cv2.BORDER_REPLICATE)
    image = np.ascontiguousarray(np.broadcast_to(padded.astype(np.float32) / 255, (1, 3, *padded.shape)))
    given = (image, np.array(most, np.int64), np.array(min_score, np.float32))
    try:
        keypoints, descriptors, scores = (out[0] for out in network(model).run(_OUTPUTS, dict(zip(_INPUTS, given))))
        xy = (keypoints + 1) / 2 * (np.array(padded.shape[::-1]) - 1) + 0.5
        inside = np.flatnonzero((xy > 0).all(axis=1) & (xy < (width, height)).all(axis=1))
        order = inside[np.lexsort((*xy[inside].T, -scores[inside]))][:most]
        return xy[order].astype(np.float32), as_bytes(descriptors[order])
    except InputError:
        raise
    except Exception as error:  # ONNX Runtime raises classes of its own that share no base
        raise InputError(f"{model}: does not work as COLMAP's files for ALIKED do: {error}") from None


def as_bytes(descriptors: np.ndarray) -> np.ndarray:
    """Descriptors (K, D) f4 of a network as (K, 128) u1 of SIFT's length. Raises ValueError for D > 128."""
    missing = _COUNT - descriptors.shape[1]
    if missing < 0:
        raise ValueError(f"descriptors have {descriptors.shape[1]} numbers, more than the {_COUNT} of SIFT")
    full = np.pad(descriptors.astype(np.float64), ((0, 0), (0, missing)))
    full -= full.mean(axis=1, keepdims=True)
    full *= _SHARE / np.maximum(np.linalg.norm(full, axis=1, keepdims=True), 1e-12)
    full += np.sqrt((_NORM**2 - _SHARE**2) / _COUNT)
    # Sums are rounded, not numbers: with the mean of each kept, an error counts for the descriptor only
    whole = np.diff(np.rint(np.cumsum(full, axis=1)), axis=1, prepend=0)
    return np.clip(whole, 0, 255).astype(np.uint8)
