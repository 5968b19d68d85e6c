"""Image files opened and decoded: by Pillow, with a plugin for HEIC; by OpenCV if Pillow hides more than 8 bits; raw
files of cameras by LibRaw. And the conversion of deeper pixels to 8 bits."""

import importlib
import io
import warnings
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageFile
from PIL.ExifTags import Base

from tiegraph.scene.exif import orientation_in

BEGINS = (b"\xff\xd8\xff", b"\x89PNG\r\n", b"II*\0", b"MM\0*")  # JPEG, PNG, TIFF and most raw formats
LARGEST_PX = 1_000_000_000  # bound of memory: PIL refuses more than 179 Mpx; survey cameras and mosaics go beyond
RAW = (".dng", ".gpr", ".cr2", ".cr3", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".srw", ".orf", ".rw2", ".raf", ".pef",
       ".iiq", ".3fr", ".fff", ".mrw", ".x3f", ".rwl")  # fmt: skip
_PLUGINS = ("pi_heif", "pillow_heif")
_BRANDS = {"HEIF": "heic heix hevc heim heis mif1 msf1", "AVIF": "avif avis"}  # of Pillow's formats
_MISSING = {
    "HEIF": "HEIC is read by pi-heif, which is missing: pip install 'tiegraph[heif]'",
    "AVIF": "AVIF is read by Pillow 11.3 and newer: pip install -U pillow",
}

Levels = tuple[float, float]
"""Values of a file that become 0 and 255."""
EIGHT_BIT: Levels = (0, 255)
_LEVELS_PERCENT, _LEVELS_PX = (0.1, 99.9), 1_000_000  # without hot pixels; a sample of this size is enough


class Unreadable(OSError):
    """Why an image file cannot be used."""


@dataclass(frozen=True)
class Opened:
    """An image file: its header as Pillow reads it, None if only OpenCV knows the format, and its bytes."""

    image: Image.Image | None
    data: bytes
    raw: bool = False

    @cached_property
    def orientation(self) -> int:
        """By EXIF, of the result of ``pixels``: TIFF and HEIC come upright."""
        upright = self.image is None or self.image.format in ("TIFF", "HEIF")
        return 1 if upright else orientation_in(self.image)

    @cached_property
    def deep(self) -> bool:
        """Whether Pillow does not show the stored pixel depth: 16 bits, floating point."""
        image = self.image
        if image is None or self.raw or image.mode in ("I", "F") or image.mode.startswith("I;"):
            return True
        if image.format == "TIFF":
            return max(image.tag_v2.get(258, (8,))) > 8  # type: ignore[attr-defined]
        samples = image.width * image.height * len(image.getbands())
        wide = image.format == "PPM" and len(self.data) >= 2 * samples
        # Pillow hides that a PNG of colours has 16 bits a channel.
        return wide or image.format == "JPEG2000" or (image.format == "PNG" and self.data[24:25] == b"\x10")

    def pixels(self) -> np.ndarray:
        """Grey (H, W), RGB, or, if parts are transparent, RGBA (H, W, 3 or 4), as deep as stored.

        Raises Unreadable, and the errors of decoders: OSError, SyntaxError, ValueError, struct.error and more.
        """
        if self.raw:
            return _developed(self.data)
        image = self.image
        found = decode_deep(self.data) if self.deep else None
        if found is None:
            if image is None:
                rare = "damaged, or of a rare kind: convert it to JPEG, PNG or TIFF of 8 or 16 bits"
                raise Unreadable(rare if self.data.startswith(BEGINS) else "not an image file")
            if image.has_transparency_data and not np.asarray(image.convert("RGBA"))[..., 3].all():
                return np.asarray(image.convert("RGBA"))
            if image.mode in ("I", "F") or image.mode.startswith("I;"):
                return np.asarray(image)
            return np.asarray(image.convert("L" if image.mode in ("1", "L", "LA") else "RGB"))
        if found.ndim == 2:
            return found
        if found.shape[2] < 3:
            return np.ascontiguousarray(found[..., 0])
        rgb = np.ascontiguousarray(found[..., 2::-1])
        return np.dstack([rgb, found[..., 3]]) if found.shape[2] == 4 and not found[..., 3].all() else rgb


def opened(data: bytes, suffix: str = "") -> Opened:
    """An image file by its bytes and the end of its name. Raises Unreadable if a library is missing or its header
    announces too many pixels, and the errors of Pillow for a broken header."""
    if suffix.lower() in RAW:
        return Opened(_header_of_raw(data), data, raw=True)
    try:
        return Opened(open_image(data), data)
    except Image.UnidentifiedImageError:
        brand = data[8:12].decode("latin-1") if data[4:8] == b"ftyp" else "none"
        kind = next((kind for kind, brands in _BRANDS.items() if brand in brands), "")
        if kind:
            raise Unreadable("truncated or damaged" if kind in Image.OPEN else _MISSING[kind]) from None
        return Opened(None, data)


