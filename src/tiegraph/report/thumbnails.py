"""Pictures as data URIs: thumbnails of the images with their masks, PNG and JPEG encoding."""

import base64
from pathlib import Path

import cv2
import numpy as np
from markupsafe import Markup

from tiegraph.scene.decoding import read_pixels

_WIDTH_PX = 1400  # of a picture of a file
_IGNORED = "#d2283c"  # masked pixels
CLASSES = (  # by number, as in the masks stage: name, colour; pixels used by their class may be left out too
    ("used", _IGNORED),
    ("sky", "#2a78d6"),
    ("water", "#12a594"),
    ("platform", "#d2283c"),
    ("overexposed", "#e8b200"),
)


def png(rgb: np.ndarray) -> Markup:
    """An (H, W, 3) u1 picture, or one with alpha (H, W, 4), as a PNG data URI."""
    return _encoded(rgb, "png", [cv2.IMWRITE_PNG_COMPRESSION, 9])


def jpeg(rgb: np.ndarray) -> Markup:
    """An (H, W, 3) u1 picture as a JPEG data URI."""
    return _encoded(rgb, "jpeg", [cv2.IMWRITE_JPEG_QUALITY, 82])


def _encoded(rgb: np.ndarray, kind: str, options: list[int]) -> Markup:
    bgr = rgb[..., [2, 1, 0, 3][: rgb.shape[2]]]
    return _data_uri(cv2.imencode(f".{kind}", np.ascontiguousarray(bgr), options)[1].tobytes(), kind)


def _data_uri(data: bytes, kind: str) -> Markup:
    """Not escaped: it may look like a path."""
    return Markup(f"data:image/{kind};base64,{base64.b64encode(data).decode()}")


def rgb_of(colour: str) -> list[int]:
    """Red, green and blue of a colour such as #2a78d6."""
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


def file_uri(path: Path) -> Markup | None:
    """A picture file (PNG or JPEG) as a data URI, scaled down to a width of 1400; None if it cannot be read."""
    data = path.read_bytes() if path.exists() else b""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if image is None:
        return None
    kind = {".png": "png", ".jpg": "jpeg"}.get(path.suffix.lower())
    if image.shape[1] <= _WIDTH_PX and kind:
        return _data_uri(data, kind)
    return png(_shrunk(image, _WIDTH_PX)[..., ::-1])


def thumbnail(
    image: Path, mask: Path, classes: Path | None = None, width: int = 320
) -> tuple[Markup, float | None] | None:
    """The image with ignored areas in red, or in the colours of their ``classes``, and the share of usable pixels (None
    without a mask); None if it cannot be read."""
    picture = read_pixels(image, cv2.IMREAD_COLOR)
    if picture is None:
        return None
    picture = _shrunk(picture, width)[..., ::-1]
    use = read_pixels(mask)
    if use is None:
        return jpeg(picture), None
    labels = None if classes is None else read_pixels(classes)
    size = picture.shape[1::-1]
    small = cv2.resize(np.zeros_like(use) if labels is None else labels, size, interpolation=cv2.INTER_NEAREST)
    colours = np.array([rgb_of(colour) for _, colour in CLASSES])[np.minimum(small, len(CLASSES) - 1)]
    kept = cv2.resize(use, size, interpolation=cv2.INTER_NEAREST) > 0
    shown = np.where(kept[..., None], picture, (0.45 * picture + 0.55 * colours).astype(np.uint8))
    return jpeg(shown), float(np.mean(use > 0))


def mask_share(mask: Path) -> float | None:
    """Share of usable pixels of a mask file; None if it cannot be read."""
    use = read_pixels(mask, cv2.IMREAD_REDUCED_GRAYSCALE_2)
    return None if use is None else float(np.mean(use > 127))


def _shrunk(picture: np.ndarray, width: int) -> np.ndarray:
    if picture.shape[1] <= width:
        return picture
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
