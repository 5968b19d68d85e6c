"""Pictures as data URIs: thumbnails of the images with their masks, PNG and JPEG encoding."""

import base64
from pathlib import Path

import cv2
import numpy as np
from markupsafe import Markup

from tiegraph.scene.decoding import read_pixels

_WIDTH_PX = 1400  # of a picture of a file
_IGNORED_BGR = (60, 40, 210)  # red: what the mask takes out
CLASSES = (  # by number, as the masks stage writes them: name, colour
    ("used", "#000000"),
    ("sky", "#2a78d6"),
    ("water", "#12a594"),
    ("platform", "#d2283c"),
    ("overexposed", "#e8b200"),
)


def data_uri(data: bytes, kind: str) -> Markup:
    """data: URI of an encoded picture; kind is png or jpeg. Not to be escaped: it may look like a path."""
    return Markup(f"data:image/{kind};base64,{base64.b64encode(data).decode()}")


def png(rgb: np.ndarray) -> str:
    """An (H, W, 3) u1 picture, or one with alpha (H, W, 4), as a PNG data URI."""
    return _encoded(rgb, ".png", [cv2.IMWRITE_PNG_COMPRESSION, 9])


def jpeg(rgb: np.ndarray) -> str:
    """An (H, W, 3) u1 picture as a JPEG data URI."""
    return _encoded(rgb, ".jpeg", [cv2.IMWRITE_JPEG_QUALITY, 82])


def _encoded(rgb: np.ndarray, suffix: str, options: list[int]) -> str:
    bgr = rgb[..., [2, 1, 0, 3][: rgb.shape[2]]]
    return data_uri(cv2.imencode(suffix, np.ascontiguousarray(bgr), options)[1].tobytes(), suffix[1:])


def rgb_of(colour: str) -> list[int]:
    """Red, green and blue of a colour such as #2a78d6."""
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


def file_uri(path: Path) -> str | None:
    """A picture file as a data URI, scaled down to a width of 1400; None if it cannot be read."""
    data = path.read_bytes() if path.exists() else b""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if image is None:
        return None
    if image.shape[1] <= _WIDTH_PX and path.suffix.lower() == ".png":
        return data_uri(data, "png")
    return png(_shrunk(image, _WIDTH_PX)[..., ::-1])


def thumbnail(
    image: Path, mask: Path, classes: Path | None = None, width: int = 320
) -> tuple[str, float | None] | None:
    """The image with ignored areas in red, or in the colours of their ``classes``, and the share of usable pixels (None
    without a mask); None if it cannot be read."""
    picture = read_pixels(image, cv2.IMREAD_COLOR)
    if picture is None:
        return None
    picture = _shrunk(picture, width)
    use = read_pixels(mask)
    if use is None:
        return jpeg(picture[..., ::-1]), None
    share = float(np.mean(use > 0))
    small = cv2.resize(use, picture.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
    colour = (0.45 * picture + 0.55 * _colours(classes, picture.shape)).astype(np.uint8)
    return jpeg(np.where(small[..., None], picture, colour)[..., ::-1]), share


def _colours(classes: Path | None, shape: tuple[int, ...]) -> np.ndarray:
    labels = None if classes is None else read_pixels(classes)
    if labels is None:
        return np.array(_IGNORED_BGR)
    table = np.array([rgb_of(c)[::-1] for _, c in CLASSES])
    table[0] = _IGNORED_BGR  # used by its class, but left out
    small = cv2.resize(labels, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    return table[np.minimum(small, len(table) - 1)]


def mask_share(mask: Path) -> float | None:
    """Share of usable pixels of a mask file; None if it cannot be read."""
    use = read_pixels(mask, cv2.IMREAD_REDUCED_GRAYSCALE_2)
    return None if use is None else float(np.mean(use > 127))


def _shrunk(picture: np.ndarray, width: int) -> np.ndarray:
    if picture.shape[1] <= width:
        return picture
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
