"""Images at a reduced size, the two frames of a camera that are compared, and operations on binary images.

Masks are bool, (h, w).
"""

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from tiegraph.errors import InputError
from tiegraph.masks.tuning import Tuning
from tiegraph.scene.atomic import regular
from tiegraph.scene.decoding import open_image

_log = logging.getLogger(__name__)


def image_size(path: Path) -> tuple[int, int]:
    """(height, width) of an image file from its header. Raises InputError if it cannot be read."""
    return _size(path, _bytes(path))


def read_small(path: Path, longer_px: int) -> np.ndarray:
    """(h, w, 3) u1 BGR, the longer side reduced to ``longer_px`` (never enlarged). Raises InputError if unreadable."""
    data = _bytes(path)
    size = _size(path, data)
    flags = next((flag for factor, flag in _REDUCED if max(size) >= factor * longer_px), cv2.IMREAD_COLOR)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise InputError(f"{path}: the image is broken; it was readable before: scan again")
    shape = small_shape(size, longer_px)
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


def two_frames(images: Sequence[Path], tuning: Tuning) -> tuple[np.ndarray, np.ndarray] | None:
    """Grey (h, w) u1 of the first and the last image of a camera (paper 001: "typically the first and the last").

    Images that cannot be read are skipped for the next one; the second is the last one of equal size that is not
    the same picture (a camera at rest). None, with a warning, if there are no two such images.
    """
    most = 12  # frames that are tried before a camera is given up
    found = next(read_frames(images[:most], tuning.work_px), None)
    if found is None:
        _log.warning("no image of this camera can be read: no mask from two frames")
        return None
    first, a = found[0], grey(found[1])
    for _, image in read_frames(images[: images.index(first) : -1][:most], tuning.work_px):
        b = grey(image)
        # Grey levels that differ less on average are one picture, not two
        if b.shape == a.shape and float(cv2.absdiff(a, b).mean()) >= 1.0:
            return a, b
    _log.warning("%s: no second, different image of this camera: no mask from two frames", first)
    return None


def full_size(mask: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """A mask (h, w) bool at another ``size`` = (height, width), nearest pixel."""
    if mask.shape == tuple(size):
        return mask
    return cv2.resize(mask.astype(np.uint8), (size[1], size[0]), interpolation=cv2.INTER_NEAREST) > 0


def opened_closed(white: np.ndarray, size_px: int) -> np.ndarray:
    """Opening, then closing, with a square of ``size_px``: small white areas go, then small black ones."""
    return closed(opened(white, size_px), size_px)


def without_small(white: np.ndarray, min_area: float) -> np.ndarray:
    """White areas (connected over edges and corners) of fewer than ``min_area`` pixels turned black."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(white.astype(np.uint8), connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= min_area
    large[0] = False  # label 0 is black
    return large[labels]


def block_share(white: np.ndarray, size_px: int) -> np.ndarray:
    """Share of white pixels in each block of ``size_px``, (ceil(h / size), ceil(w / size)) f8.

    Blocks at the right and at the bottom may be smaller.
    """
    height, width = white.shape
    rows, columns = np.arange(0, height, size_px), np.arange(0, width, size_px)
    counts = np.add.reduceat(np.add.reduceat(white.astype(np.int64), rows, axis=0), columns, axis=1)
    tall = np.diff(np.r_[rows, height])
    wide = np.diff(np.r_[columns, width])
    return counts / np.outer(tall, wide)


def from_blocks(blocks: np.ndarray, size_px: int, shape: tuple[int, int]) -> np.ndarray:
    """Blocks (r, c) spread to pixels ``shape`` = (h, w)."""
    return np.kron(blocks, np.ones((size_px, size_px), blocks.dtype))[: shape[0], : shape[1]]


def masked_neighbours(blocks: np.ndarray) -> np.ndarray:
    """Number of white blocks among the four beside each block, outside the image none, (r, c) i8."""
    padded = np.pad(blocks.astype(np.int8), 1)
    return padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]


def dilated(mask: np.ndarray, size_px: int) -> np.ndarray:
    """A mask (h, w) bool grown by half of ``size_px`` to each side."""
    return cv2.dilate(mask.astype(np.uint8), _square(size_px)) > 0


def eroded(mask: np.ndarray, size_px: int) -> np.ndarray:
    """A mask (h, w) bool shrunk by half of ``size_px`` at each side, but not at the border of the image."""
    return cv2.erode(mask.astype(np.uint8), _square(size_px)) > 0


def opened(mask: np.ndarray, size_px: int) -> np.ndarray:
    """A mask (h, w) bool without what is narrower than ``size_px``."""
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _square(size_px)) > 0


def closed(mask: np.ndarray, size_px: int) -> np.ndarray:
    """A mask (h, w) bool with its gaps narrower than ``size_px``."""
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, _square(size_px)) > 0


def _square(size_px: int) -> np.ndarray:
    return np.ones((size_px, size_px), np.uint8)
