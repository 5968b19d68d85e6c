"""Which photographs can be used, and the image of each for the other stages: a link, or rotated, cropped, undistorted,
8-bit."""

import os
import re
import shutil
from collections import Counter
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
import pycolmap
from PIL import Image

from tiegraph.errors import InputError
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.atomic import cached_by_file, real_path, regular, replacing
from tiegraph.scene.decoding import EIGHT_BIT, Levels, Opened, eight_bit, opened, turned
from tiegraph.scene.exif import Exif, Taken, exif_of, orientation_in
from tiegraph.scene.images import OF_CAMERAS, SUFFIXES, Probe
from tiegraph.scene.rig import Sensor, Source
from tiegraph.scene.scene import Dropped
from tiegraph.scene.wideviews import frozen, render_lens_view, render_view, sphere_of
from tiegraph.text import some

# Formats that both OpenCV and COLMAP can read.
LINKED_FORMATS = {"JPEG": (".jpg", ".jpeg"), "MPO": (".jpg", ".jpeg"), "PNG": (".png",), "TIFF": (".tif", ".tiff"),
                  "BMP": (".bmp",)}  # fmt: skip
KEPT_SUFFIXES = tuple(s for suffixes in LINKED_FORMATS.values() for s in suffixes)


class Report:
    """Notes and dropped images of scan, collected over its steps."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.dropped: list[Dropped] = []

    def drop(self, names: Iterable[str], reason: str) -> None:
        self.dropped += [Dropped(n, reason) for n in names]


@dataclass(frozen=True)
class Usable:
    """The usable images: their numbers, names and probes; parallel."""

    images: tuple[int, ...]
    names: tuple[str, ...]
    probes: tuple[Probe, ...]
    video: bool = False  # pictures of videos, each a sequence however short

    def layout(self, settings: ScanSettings) -> str:
        """The layout of the settings; for videos ``video``, if the settings give none."""
        return "video" if self.video and settings.layout == "auto" else settings.layout

    def facts(self) -> tuple[list[Exif], list[tuple[int, int]]]:
        """EXIF and upright sizes."""
        return [p.exif for p in self.probes], [p.upright_size() for p in self.probes]


def zoomed(probes: Sequence[Probe]) -> Sequence[Probe]:
    """Probes without EXIF focal lengths that include a digital zoom: where images that differ only in the zoom have one
    focal length, EXIF ignores it."""
    keys = [str((e.make, e.model, e.lens, e.focal_mm, e.focal_px)) for e in (p.exif for p in probes)]
    kinds: dict[str, set[float]] = {}
    for key, probe in zip(keys, probes):
        kinds.setdefault(key, set()).add(probe.exif.zoom)
    return [
        p if len(kinds[key]) == 1 else replace(p, exif=replace(p.exif, focal_px=p.exif.focal_px * p.exif.zoom))
        for key, p in zip(keys, probes)
    ]


def usable_images(names: Sequence[str], probes: Sequence[Probe], report: Report) -> Usable:
    """The images that can be read, each photograph once; the report gets the others. InputError with fewer than two."""
    first: dict[str, str] = {}
    usable, repeated, masks, depths = [], [], masks_among(names), depths_among(names, probes)
    if masks:
        report.notes.append(
            f"{len(masks)} files are masks of other images by their names, such as {min(masks)}: not used as images "
            "(--masks.folder with this folder uses them)"
        )
    if depths:
        report.notes.append(f"{len(depths)} files are depth maps by their names, such as {min(depths)}: not used")
    twins = _twins(names, probes)
    for k, (name, probe) in enumerate(zip(names, probes)):
        if name in masks or name in depths:  # no photographs: the notes say it
            continue
        if k in twins:
            report.drop([name], f"the same photograph as {names[twins[k]]} in another format")
        elif probe.reason:
            report.drop([name], probe.reason)
        elif (same := f"{probe.digest} {probe.exif.time_s}") in first:  # black frames of two instants are two
            report.drop([name], f"the same photograph as {first[same]}")
            repeated.append((name, first[same]))
        else:
            first[same] = name
            usable.append(k)
    for twin, kept in list(twins.items())[:1]:
        both = f"of {names[kept]} and {names[twin]} the first is used"
        report.notes.append(f"{len(twins)} photographs are here in two formats: {both}")
    report.notes += _say_repeated(repeated, names)
    told = Counter(d.reason for d in report.dropped if "pip install" in d.reason)
    told.update(probes[k].said for k in usable if probes[k].said)
    report.notes += [f"{count} images: {text}" for text, count in told.items()]
    need_two(len(usable), report)
    return Usable(tuple(usable), tuple(names[k] for k in usable), tuple(probes[k] for k in usable))


def masks_among(names: Sequence[str]) -> dict[str, str]:
    """The image of each mask that lies beside it: a.jpg.png (COLMAP), a_mask.png (OpenDroneMap, Metashape, openMVG),
    a.mask.png (openMVS), dynamic_mask_a.png (instant-ngp)."""
    images = {str(PurePosixPath(n).with_suffix("")): n for n in names} | {n: n for n in names}
    found: dict[str, str] = {}
    for path in map(PurePosixPath, names):
        of = re.fullmatch(r"(?:dynamic_mask_(.+)|(.+?)[_.]mask|(.+\.\w+))", path.stem, re.IGNORECASE)
        image = images.get(str(path.with_name(of[1] or of[2] or of[3])), "") if of else ""
        if image not in ("", str(path)):
            found[str(path)] = image
    return found


def depths_among(names: Sequence[str], probes: Sequence[Probe]) -> set[str]:
    """Files of an RGB-D camera that are depth maps: deeper than 8 bits and named so (depth/1.png, 1.depth.png)."""
    word = re.compile(r"(?:^|[/._-])(?:depth|depth_?maps?|disp|disparity)[/._-]", re.IGNORECASE)
    found = {n for n, p in zip(names, probes) if p.levels != EIGHT_BIT and word.search(n)}
    return found if len(found) < len(names) else set()


def _twins(names: Sequence[str], probes: Sequence[Probe]) -> dict[int, int]:
    """Files that are a photograph in another format (raw and JPEG, HEIC and its copy), and the file that is used."""
    found: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        found.setdefault(PurePosixPath(name).stem.lower(), []).append(k)
    out: dict[int, int] = {}
    for same in (same for same in found.values() if len({_suffix(names[k]) for k in same}) > 1):
        same.sort(key=lambda k: (bool(probes[k].reason), SUFFIXES.index(_suffix(names[k]))))
        for n, k in enumerate(same):
            kept = next((j for j in same[:n] if j not in out and _one_photograph(names, probes, j, k)), None)
            if kept is not None:
                out[k] = kept
    return out


def _suffix(name: str) -> str:
    return PurePosixPath(name).suffix.lower()


def _one_photograph(names: Sequence[str], probes: Sequence[Probe], one: int, other: int) -> bool:
    formats, exif = {_suffix(names[one]), _suffix(names[other])}, (probes[one].exif, probes[other].exif)
    if len(formats) == 1 or probes[one].reason:
        return False
    if PurePosixPath(names[one]).parent == PurePosixPath(names[other]).parent:
        return bool(formats & set(OF_CAMERAS)) or probes[one].upright_size() == probes[other].upright_size()
    return len({(e.time_s, e.make, e.model) for e in exif}) == 1 and bool(exif[0].make)


def _say_repeated(repeated: Sequence[tuple[str, str]], names: Sequence[str]) -> list[str]:
    """One note for every two folders of which one repeats files of the other: a copied pass."""
    heads = Counter(_heads(name, original) for name, original in repeated)
    out = []
    for (again, original), count in heads.items():
        total = sum(name.startswith(f"{again}/") for name in names) if again else len(names)
        said = f"{count} of {total} images"
        if again == original:
            out.append(f"folder {again or '.'}: {said} repeat others of it (identical files): left out")
        else:
            kind = "folder" if "/" in again + original else "pass"
            text = f"{kind} {again or '.'} repeats {kind} {original or '.'}: {said} are identical files"
            out.append(f"{text}; pairs between them have no base, so they are left out")
    return out


def _heads(name: str, other: str) -> tuple[str, str]:
    """The folders of two files without their common end: (B, A) for B/cam0/1.jpg and A/cam0/1.jpg."""
    mine, its = (PurePosixPath(n).parent.parts for n in (name, other))
    alike = 0 if mine == its else len(os.path.commonprefix([mine[::-1], its[::-1]]))
    return "/".join(mine[: len(mine) - alike]), "/".join(its[: len(its) - alike])


def need_two(count: int, report: Report) -> None:
    """Raise InputError, with what was left out, for fewer than two images."""
    if count < 2:
        reasons = dict.fromkeys(d.reason for d in report.dropped)
        named = [f"{some(d.name for d in report.dropped if d.reason == why)}: {why}" for why in reasons]
        why = "; ".join(named[:3])
        raise InputError(
            f"{count} usable image(s): at least 2 are needed, and about 10 for a model. "
            + (f"Left out {len(report.dropped)}: {why}" if why else "Give a folder with more images")
        )


def prepare_image(source: Path, target: Path, sensor: Sensor, settings: ScanSettings) -> None:
    """Make ``target`` the image that ``sensor.camera`` describes: a link to ``source``, or its changed pixels.

    Grey and RGB of 8 bits stay unchanged; 16 bits, CMYK, palettes and EXIF-rotated images are converted. Transparent
    pixels stay transparent, for ``masks``.
    Written atomically. Raises InputError if the file can no longer be read.
    """
    source, target = real_path(source), Path(target)
    how = sensor.source or Source()
    try:
        pixels = _changed_pixels(source, how, sensor, settings, target.suffix.lower())
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error}); it was readable before: scan again") from None
    with replacing(target) as partial:
        if pixels is None:
            _link(source, partial)
        else:
            write_pixels(partial, pixels)


def crop_camera(camera: pycolmap.Camera, left: int, top: int, right: int, bottom: int) -> pycolmap.Camera:
    """Camera of an image after cropping."""
    out = copy(camera)
    out.width, out.height = camera.width - left - right, camera.height - top - bottom
    out.principal_point_x, out.principal_point_y = camera.principal_point_x - left, camera.principal_point_y - top
    return out


def pinhole_camera(camera: pycolmap.Camera) -> pycolmap.Camera:
    """PINHOLE camera of the undistorted image, without blank pixels (as COLMAP's image_undistorter)."""
    out = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)
    out.has_prior_focal_length = camera.has_prior_focal_length
    return out


