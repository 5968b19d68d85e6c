"""Reading images for masks at a reduced size, and choosing the two frames of a camera that are compared."""

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from tiegraph.errors import InputError
from tiegraph.masks.tuning import FramesTuning
from tiegraph.scene.atomic import regular
from tiegraph.scene.decoding import open_image

_log = logging.getLogger(__name__)


def image_size(path: Path) -> tuple[int, int]:
    """(height, width) of an image file from its header. Raises InputError if it cannot be read."""
    return _size(path, _bytes(path))


def read_small(path: Path, longer_px: int) -> np.ndarray:
    """(h, w, 3) u1 BGR, the longer side reduced to ``longer_px`` (never enlarged). Raises InputError if unreadable."""
    data = _bytes(path)
    height, width = _size(path, data)
    longer = max(height, width)
    flags = cv2.IMREAD_COLOR
    for factor, reduced in _REDUCED:
        if longer >= factor * longer_px:
            flags = reduced
            break
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise InputError(f"{path}: the image is broken; it was readable before: scan again")
    shape = small_shape((height, width), longer_px)
    return image if image.shape[:2] == shape else cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA)


def read_frames(paths: Sequence[Path], longer_px: int) -> Iterator[tuple[Path, np.ndarray]]:
    """The readable images, reduced as by ``read_small``; the others are skipped with a warning."""
    for path in paths:
        try:
            yield path, read_small(path, longer_px)
        except InputError as error:
            _log.warning("%s", error)


def small_shape(size: tuple[int, int], longer_px: int) -> tuple[int, int]:
    """(h, w) of an image of ``size`` = (height, width) whose longer side is reduced to ``longer_px``."""
    scale = min(1.0, longer_px / max(size))
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


# The JPEG decoder skips unneeded resolution: large photographs are opened several times faster.
_REDUCED = ((8, cv2.IMREAD_REDUCED_COLOR_8), (4, cv2.IMREAD_REDUCED_COLOR_4), (2, cv2.IMREAD_REDUCED_COLOR_2))


def _bytes(path: Path) -> bytes:
    try:
        return regular(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def _size(path: Path, data: bytes) -> tuple[int, int]:
    try:
        image = open_image(data)
    except Exception as error:  # decoders raise OSError, SyntaxError, ValueError, struct.error and more
        raise InputError(f"{path}: not a readable image ({type(error).__name__})") from None
    return image.height, image.width


def grey(image: np.ndarray) -> np.ndarray:
    """(h, w) u1 of (h, w, 3) u1 BGR."""
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def full_size(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """A mask (h, w) bool made at reduced size, at ``size`` = (height, width) of the image."""
    if mask.shape == tuple(size):
        return mask
    return cv2.resize(mask.astype(np.uint8), (size[1], size[0]), interpolation=cv2.INTER_NEAREST) > 0


def two_frames(images: Sequence[Path], tuning: FramesTuning) -> tuple[np.ndarray, np.ndarray] | None:
    """Grey (h, w) u1 of the first and the last image of a camera (paper 001: "typically the first and the last").

    Images that cannot be read are skipped for the next one; the second is the last one of equal size that is not
    the same picture (a camera at rest). None, with a warning, if there are no two such images.
    """
    first = next(_readable(images, tuning), None)
    if first is None:
        _log.warning("no image of this camera can be read: no mask from two frames")
        return None
    place, a = first
    for _, b in _readable(images[:place:-1], tuning):
        # Grey levels that differ less on average are one picture, not two
        if b.shape == a.shape and float(cv2.absdiff(a, b).mean()) >= 1.0:
            return a, b
    _log.warning("%s: no second, different image of this camera: no mask from two frames", images[place])
    return None


def _readable(images: Sequence[Path], tuning: FramesTuning) -> Iterator[tuple[int, np.ndarray]]:
    for place, path in enumerate(images[:12]):  # frames skipped before a camera is given up
        try:
            yield place, grey(read_small(path, tuning.work_px))
        except InputError as error:
            _log.warning("%s", error)
