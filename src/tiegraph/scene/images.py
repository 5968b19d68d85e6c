"""Finding images, and a first reading of each of them."""

import hashlib
import os
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from tiegraph.errors import InputError
from tiegraph.scene.atomic import regular
from tiegraph.scene.decoding import (
    BEGINS,
    EIGHT_BIT,
    LARGEST_PX,
    RAW,
    Levels,
    Opened,
    Unreadable,
    eight_bit,
    levels_of,
    opened,
)
from tiegraph.scene.exif import Exif, read_exif, xmp_text
from tiegraph.scene.rig import Circle
from tiegraph.scene.wideviews import MIN_WIDTH_PX, Sphere, has_crop, image_circles, is_equirectangular, sphere_of

SUFFIXES = (".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".tif", ".tiff", ".bmp", ".webp", ".ppm", ".pgm", ".mpo", ".insp",
            ".jp2", ".j2k", ".avif", ".heic", ".heif", ".hif", *RAW, ".jxl", ".gif")  # fmt: skip
UNREADABLE = (".jxl", ".gif")  # found, and refused by name, so that they are not missed silently
# Formats of cameras only, which keep a JPEG beside or are exported as one
OF_CAMERAS = (".heic", ".heif", ".hif", *RAW)
VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".mts", ".webm", ".insv")
IMAGES_FOLDER = "images"
_IGNORED = ("thumbs.db", "desktop.ini", "__macosx")
# Folders of network storage and of systems, with thumbnails and deleted files.
_SERVICE = ("@eadir", "#recycle", "@recycle", "@recently-snapshot", "#snapshot", "$recycle.bin", "lost+found",
            "system volume information")  # fmt: skip
# A bound of memory: a JPEG of one colour has 85 pixels a byte with the standard's tables; a deflated one 1032 bytes of
# pixels a byte.
_BOMB_PX, _BOMB_PX_PER_BYTE = 100_000_000, 300


@dataclass(frozen=True)
class Probe:
    """The result of reading an image file. ``reason`` is not empty if the image cannot be used."""

    width: int = 0  # as stored in the file
    height: int = 0
    levels: Levels = EIGHT_BIT  # of a deeper file, see ``levels_of``
    exif: Exif = Exif()
    digest: str = ""  # of the file's bytes
    sphere: Sphere | None = None  # its part of a sphere, if it is an equirectangular panorama
    circles: tuple[Circle, ...] = ()  # image circles of fisheye lenses: one, or two side by side
    lenses: str = ""  # the calibration of the two lenses by Insta360's factory
    said: str = ""  # a note on the file
    reason: str = ""

    def upright_size(self) -> tuple[int, int]:
        """(width, height) after the rotation of the EXIF orientation."""
        return (self.height, self.width) if self.exif.orientation >= 5 else (self.width, self.height)


def search_images(root: Path) -> tuple[list[str], list[str]]:
    """The image files below a folder: their names (POSIX, relative to it, sorted), and notes on skipped files.

    Hidden files and folders, ``._*``, ``Thumbs.db`` and the like are skipped, as are the folders in which network
    storage keeps thumbnails and deleted files; these are counted. If ``root`` has a folder ``images``,
    only that is searched, so that masks and depth maps beside it are not read as photographs. Raises InputError if
    the folder does not exist, is empty, cannot be read in any part, or has no image.
    """
    root = Path(root)
    if not root.exists():
        raise InputError(f"{root}: there is no such folder; give the folder with the images")
    if not root.is_dir():
        raise InputError(f"{root} is a file; give the folder with the images")
    notes: list[str] = []
    files = list(files_below(searched(root), notes))
    images = [f for f in files if f.suffix.lower() in SUFFIXES]
    names = [f.relative_to(root).as_posix() for f in images]
    odd = [f for f in sorted(set(files) - set(images)) if _begins_like_an_image(f)]
    if odd:
        named = f"{odd[0].relative_to(root).as_posix()}{' ...' if len(odd) > 1 else ''}"
        notes.append(f"{len(odd)} files begin like images but have other names, and are skipped: {named}")
    if not names:
        found = f"{len(files)} files, none of them an image" if files else "an empty folder"
        raise InputError(f"{root}: {'; '.join([found, *notes])}; images end in {' '.join(SUFFIXES)}")
    return sorted(names), notes


def searched(root: Path) -> Path:
    """The folder that is searched for images: ``images`` below ``root`` if there is one, else ``root`` itself."""
    return root / IMAGES_FOLDER if (root / IMAGES_FOLDER).is_dir() else root


def find_videos(root: Path) -> list[Path]:
    """The videos below a folder, sorted; hidden ones are skipped. Or ``root`` alone, if it is one."""
    files = [root] if root.is_file() else files_below(root) if root.is_dir() else []
    return sorted(f for f in files if f.suffix.lower() in VIDEOS)


def find_images(root: Path) -> list[str]:
    """Only the names of ``search_images``."""
    return search_images(root)[0]


