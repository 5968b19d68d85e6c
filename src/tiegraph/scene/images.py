"""Finding images and opening each of them once; panoramas, how one is told from a photograph, and their views."""

import hashlib
import io
import os
import re
import warnings
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from PIL import Image, ImageFile

from tiegraph.errors import InputError
from tiegraph.scene.exif import Exif, read_exif
from tiegraph.scene.fisheye import image_circles
from tiegraph.scene.regular import regular
from tiegraph.scene.rig import Circle
from tiegraph.scene.tuning import ImageTuning, PanoramaTuning

SUFFIXES = (".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".tif", ".tiff", ".bmp", ".webp", ".ppm", ".pgm", ".mpo", ".insp")
# Photographs nobody here can decode: found, and refused by name, so that they are not missed silently.
UNREADABLE = (".heic", ".heif", ".avif", ".jxl", ".jp2", ".j2k", ".gif", ".dng", ".gpr", ".cr2", ".cr3", ".nef", ".nrw",
              ".arw", ".srf", ".sr2", ".srw", ".orf", ".rw2", ".raf", ".pef", ".iiq", ".3fr", ".fff", ".mrw", ".x3f",
              ".rwl")  # fmt: skip
IMAGES_FOLDER = "images"
_IGNORED = ("thumbs.db", "desktop.ini", "__macosx")
# Folders of network storage and of systems, with thumbnails and what was thrown away.
_SERVICE = ("@eadir", "#recycle", "@recycle", "@recently-snapshot", "#snapshot", "$recycle.bin", "lost+found",
            "system volume information")  # fmt: skip
_BEGINS = (b"\xff\xd8\xff", b"\x89PNG\r\n", b"II*\0", b"MM\0*")  # JPEG, PNG, TIFF and most raw formats
# Bounds of memory:
_LARGEST_PX = 1_000_000_000  # PIL refuses more than 179 Mpx as an attack; survey cameras and mosaics go beyond
# A JPEG of one colour has 85 pixels a byte with the standard's tables; a deflated one 1032 bytes of pixels a byte.
_BOMB_PX, _BOMB_PX_PER_BYTE = 100_000_000, 300


Levels = tuple[int, int]
"""Values of a file that become 0 and 255."""
EIGHT_BIT: Levels = (0, 255)
_LEVELS_PERCENT, _LEVELS_PX = (0.1, 99.9), 1_000_000  # a hot pixel is none of a thousand; so many pixels tell


@dataclass(frozen=True)
class Probe:
    """What one look at an image file found. ``reason`` is not empty if the image cannot be used."""

    width: int = 0  # as stored in the file
    height: int = 0
    levels: Levels = EIGHT_BIT  # of a deeper file, see ``levels_of``
    exif: Exif = Exif()
    digest: str = ""  # of the file's bytes
    panorama: bool = False  # equirectangular, the whole sphere
    circles: tuple[Circle, ...] = ()  # what fisheye lenses light of it: one, or two side by side
    lenses: str = ""  # what Insta360's factory says of the two lenses
    reason: str = ""

    def upright_size(self) -> tuple[int, int]:
        """(width, height) after the turn that the EXIF orientation asks for."""
        return (self.height, self.width) if self.exif.orientation >= 5 else (self.width, self.height)


def search_images(root: Path) -> tuple[list[str], list[str]]:
    """The image files below a folder: their names (POSIX, relative to it, sorted), and what was passed over and why.

    Hidden files and folders, ``._*``, ``Thumbs.db`` and the like are passed over, as are the folders that network
    storage keeps thumbnails and deleted files in; these are counted. If ``root`` has a folder ``images``
    only that is searched, so that masks and depth maps beside it are not taken for photographs. Raises InputError if
    the folder does not exist, is empty, cannot be read in any part, or has no image.
    """
    root = Path(root)
    if not root.exists():
        raise InputError(f"{root}: there is no such folder; give the folder that holds the images")
    if not root.is_dir():
        raise InputError(f"{root} is a file; give the folder that holds the images")
    notes: list[str] = []
    files = list(files_below(searched(root), notes))
    images = [f for f in files if f.suffix.lower() in SUFFIXES + UNREADABLE]
    names = [f.relative_to(root).as_posix() for f in images]
    odd = [f for f in sorted(set(files) - set(images)) if _begins_like_an_image(f)]
    if odd:
        named = f"{odd[0].relative_to(root).as_posix()}{' ...' if len(odd) > 1 else ''}"
        notes.append(f"{len(odd)} files begin like images but are not named so, and are passed over: {named}")
    if not names:
        found = f"{len(files)} files, none of them an image" if files else "an empty folder"
        raise InputError(f"{root}: {'; '.join([found, *notes])}; images end in {' '.join(SUFFIXES)}")
    return sorted(names), notes


def searched(root: Path) -> Path:
    """The folder that is searched for images: ``images`` below ``root`` if there is one, else ``root`` itself."""
    return root / IMAGES_FOLDER if (root / IMAGES_FOLDER).is_dir() else root


def find_images(root: Path) -> list[str]:
    """The names alone of ``search_images``, which see."""
    return search_images(root)[0]


def files_below(folder: Path, notes: list[str] | None = None) -> Iterator[Path]:
    """The files below a folder, without what hides or is the system's own.

    Every folder is visited once, at its own place rather than through a link if it has both; of links to folders
    visited already, and of those that lead up, out of the survey, ``notes`` takes what is passed over. Raises
    InputError for a folder that cannot be read.
    """
    said = notes if notes is not None else []
    top = Path(os.path.realpath(folder))
    visited: dict[tuple[int, int], Path] = {}
    service: list[Path] = []
    todo, links = [folder], deque[Path]()
    while todo or links:
        inside = todo.pop() if todo else links.popleft()
        first = visited.setdefault(_identity(inside), inside)
        if first is not inside:
            said.append(f"{inside} leads to {first}, which is searched already: passed over")
            continue
        if inside is not folder and Path(os.path.realpath(inside)) in top.parents:
            said.append(f"{inside} leads up to {os.path.realpath(inside)}: passed over")
            continue
        for entry in _entries(inside):
            path = inside / entry.name
            if not os.path.isdir(path):  # of a ring of links too
                yield path
            elif entry.name.lower() in _SERVICE:
                service.append(path)
            elif entry.is_symlink():
                links.append(path)
            else:
                todo.append(path)
    if service:
        count = sum(len(files) for folder in service for _, _, files in os.walk(folder))
        said.append(f"{count} files in {len(service)} folders of the storage passed over, such as {service[0]}")


def _identity(folder: Path) -> tuple[int, int]:
    info = folder.stat()
    return info.st_dev, info.st_ino


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return sorted(
                (e for e in entries if e.name[0] != "." and e.name.lower() not in _IGNORED), key=lambda e: e.name
            )
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be read ({error.strerror}): its images would be missing; make it readable or take it out"
        ) from None


