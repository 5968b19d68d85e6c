"""COLMAP's files: models of any origin (a damaged one is an error, never a hang), ids in its database."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tiegraph.errors import InputError
from tiegraph.scene.names import check_text
from tiegraph.text import one_line

# COLMAP: pair_id = 2147483647 * smaller image_id + larger image_id (colmap/util/types.h, kMaxNumImages).
MAX_IMAGES = 2147483647
_RECORD_BYTES = {"cameras.bin": 24, "images.bin": 73, "points3D.bin": 51}  # least bytes of a record


def is_model(folder: Path) -> bool:
    """Whether a folder holds a COLMAP model, binary or text."""
    return any((folder / f"images.{kind}").exists() for kind in ("bin", "txt"))


def read_model(folder: Path) -> Any:
    """The ``pycolmap.Reconstruction`` of a model folder. Raises InputError naming what is damaged."""
    import pycolmap

    for name, smallest in _RECORD_BYTES.items():
        path = folder / name
        # pycolmap believes the count at the start of a file and goes on reading past its end for minutes
        if path.exists() and not _holds_its_count(path, smallest):
            raise InputError(f"{path}: the file is cut off; make the model again")
    try:
        model = pycolmap.Reconstruction(str(folder))
        for image in model.images.values():
            check_text(image.name, "image")  # read here: one that is not UTF-8 is an error of its own
    except Exception as error:
        raise InputError(f"{folder}: not a readable COLMAP model: {one_line(str(error))}") from None
    return model


def _holds_its_count(path: Path, smallest: int) -> bool:
    with open(path, "rb") as file:
        head = file.read(8)
    return len(head) == 8 and int.from_bytes(head, "little") * smallest <= path.stat().st_size - 8