def files_below(folder: Path, notes: list[str] | None = None) -> Iterator[Path]:
    """The files below a folder, without hidden files and those of the system.

    Every folder is visited once, at its own place rather than through a link if it has both; ``notes`` lists skipped
    links to folders visited already, and those that lead up, out of the survey. Raises
    InputError for a folder that cannot be read.
    """
    said = notes if notes is not None else []
    top = Path(os.path.realpath(folder))
    visited: dict[tuple[int, int], Path] = {}
    service: list[Path] = []
    todo, links = [folder], deque[Path]()
    while todo or links:
        inside = todo.pop() if todo else links.popleft()
        info = inside.stat()
        first = visited.setdefault((info.st_dev, info.st_ino), inside)
        if first is not inside:
            said.append(f"{inside} leads to {first}, which is searched already: skipped")
            continue
        if inside is not folder and Path(os.path.realpath(inside)) in top.parents:
            said.append(f"{inside} leads up to {os.path.realpath(inside)}: skipped")
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
        said.append(f"{count} files in {len(service)} folders of the storage skipped, such as {service[0]}")


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return sorted(
                (e for e in entries if e.name[0] != "." and e.name.lower() not in _IGNORED), key=lambda e: e.name
            )
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be read ({error.strerror}): its images would be missing; make it readable or remove it"
        ) from None


def has_images(root: Path) -> bool:
    """Whether ``find_images`` finds any."""
    try:
        return bool(find_images(root))
    except InputError:
        return False


def _begins_like_an_image(path: Path) -> bool:
    try:
        with regular(path, None).open("rb") as file:
            return file.read(8).startswith(BEGINS)
    except OSError:
        return False


def probe_image(path: Path) -> Probe:
    """Read, decode and describe one image file; the pixels are not kept. Never raises: see ``Probe.reason``."""
    path = Path(path)
    try:
        # A file of the system with a size of 0 (/proc) may wait forever nevertheless.
        data = path.read_bytes() if regular(path).stat().st_size else b""
    except OSError as error:
        return Probe(reason=f"cannot be read: {error.strerror or error}")
    if not data:
        return Probe(reason="zero bytes")
    digest = hashlib.blake2b(data[_picture_at(data) :], digest_size=16).hexdigest()
    if path.suffix.lower() in UNREADABLE:
        return Probe(digest=digest, reason=f"{path.suffix} files are not read: convert to JPEG, PNG or TIFF")
    try:
        return _describe(data, path.suffix, digest)
    except Unreadable as error:
        return Probe(digest=digest, reason=str(error))
    except Exception as error:  # decoders raise OSError, SyntaxError, ValueError, struct.error and more
        word = "truncated" if "truncated" in str(error).lower() else "broken"
        return Probe(digest=digest, reason=str(Unreadable(f"{word}: {error}")))


def _picture_at(data: bytes) -> int:
    """Begin of the picture of a JPEG, behind its tags: files with one picture are one photograph. 0 for others."""
    at = 2 if data.startswith(b"\xff\xd8\xff") else len(data)
    while data[at : at + 1] == b"\xff" and data[at : at + 2] != b"\xff\xda":
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return at if data[at : at + 2] == b"\xff\xda" else 0


def _describe(data: bytes, suffix: str, digest: str) -> Probe:
    file = opened(data, suffix)
    image = file.image
    if image is not None and not file.raw:
        _refuse_bomb(image, len(data))
        image.load()
    levels, picture = EIGHT_BIT, image
    if picture is None or file.raw or file.deep:
        pixels = file.pixels()
        levels = levels_of(pixels)
        picture = Image.fromarray(eight_bit(pixels, levels))
    width, height = picture.size
    if min(width, height) < 32:
        raise Unreadable(f"only {width} x {height} pixels")
    circles = image_circles(picture)
    sphere = sphere_of(image, picture.size, lambda: np.asarray(picture.convert("RGB")))
    said = _said(file, sphere)
    if sphere is not None:
        sure = sphere.sure and sphere.width >= MIN_WIDTH_PX
        sphere = replace(sphere, sure=sure or (not circles and is_equirectangular(picture)))
    two = len(circles) > 1
    exif = Exif() if image is None else read_exif(image, (width, height))
    return Probe(
        width=width,
        height=height,
        levels=levels,
        exif=replace(exif, orientation=file.orientation),
        digest=digest,
        sphere=sphere,
        circles=circles,
        lenses=" ".join(found.group().decode() for form in _FACTORY if (found := form.search(data))) if two else "",
        said=said,
    )


def _said(file: Opened, sphere: Sphere | None) -> str:
    if file.image is None or file.raw:
        return ""
    if has_crop(xmp_text(file.image)) and not (sphere and sphere.sure):
        return "tags of a panorama (GPano) that contradict the file's size, or are of no sphere, are not used"
    count = getattr(file.image, "n_frames", 1)
    several = count > 1 and file.image.format != "MPO"  # whose pictures are of one instant
    return f"the first of {count} pictures in the file is used" if several else ""


_FACTORY = [re.compile(rb"2(?:_-?\d+(?:\.\d+)?){%d}(?![_.\d])" % count) for count in (39, 15)]  # its two forms


def _refuse_bomb(image: Image.Image, size: int) -> None:
    """A few kB that unpack to gigabytes are no photograph, but would end the process for lack of memory."""
    count = image.width * image.height
    said = f"its header announces {image.width} x {image.height} pixels"
    if count > LARGEST_PX:
        raise Unreadable(f"{said}: more than {LARGEST_PX // 10**6} Mpx are not read")
    if count > _BOMB_PX and count > _BOMB_PX_PER_BYTE * size:
        raise Unreadable(f"{said}, in a file of {size} bytes: that is no photograph")