def has_images(root: Path) -> bool:
    """Whether ``find_images`` finds any."""
    try:
        return bool(find_images(root))
    except InputError:
        return False


def _begins_like_an_image(path: Path) -> bool:
    try:
        if not path.is_file():  # a pipe would wait for ever
            return False
        with open(path, "rb") as file:
            return file.read(8).startswith(_BEGINS)
    except OSError:
        return False


def probe_image(path: Path, tuning: ImageTuning) -> Probe:
    """Read, decode and describe one image file; the pixels are let go again. Never raises: see ``Probe.reason``."""
    path = Path(path)
    try:
        # A file of the system that says it is empty (/proc) may wait for ever all the same.
        data = path.read_bytes() if regular(path).stat().st_size else b""
    except OSError as error:
        return Probe(reason=f"cannot be read: {error.strerror or error}")
    if not data:
        return Probe(reason="zero bytes")
    digest = hashlib.blake2b(data, digest_size=16).hexdigest()
    if path.suffix.lower() in UNREADABLE:
        return Probe(digest=digest, reason=f"{path.suffix} files are not read: convert to JPEG, PNG or TIFF")
    try:
        return _describe(data, digest, tuning)
    except _Unusable as error:
        return Probe(digest=digest, reason=str(error))


class _Unusable(Exception):
    pass