def _changed_pixels(
    path: Path, how: Source, sensor: Sensor, settings: ScanSettings, suffix: str
) -> np.ndarray | None:  # (H, W) or (H, W, 3) RGB u1; None = nothing to change
    if how.panorama and how.camera is not None:
        view = render_view(_panorama(path, how.levels), how.camera, np.reshape(how.panorama, (3, 3)))
        return _for_suffix(_cropped(view, how), suffix)
    file = opened(regular(path).read_bytes(), path.suffix)
    bend = settings.undistort and how.view is None and how.camera is not None and not how.camera.is_undistorted()
    changed = bend or how.view is not None or how.part is not None or any(how.crop_px)
    if not changed and _plain(file, suffix):
        return None
    pixels = _for_suffix(eight_bit(file.pixels(), how.levels), suffix)
    if how.upright:
        pixels = turned(pixels, file.orientation)
    # The image of this lens, of two side by side
    width = pixels.shape[1] // 2
    pixels = _cropped(pixels if how.part is None else pixels[:, how.part * width : (how.part + 1) * width], how)
    if how.view is not None and sensor.camera is not None:
        return render_lens_view(pixels, how.view, sensor.camera)
    if bend and how.camera is not None and sensor.camera is not None:
        x, y = _undistortion_map(frozen(crop_camera(how.camera, *how.crop_px)), frozen(sensor.camera))
        pixels = cv2.remap(pixels, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return pixels


def _for_suffix(pixels: np.ndarray, suffix: str) -> np.ndarray:
    return pixels[..., :3] if pixels.shape[2:] == (4,) and suffix not in (".png", ".tif", ".tiff") else pixels


def _cropped(pixels: np.ndarray, how: Source) -> np.ndarray:
    left, top, right, bottom = how.crop_px
    return pixels[top : pixels.shape[0] - bottom, left : pixels.shape[1] - right]


@cached_by_file(maxsize=1)  # its views are made one after another
def _panorama(path: Path, levels: Levels) -> np.ndarray:
    file = opened(regular(path).read_bytes(), path.suffix)
    pixels = eight_bit(file.pixels(), levels)
    sphere = sphere_of(file.image, pixels.shape[1::-1], lambda: pixels)
    return pixels if sphere is None else sphere.unfolded(pixels)


def _plain(file: Opened, suffix: str) -> bool:
    image = file.image
    if image is None or file.deep or orientation_in(image) != 1:
        return False
    kept = suffix in LINKED_FORMATS.get(image.format or "", ())
    return kept and image.mode in ("L", "RGB") and not image.has_transparency_data


@lru_cache(maxsize=1)  # images come sensor by sensor; one map of 6 Mpx takes 48 MiB
def _undistortion_map(camera: tuple, pinhole: tuple) -> tuple[np.ndarray, np.ndarray]:
    model, width, height, params = camera
    original = pycolmap.Camera(model=model, width=width, height=height, params=params)
    _, new_width, new_height, (fx, fy, cx, cy) = pinhole
    maps = np.empty((2, new_height, new_width), np.float32)
    u = (np.arange(new_width) + 0.5 - cx) / fx
    for row in range(new_height):
        rays = np.stack([u, np.full(new_width, (row + 0.5 - cy) / fy), np.ones(new_width)], axis=1)
        maps[:, row] = (np.asarray(original.img_from_cam(rays)) - 0.5).T  # OpenCV's first pixel has its centre at 0
    return maps[0], maps[1]


def _link(source: Path, target: Path) -> None:
    for make in (os.symlink, os.link, shutil.copyfile):
        try:
            make(source, target)
            return
        except (OSError, NotImplementedError):
            if make is shutil.copyfile:
                raise


def write_pixels(target: Path, pixels: np.ndarray, taken: Taken | None = None) -> None:
    """Write RGB or grey pixels (H, W[, 3]) u1 by the suffix; JPEG nearly without loss, with time and place as
    EXIF. Raises OSError (full disk)."""
    suffix = target.suffix.lower()
    how: dict[str, Any] = {} if taken is None else {"exif": exif_of(taken)}
    if suffix in (".jpg", ".jpeg"):
        how |= {"quality": 98, "subsampling": 0}
    Image.fromarray(np.ascontiguousarray(pixels)).save(target, **how)
