"""Masks from a user's folder: finding the one of an image, reading it, and clear error messages."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from PIL import Image

from tiegraph.errors import InputError
from tiegraph.scene.atomic import regular
from tiegraph.scene.decoding import decode_deep, open_image
from tiegraph.scene.images import IMAGES_FOLDER
from tiegraph.scene.names import on_disk
from tiegraph.text import some

_TWO_LEVELS = ({0, 255}, {0, 1})


def candidates(name: str) -> list[str]:
    """Places of the mask of image ``name`` (POSIX) below the folder, best first.

    For up/cam0/a.jpg: up/cam0/a.jpg.png (COLMAP), up/cam0/a_mask.png, up/cam0/a.mask.png (openMVS), up/cam0/a.png, then
    one mask a camera: up/cam0.png, cam0.png, up.png. A leading images/ of the name may be omitted.
    """
    path = PurePosixPath(name)
    beside = (path.with_name(f"{path.stem}{end}") for end in ("_mask.png", ".mask.png", ".png"))
    found = [f"{path}.png", *map(str, beside)]
    folders = path.parts[:-1]
    found += [str(PurePosixPath(*folders[:k])) + ".png" for k in range(len(folders), 1, -1)]
    found += [f"{folder}.png" for folder in reversed(folders)]
    if folders and folders[0] == IMAGES_FOLDER:
        found += candidates(str(PurePosixPath(*path.parts[1:])))
    return list(dict.fromkeys(found))


def find_mask(folder: Path, name: str) -> Path | None:
    """The mask file of an image, None if there is none."""
    return next((path for c in candidates(name) if (path := on_disk(folder, c)) is not None), None)


def check_folder(folder: Path, names: Sequence[str]) -> None:
    """Raise InputError if the folder does not exist or lacks the mask of an image."""
    if not Path(folder).is_dir():
        raise InputError(f"{folder}: there is no such folder; masks.folder must be the folder of the masks")
    missing = [n for n in names if find_mask(folder, n) is None]
    if missing:
        raise _missing(folder, missing, len(names))


def read_folder_mask(
    folder: Path, name: str, size: tuple[int, int], keep_labels: Sequence[int] = ()
) -> np.ndarray:  # (H, W) bool, True = use
    """Mask of image ``name``, whose ``size`` is (height, width); ``keep_labels``: see ``read_mask_file``.

    Raises InputError naming the file if it is missing, unreadable, of another size, or no mask.
    """
    path = find_mask(folder, name)
    if path is None:
        raise _missing(folder, [name], 1)
    mask = read_mask_file(path, keep_labels)
    if mask.shape != tuple(size):
        raise InputError(
            f"{path}: the mask has {mask.shape[1]} x {mask.shape[0]} pixels, its image {name} has "
            f"{size[1]} x {size[0]} (after cropping, undistortion and EXIF rotation): "
            "make the mask in the size of the image"
        )
    return mask


def read_mask_file(path: Path, keep_labels: Sequence[int] = ()) -> np.ndarray:
    """(H, W) bool, True = use, of a mask of two levels, {0, 255} or {0, 1}; or of class labels, of which some are kept.

    Raises InputError if the file cannot be read, has colours, or other values.
    """
    values = _read_values(path, bool(keep_labels))
    found = np.unique(values)
    if keep_labels:
        if set(found.tolist()) == {0, 255} and not {0, 255} & set(keep_labels):
            raise InputError(f"{path}: this is a mask of 0 and 255, not class labels; omit masks.keep_labels")
        return np.isin(values, list(keep_labels))
    if not any(set(found.tolist()) <= levels for levels in _TWO_LEVELS):
        shown = ", ".join(str(v) for v in found[:6]) + (f", ... {found[-1]}" if len(found) > 6 else "")
        raise InputError(
            f"{path}: {len(found)} different values ({shown}); a mask has 0 = ignore and 255 (or 1) = use, saved "
            "without smoothing or JPEG compression. For class labels name those to use: masks.keep_labels"
        )
    return values > 0


def read_labels(path: Path) -> np.ndarray:
    """Class labels (H, W) u1 of a file. Raises InputError if it cannot be read as such."""
    values = _read_values(path, True)
    if values.max(initial=0) > 255:
        raise InputError(f"{path}: labels above 255")
    return values.astype(np.uint8)


def _read_values(path: Path, labels: bool) -> np.ndarray:
    try:
        data = regular(path).read_bytes()
        image = open_image(data)
        if image.mode.startswith("I"):  # 16 bits, which PIL does not convert
            values = decode_deep(data)
        else:
            values = _grey(image, labels, path)
    except InputError:
        raise
    except Exception as error:  # decoders raise OSError, SyntaxError, ValueError, struct.error and more
        raise InputError(f"{path}: this mask cannot be read ({error})") from None
    if values is None or values.ndim != 2:
        raise InputError(f"{path}: this mask cannot be read as a grey image")
    return values


def _grey(image: Image.Image, labels: bool, path: Path) -> np.ndarray:
    if image.mode == "P":  # label images keep their labels in the palette's indices, masks in its colours
        return np.asarray(image if labels else image.convert("RGB").convert("L"))
    if image.mode in ("1", "L"):
        return np.asarray(image.convert("L"))
    bands = np.asarray(image.convert("RGBA"))
    if (bands[..., 3] < 255).any():
        raise InputError(f"{path}: the mask is partly transparent; save it as a grey image, 0 = ignore, 255 = use")
    if (bands[..., :2] != bands[..., 1:3]).any():
        raise InputError(f"{path}: the mask has colours; save it as a grey image, 0 = ignore, 255 = use")
    return bands[..., 0]


def _missing(folder: Path, missing: Sequence[str], total: int) -> InputError:
    plain = PurePosixPath(missing[0]).with_suffix("")
    jpeg = [n for end in ("_mask.JPG", "_mask.jpg", ".jpg", ".JPG") if (folder / (n := f"{plain}{end}")).is_file()]
    lossy = f" {jpeg[0]} is there, but JPEG blurs the edges of masks: save PNG." if jpeg else ""
    return InputError(
        f"{folder}: no mask for {len(missing)} of {total} images: {some(missing, 5)}."
        f"{lossy} For {missing[0]} these were searched: {', '.join(candidates(missing[0]))}"
    )