def _describe(data: bytes, digest: str, tuning: ImageTuning) -> Probe:
    try:
        image = open_image(data)
    except Image.UnidentifiedImageError:
        return _describe_array(data, digest)
    except Exception as error:
        raise _broken(error) from None
    _refuse_bomb(image, len(data))
    try:
        image.load()
    except Exception as error:  # decoders raise OSError, SyntaxError, ValueError, struct.error and more
        raise _broken(error) from None
    if min(image.size) < tuning.min_side_px:
        raise _Unusable(f"only {image.width} x {image.height} pixels")
    if image.mode == "F":
        raise _Unusable("floating-point pixels: convert to 8 or 16 bits")
    circles = image_circles(image, tuning.fisheye)
    return Probe(
        width=image.width,
        height=image.height,
        levels=_deep_levels(image, data),
        exif=read_exif(image, tuning.focal_range),
        digest=digest,
        panorama=not circles and is_equirectangular(image, tuning.panorama),
        circles=circles,
        lenses=_factory_lenses(data) if len(circles) > 1 else "",
    )


_FACTORY = [re.compile(rb"2(?:_-?\d+(?:\.\d+)?){%d}(?![_.\d])" % count) for count in (39, 15)]  # two forms of it


def _factory_lenses(data: bytes) -> str:
    """Strings of numbers, separated by blanks."""
    return " ".join(found.group().decode() for form in _FACTORY if (found := form.search(data)))


def _refuse_bomb(image: Image.Image, size: int) -> None:
    """A few kB that unpack to gigabytes are no photograph, but would end the process for lack of memory."""
    count = image.width * image.height
    said = f"its header says {image.width} x {image.height} pixels"
    if count > _LARGEST_PX:
        raise _Unusable(f"{said}: more than {_LARGEST_PX // 10**6} Mpx are not read")
    if count > _BOMB_PX and count > _BOMB_PX_PER_BYTE * size:
        raise _Unusable(f"{said}, in a file of {size} bytes: that is no photograph")


def _broken(error: Exception) -> _Unusable:
    word = "truncated" if "truncated" in str(error).lower() else "broken"
    return _Unusable(f"{word}: {error}")


def open_image(data: bytes) -> Image.Image:
    """PIL image of a file's bytes, not yet decoded; decoding will fail rather than fill in what is missing."""
    ImageFile.LOAD_TRUNCATED_IMAGES = False
    Image.MAX_IMAGE_PIXELS = _LARGEST_PX
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Image.open(io.BytesIO(data))


def deep_png(data: bytes) -> bool:
    """Whether a file is a PNG of 16 bits a channel (PIL hides that for colour images)."""
    return data[:8] == b"\x89PNG\r\n\x1a\n" and data[24:25] == b"\x10"


def decode_deep(data: bytes) -> np.ndarray | None:
    """Pixels of a file as stored, with their depth, by OpenCV; None if it cannot."""
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        return None


