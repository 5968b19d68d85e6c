"""Masks from a user's folder: finding the one of an image, reading it, and clear error messages.

And how good masks are: against masks made by hand or known to be true, per camera (paper 001, table 2).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
from PIL import Image

from tiegraph.errors import InputError
from tiegraph.masks import NAMES
from tiegraph.scene.atomic import regular
from tiegraph.scene.decoding import decode_deep, open_image
from tiegraph.scene.images import IMAGES_FOLDER
from tiegraph.scene.names import on_disk
from tiegraph.text import some

ALL = "all"
COLUMNS = ("camera", "images", "accuracy %", "IoU %", "useful lost %", "useless kept %")


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
    if not any(set(found.tolist()) <= levels for levels in ({0, 255}, {0, 1})):
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


@dataclass(frozen=True)
class MaskRow:
    """Figures of one camera, or of all; shares 0..1 over all pixels of its images, NaN if there are none to count."""

    camera: str
    images: int
    accuracy: float  # pixels that are the same in both masks
    iou: float  # of the used area: used in both / used in either
    useful_lost: float  # of the truly useful pixels: masked
    useless_kept: float  # of the truly useless pixels: used


@dataclass(frozen=True)
class MaskComparison:
    """Rows per camera, sorted by name, the last for all of them together; why masks of images were skipped."""

    rows: tuple[MaskRow, ...]
    unfit: tuple[str, ...] = ()

    def table(self) -> dict:
        """{"columns": [...], "rows": [[...]]}, shares in percent with one decimal, None for NaN."""
        rows = [[camera, images, *_percent(shares)] for camera, images, *shares in map(astuple, self.rows)]
        return {"columns": list(COLUMNS), "rows": rows}


def compare(found: Path, truth: Path, cameras: Mapping[str, str], keep_labels: Sequence[int] = ()) -> MaskComparison:
    """Compare the masks of two folders, found by image name as in ``candidates``; ``cameras``: image name -> camera.

    Images without a true mask are left out, and so are those of which a mask is missing, unreadable or of another size
    (``unfit``). ``keep_labels``: the useful labels if ``truth`` has class labels. Raises InputError if nothing can be
    compared.
    """
    sums: dict[str, np.ndarray] = {}
    unfit: list[str] = []
    for name, camera in sorted(cameras.items()):
        true_path, path = find_mask(truth, name), find_mask(found, name)
        if true_path is None:
            continue
        try:
            if path is None:
                raise InputError(f"{found}: no mask for {name}, which has a true one ({true_path})")
            mask, true = read_mask_file(path), read_mask_file(true_path, keep_labels)
            if mask.shape != true.shape:
                sizes = [f"{m.shape[1]} x {m.shape[0]}" for m in (mask, true)]
                raise InputError(f"{path}: {sizes[0]} pixels, but {true_path} has {sizes[1]}")
            counts = [1, mask.size, *(np.count_nonzero(m) for m in (true, mask, mask & true))]
            sums[camera] = sums.get(camera, 0) + np.array(counts, np.int64)
        except InputError as error:
            unfit.append(str(error))
    if not sums:
        none = f"{truth}: no true mask for any of {len(cameras)} images of {found}: are these the right folders?"
        raise InputError(unfit[0] if unfit else none)
    rows = [_row(camera, sums[camera]) for camera in sorted(sums)]
    return MaskComparison((*rows, _row(ALL, np.sum(list(sums.values()), axis=0))), tuple(unfit))


@dataclass(frozen=True)
class ClassComparison:
    """Intersection over union (R, L) of the classes ``labels`` for the cameras ``rows``, the last for all; NaN where
    a class is in neither."""

    rows: tuple[str, ...]
    labels: tuple[str, ...]
    iou: np.ndarray

    def table(self) -> dict:
        """{"columns": [...], "rows": [[...]]}, shares in percent with one decimal, None for NaN."""
        heads = ["camera", *(f"{name} IoU %" for name in self.labels)]
        return {"columns": heads, "rows": [[camera, *_percent(own)] for camera, own in zip(self.rows, self.iou)]}


def compare_classes(found: Path, truth: Path, labels: Mapping[str, int], cameras: Mapping[str, str]) -> ClassComparison:
    """Compare the classes <name>.png of a folder with labels, each class ``masks.NAMES`` with its true label.

    Images without labels are left out; classes are brought to the size of the labels. Raises InputError if a class is
    unknown or nothing can be compared.
    """
    unknown = [n for n in labels if n not in NAMES[1:]]
    if unknown:
        raise InputError(f"there is no class {unknown[0]!r}: the classes are {', '.join(NAMES[1:])}")
    sums: dict[str, np.ndarray] = {}
    for name, camera in sorted(cameras.items()):
        path = find_mask(truth, name)
        if path is None or not (found / f"{name}.png").is_file():
            continue
        true, own = read_labels(path), read_labels(found / f"{name}.png")
        own = cv2.resize(own, true.shape[::-1], interpolation=cv2.INTER_NEAREST)
        pairs = [(own == NAMES.index(n), true == label) for n, label in labels.items()]
        counts = np.array([[np.count_nonzero(a & b), np.count_nonzero(a | b)] for a, b in pairs], np.int64)
        sums[camera] = sums.get(camera, 0) + counts
    if not sums:
        raise InputError(f"{truth}: no labels for any image that has classes in {found}")
    every = [*(sums[c] for c in sorted(sums)), np.sum(list(sums.values()), axis=0)]
    iou = np.array([[a / u if u else np.nan for a, u in counts] for counts in every])
    return ClassComparison((*sorted(sums), ALL), tuple(labels), iou)


def table_text(table: dict) -> str:
    """A table {"columns", "rows"} as aligned text."""
    lines = [list(table["columns"]), *(["-" if c is None else str(c) for c in row] for row in table["rows"])]
    wide = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    return "\n".join(
        "  ".join(c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(line, wide))) for line in lines
    )


def _row(camera: str, counts: np.ndarray) -> MaskRow:
    images, pixels, true, used, both = (int(c) for c in counts)
    neither = pixels - true - used + both
    return MaskRow(
        camera,
        images,
        accuracy=_share(both + neither, pixels),
        iou=_share(both, true + used - both),
        useful_lost=_share(true - both, true),
        useless_kept=_share(used - both, pixels - true),
    )


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def _percent(shares: Iterable[float]) -> list[float | None]:
    return [None if s != s else round(100 * float(s), 1) for s in shares]
