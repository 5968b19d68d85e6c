"""From a photograph to the image that the other stages read: a link, or rotated, cropped, undistorted, 8-bit."""

import os
import shutil
from copy import copy
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from PIL import Image

from tiegraph.errors import InputError
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.atomic import cached_by_file, real_path, regular, replacing
from tiegraph.scene.decoding import Levels, Opened, eight_bit, opened, turned
from tiegraph.scene.exif import Taken, exif_of, orientation_in
from tiegraph.scene.rig import Sensor, Source
from tiegraph.scene.wideviews import frozen, render_lens_view, render_view, sphere_of

# Formats that both OpenCV and COLMAP can read.
LINKED_FORMATS = {"JPEG": (".jpg", ".jpeg"), "MPO": (".jpg", ".jpeg"), "PNG": (".png",), "TIFF": (".tif", ".tiff"),
                  "BMP": (".bmp",)}  # fmt: skip
KEPT_SUFFIXES = tuple(s for suffixes in LINKED_FORMATS.values() for s in suffixes)


def prepare_image(source: Path, target: Path, sensor: Sensor, settings: ScanSettings) -> None:
    """Make ``target`` the image that ``sensor.camera`` describes: a link to ``source``, or its changed pixels.

    Grey and RGB of 8 bits stay unchanged; 16 bits, CMYK, palettes and EXIF-rotated images are converted. Transparent
    pixels stay transparent, for ``masks``.
    Written atomically. Raises InputError if the file can no longer be read.
    """
    source, target = real_path(source), Path(target)
    how = sensor.source or Source()
    pixels = _changed_pixels(source, how, sensor, settings, target.suffix.lower())
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
    try:
        file = opened(regular(path).read_bytes(), path.suffix)
        bend = settings.undistort and how.view is None and how.camera is not None and not how.camera.is_undistorted()
        changed = bend or how.view is not None or how.part is not None or any(how.crop_px)
        if not changed and _plain(file, suffix):
            return None
        pixels = _for_suffix(eight_bit(file.pixels(), how.levels), suffix)
    except OSError as error:
        raise _gone(path, error) from None
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


def _gone(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot be read ({error}); it was readable before: scan again")


def _cropped(pixels: np.ndarray, how: Source) -> np.ndarray:
    left, top, right, bottom = how.crop_px
    return pixels[top : pixels.shape[0] - bottom, left : pixels.shape[1] - right]


@cached_by_file(maxsize=1)  # its views are made one after another
def _panorama(path: Path, levels: Levels) -> np.ndarray:
    try:
        file = opened(regular(path).read_bytes(), path.suffix)
        pixels = eight_bit(file.pixels(), levels)
    except OSError as error:
        raise _gone(path, error) from None
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
