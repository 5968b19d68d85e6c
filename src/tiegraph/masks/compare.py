"""Accuracy of masks: against masks made by hand or known to be true, per camera (paper 001, table 2)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from tiegraph.errors import InputError
from tiegraph.masks import NAMES
from tiegraph.masks.folder import find_mask, read_labels, read_mask_file

ALL = "all"
COLUMNS = ("camera", "images", "accuracy %", "IoU %", "useful lost %", "useless kept %")


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
        shares = [(r.accuracy, r.iou, r.useful_lost, r.useless_kept) for r in self.rows]
        return {
            "columns": list(COLUMNS),
            "rows": [[r.camera, r.images, *_percent(s)] for r, s in zip(self.rows, shares)],
        }


def compare(
    found: Path, truth: Path, cameras: Mapping[str, str] | None = None, keep_labels: Sequence[int] = ()
) -> MaskComparison:
    """Compare the masks of two folders, found by image name as in ``folder.candidates``.

    ``cameras``: image name -> camera; None takes the images ``found`` has masks <name>.png for, and their folder's name
    as camera. Images without a true mask are left out, and so are those of which a mask is missing, unreadable or of
    another size (``unfit``). ``keep_labels``: the useful labels if ``truth`` has class labels. Raises InputError if
    nothing can be compared.
    """
    names = _names(found) if cameras is None else dict(cameras)
    sums: dict[str, np.ndarray] = {}
    unfit: list[str] = []
    for name, camera in sorted(names.items()):
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
        none = f"{truth}: no true mask for any of {len(names)} images of {found}: are these the right folders?"
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


def compare_classes(
    found: Path, truth: Path, labels: Mapping[str, int], cameras: Mapping[str, str] | None = None
) -> ClassComparison:
    """Compare the classes <name>.png of a folder with labels, each class ``masks.NAMES`` with its true label.

    Images without labels are left out; classes are brought to the size of the labels. Raises InputError if a class is
    unknown or nothing can be compared.
    """
    unknown = [n for n in labels if n not in NAMES[1:]]
    if unknown:
        raise InputError(f"there is no class {unknown[0]!r}: the classes are {', '.join(NAMES[1:])}")
    sums: dict[str, np.ndarray] = {}
    for name, camera in sorted((_names(found) if cameras is None else dict(cameras)).items()):
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


def _names(found: Path) -> dict[str, str]:
    if not Path(found).is_dir():
        raise InputError(f"{found}: there is no such folder of masks")
    names = [p.relative_to(found).as_posix()[: -len(".png")] for p in Path(found).rglob("*.png")]
    return {n: PurePosixPath(n).parent.name or "camera" for n in names}


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