def open_image(data: bytes) -> Image.Image:
    """PIL image of a file's bytes, not yet decoded; decoding will fail rather than fill in missing parts."""
    ImageFile.LOAD_TRUNCATED_IMAGES = False
    Image.MAX_IMAGE_PIXELS = LARGEST_PX
    _register()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Image.open(io.BytesIO(data))


@lru_cache(maxsize=1)
def _register() -> None:
    for module in _PLUGINS:
        with suppress(ImportError):
            return importlib.import_module(module).register_heif_opener()


def _header_of_raw(data: bytes) -> Image.Image | None:
    """An empty picture with the EXIF and XMP of a raw file: its own, as most are TIFF with another name, else that of
    the JPEG in it."""
    header = Image.new("1", (1, 1))
    try:
        header.getexif().load(b"II*\0" + data[4:] if data[:2] == b"II" else data)
        header.info["xmp"] = header.getexif().get(Base.XMLPacket, b"")
        return header
    except Exception:  # no TIFF; for a damaged one PIL raises anything from struct.error to SyntaxError
        pass
    try:
        import rawpy

        with rawpy.imread(io.BytesIO(data)) as raw:
            return open_image(bytes(raw.extract_thumb().data))
    except Exception:  # no JPEG in it, or an unknown one; a missing rawpy is reported when it is decoded
        return None


def _developed(data: bytes) -> np.ndarray:
    """(H, W, 3) u2 RGB of a raw file as the sensor lies, all with the same brightness."""
    try:
        import rawpy
    except ImportError:
        text = "raw files of cameras are read by rawpy, which is missing: pip install 'tiegraph[raw]'"
        raise Unreadable(text) from None
    try:
        with rawpy.imread(io.BytesIO(data)) as raw:
            return raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=16, user_flip=0)
    except rawpy.LibRawError:
        raise Unreadable("LibRaw cannot read this raw file: convert it to JPEG or TIFF") from None


def turned(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Pixels (H, W[, C]) upright, by their EXIF orientation."""
    # EXIF: the number gives the place of the file's first row and column in the upright picture.
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels


def decode_deep(data: bytes, flag: int = cv2.IMREAD_UNCHANGED) -> np.ndarray | None:
    """Pixels of a file as stored, with their depth, BGR, by OpenCV; None if it cannot."""
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION) if data else None
    except cv2.error:
        return None


def read_pixels(path: Path, flag: int = cv2.IMREAD_GRAYSCALE) -> np.ndarray | None:
    """Pixels (H, W) u1, or (H, W, 3) BGR with IMREAD_COLOR, as stored (an EXIF rotation is not applied); None if the
    file is not there or no image. OpenCV never sees the path: one that is not UTF-8 would end the process."""
    try:
        return decode_deep(Path(path).read_bytes(), flag)
    except OSError:
        return None


def opaque(path: Path) -> np.ndarray | None:
    """(H, W) bool: the opaque part of an image; None if it has no transparency by its header."""
    try:
        with Image.open(path) as image:
            return np.asarray(image.getchannel("A")) > 0 if image.mode == "RGBA" else None
    except (OSError, ValueError):
        return None


def levels_of(pixels: np.ndarray) -> Levels:
    """The range that nearly all pixels (H, W) or (H, W, C) of a file deeper than 8 bits use, without hot pixels:
    sensors of 10 to 14 bits and temperatures in hundredths of a kelvin fill a small part of the 16."""
    if pixels.dtype == np.uint8:
        return EIGHT_BIT
    step = max(1, int(np.sqrt(pixels.shape[0] * pixels.shape[1] / _LEVELS_PX)))
    some = pixels[::step, ::step, ..., :3] if pixels.ndim == 3 else pixels[::step, ::step]
    some = some[np.isfinite(some)]
    if not len(some):
        raise Unreadable("no pixel has a value")
    black, white = np.percentile(some, _LEVELS_PERCENT, method="nearest")
    least = 1 if some.dtype.kind in "iu" else np.spacing(abs(float(black)) + abs(float(white)))
    return float(black), float(max(white, black + least))


def eight_bit(pixels: np.ndarray, levels: Levels) -> np.ndarray:
    """Pixels (H, W[, 3 | 4]) with 8 bits: those of a deeper file by its camera's levels, clipped to them. Alpha 0
    stays 0, and all other values become 255."""
    if pixels.dtype == np.uint8:
        return pixels
    if pixels.shape[2:] == (4,):
        alpha = np.where(pixels[..., 3:] > 0, 255, 0).astype(np.uint8)
        return np.concatenate([eight_bit(pixels[..., :3], levels), alpha], axis=2)
    black, white = levels

    def scaled(values: np.ndarray) -> np.ndarray:
        return np.rint((np.clip(values, black, white) - black) * (255 / (white - black))).astype(np.uint8)

    return scaled(np.arange(65536.0))[pixels] if pixels.dtype == np.uint16 else scaled(np.nan_to_num(pixels, nan=black))
