"""COLMAP's files: models of any origin (a damaged one is an error, never a hang), ids in its database."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tiegraph.errors import InputError
from tiegraph.scene.names import check_text
from tiegraph.scene.regular import regular
from tiegraph.text import one_line

# COLMAP: pair_id = 2147483647 * smaller image_id + larger image_id (colmap/util/types.h, kMaxNumImages).
MAX_IMAGES = 2147483647
_POSE = 7 * 8  # a quaternion and a translation
_U32, _U64 = struct.Struct("<I"), struct.Struct("<Q")


def is_model(folder: Path) -> bool:
    """Whether a folder holds a COLMAP model, binary or text."""
    return any((folder / f"images.{kind}").exists() for kind in ("bin", "txt"))


def read_model(folder: Path | str) -> Any:
    """The ``pycolmap.Reconstruction`` of a model folder. Raises InputError naming what is damaged."""
    import pycolmap

    folder = Path(folder)
    for name, end_of in _RECORDS.items():
        _check(folder / f"{name}.bin", end_of)
        _check(folder / f"{name}.txt", None)
    try:
        model = pycolmap.Reconstruction(str(folder))
        for image in model.images.values():
            check_text(image.name, "image")  # read here: one that is not UTF-8 is an error of its own
    except Exception as error:
        raise InputError(f"{folder}: not a readable COLMAP model: {one_line(str(error))}") from None
    return model


def _check(path: Path, end_of: Callable[[bytes, int], int] | None) -> None:
    """Raise InputError for a file that is none, or whose records do not fill it.

    pycolmap believes the numbers in a file: in one that is cut off it reads on past the end for minutes, or asks for
    more memory than there is.
    """
    if not path.exists():
        return
    try:
        regular(path, None)
        data = path.read_bytes() if end_of else b""
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if end_of is None:
        return
    try:
        at = 8
        for _ in range(_U64.unpack_from(data)[0]):
            at = end_of(data, at)
    except (struct.error, LookupError, OverflowError, ValueError):  # past the end, no end of a name, no such camera
        raise InputError(f"{path}: the file is cut off or damaged; make the model again") from None
    if at != len(data):
        raise InputError(f"{path}: the file is cut off or damaged; make the model again")


# Each: the end of the record that begins at a place in a file (colmap/scene/reconstruction_io_binary.cc).


def _camera(data: bytes, at: int) -> int:
    model = struct.unpack_from("<i", data, at + 4)[0]
    return at + 24 + 8 * _parameters()[model]  # id, model, width, height


def _parameters() -> dict[int, int]:
    """Number of parameters of each camera model by its id."""
    import pycolmap

    if not _COUNTS:
        for value in pycolmap.CameraModelId.__members__.values():
            if int(value) >= 0:
                made = pycolmap.Camera.create_from_model_id(1, value, 1.0, 1, 1)
                _COUNTS[int(value)] = len(made.params)
    return _COUNTS


_COUNTS: dict[int, int] = {}


def _image(data: bytes, at: int) -> int:
    at = data.index(b"\0", at + 4 + _POSE + 4) + 1  # id, pose, camera id, name
    return at + 8 + 24 * _U64.unpack_from(data, at)[0]  # x, y, point id


def _point(data: bytes, at: int) -> int:
    return at + 51 + 8 * _U64.unpack_from(data, at + 43)[0]  # id, x, y, z, colour, error, length; image, index


def _rig(data: bytes, at: int) -> int:
    count = _U32.unpack_from(data, at + 4)[0]  # id, number of sensors
    at += 8
    for k in range(count):
        at += 8  # type, id
        if k > 0:  # the first is the reference
            at += 1 + _POSE * bool(data[at])
    return at


def _frame(data: bytes, at: int) -> int:
    return at + 12 + _POSE + 16 * _U32.unpack_from(data, at + 8 + _POSE)[0]  # id, rig, pose, count; sensor, image


_RECORDS = {"rigs": _rig, "cameras": _camera, "frames": _frame, "images": _image, "points3D": _point}