def read_pixels(path: Path, flag: int = cv2.IMREAD_GRAYSCALE) -> np.ndarray | None:
    """Pixels (H, W) u1, or (H, W, 3) BGR with IMREAD_COLOR, as stored (an EXIF rotation is not applied); None if the
    file is not there or no image. OpenCV never sees the path: one that is not UTF-8 would end the process."""
    try:
        data = Path(path).read_bytes()
        return cv2.imdecode(np.frombuffer(data, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION) if data else None
    except (OSError, cv2.error):
        return None


def opaque(path: Path) -> np.ndarray | None:
    """(H, W) bool: what of an image is not transparent; None if it has no transparency, which its header says."""
    try:
        with Image.open(path) as image:
            return np.asarray(image.getchannel("A")) > 0 if image.mode == "RGBA" else None
    except (OSError, ValueError):
        return None


def _deep_levels(image: Image.Image, data: bytes) -> Levels:
    if not image.mode.startswith("I") and not deep_png(data):
        return EIGHT_BIT
    pixels = decode_deep(data) if deep_png(data) else np.asarray(image)
    return levels_of(pixels if pixels is not None else np.asarray(image))


def levels_of(pixels: np.ndarray) -> Levels:
    """The range that nearly all pixels (H, W) or (H, W, C) of a file of 16 bits use, and no hot pixel tells: sensors of
    10 to 14 bits and temperatures in hundredths of a kelvin fill a small part of the 16."""
    if pixels.dtype == np.uint8:
        return EIGHT_BIT
    step = max(1, int(np.sqrt(pixels.shape[0] * pixels.shape[1] / _LEVELS_PX)))
    black, white = np.percentile(pixels[::step, ::step, ..., :3] if pixels.ndim == 3 else pixels[::step, ::step],
                                 _LEVELS_PERCENT, method="nearest")  # fmt: skip
    return int(black), max(int(white), int(black) + 1)


def eight_bit(pixels: np.ndarray, levels: Levels) -> np.ndarray:
    """Pixels with 8 bits: those of a deeper file by its camera's levels, with what lies beyond them cut off."""
    if pixels.dtype == np.uint8:
        return pixels
    black, white = levels
    table = np.clip(np.rint((np.arange(65536.0) - black) * (255 / (white - black))), 0, 255).astype(np.uint8)
    return table[pixels if pixels.dtype == np.uint16 else np.clip(pixels, 0, 65535)]


def _describe_array(data: bytes, digest: str) -> Probe:
    # Some 16-bit colour TIFF files are read by OpenCV only.
    pixels = decode_deep(data)
    if pixels is None:
        raise _Unusable("not an image file")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise _Unusable(f"{pixels.dtype} pixels: convert to 8 or 16 bits")
    height, width = pixels.shape[:2]
    return Probe(width=width, height=height, levels=levels_of(pixels), digest=digest)


def is_equirectangular(image: Image.Image, tuning: PanoramaTuning) -> bool:
    """Whether a decoded image is a full panorama: by its XMP (GPano), else by its poles and its seam.

    The first and the last row of an equirectangular panorama are one point each, and its left border goes on at the
    right one.
    """
    if image.width != 2 * image.height or image.width < tuning.min_width_px:
        return False
    xmp = image.info.get("xmp", b"")
    if b"equirectangular" in (xmp if isinstance(xmp, bytes) else str(xmp).encode()):
        return True
    size = tuning.look_px, tuning.look_px // 2
    grey = np.asarray(image.convert("L").resize(size, Image.Resampling.BOX), float)
    poles = max(grey[0].std(), grey[-1].std())
    borders = grey[:, : tuning.beside], grey[:, -tuning.beside :]
    beside = np.abs(np.diff(borders[0], axis=1)).mean() + np.abs(np.diff(borders[1], axis=1)).mean()
    seam = np.abs(grey[:, 0] - grey[:, -1]).mean()
    step = max(beside / 2, tuning.least_step_grey)
    return bool(poles < tuning.pole_grey and grey.std() > tuning.pole_grey and seam < tuning.seam * step)


def render_view(panorama: np.ndarray, camera: pycolmap.Camera, view_from_panorama: np.ndarray) -> np.ndarray:
    """Pixels (H, W[, 3]) of a pinhole view of a panorama (h, 2 h[, 3]), turned by a rotation (3, 3).

    The middle of the panorama is straight ahead (z), its upper border the zenith (-y).
    """
    fx, fy, cx, cy = camera.calibration_matrix()[[0, 1, 0, 1], [0, 1, 2, 2]]
    key = (tuple(np.ravel(view_from_panorama)), (fx, fy, cx, cy), (camera.width, camera.height))
    x, y = _map(key, panorama.shape[1], panorama.shape[0])
    return cv2.remap(panorama, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)


@lru_cache(maxsize=6)  # the views of one panorama are made one after another
def _map(key: tuple, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    rotation, (fx, fy, cx, cy), (columns, rows) = key
    u = (np.arange(columns) + 0.5 - cx) / fx
    v = (np.arange(rows) + 0.5 - cy) / fy
    rays = np.stack([*np.meshgrid(u, v), np.ones((rows, columns))], axis=-1) @ np.reshape(rotation, (3, 3))
    longitude = np.arctan2(rays[..., 0], rays[..., 2])
    latitude = np.arctan2(-rays[..., 1], np.hypot(rays[..., 0], rays[..., 2]))
    x = (longitude / (2 * np.pi) + 0.5) * width - 0.5  # OpenCV counts from the centre of the first pixel
    y = (0.5 - latitude / np.pi) * height - 0.5
    return x.astype(np.float32), y.astype(np.float32)
