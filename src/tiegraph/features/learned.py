"""Features by a network in the user's ONNX file, with the inputs and outputs of the files that COLMAP publishes for
ALIKED (Zhao et al. 2023). COLMAP's wheels are built without ONNX Runtime, so it runs here.

Descriptors of a network have signs. They become bytes of SIFT's number and length, so that whatever stores and matches
SIFT serves them: the mean of each (one of 128 dimensions) is replaced by one that all share. The distance of two is
then that of the network times one number, and Lowe's ratio is the same.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.onnxfile import session

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
