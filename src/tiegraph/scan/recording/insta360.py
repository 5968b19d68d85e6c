"""The trailer that Insta360's cameras write behind an MP4: where their receiver, or that of the remote, was and when.

The file ends with 32 bytes, the length of the trailer, a version and 32 letters. Before them stand records, each
followed by its format, its kind and its length; between the records of newer cameras lie gaps, and record 0, the last,
says where each is. Record 7 has rows of 53 bytes: UTC since 1970 in seconds and milliseconds, A or V (acquired, void),
latitude with N or S, longitude with E or W (O in French), speed, course, height. As ExifTool (QuickTimeStream) and
telemetry-parser read it.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np

from tiegraph.scan.recording.fixes import Readings
from tiegraph.scene.regular import regular

_LETTERS = b"8db42d694ccc418790edff439fe026bf"
_FOOT, _HEAD = 72, 6
_INDEX, _GPS, _BINARY = 0, 7, 0
_MOST_RECORDS = 1000
_ROW = np.dtype(
    [("s", "<u8"), ("ms", "<u2"), ("state", "S1"), ("lat", "<f8"), ("ns", "S1"), ("lon", "<f8"), ("ew", "S1"),
     ("speed", "<f8"), ("course", "<f8"), ("height", "<f8")]
)  # fmt: skip
_ENTRY = np.dtype([("kind", "u1"), ("format", "u1"), ("size", "<u4"), ("offset", "<u4")])
_Places = dict[int, tuple[int, int]]  # first byte and length of a record by its kind


class BrokenTrailer(ValueError):
    """A trailer whose records do not lie in it; the text says which."""


def read_trailer(video: Path) -> Readings | None:
    """The receiver's readings, their stamps NaN; None of a file without such a trailer or record.

    Raises BrokenTrailer, and OSError of a file that cannot be read.
    """
    with regular(video, None).open("rb") as file:
        end = file.seek(0, 2)
        if end < _FOOT:
            return None
        file.seek(end - _FOOT)
        foot = file.read(_FOOT)
        if not foot.endswith(_LETTERS):
            return None
        length = int.from_bytes(foot[32:36], "little")
        if not _FOOT <= length <= end:
            raise BrokenTrailer(f"it says that it has {length} bytes, and the file has {end}")
        begin, size = _records(file, end - length, end).get(_GPS, (0, 0))
        if not size:
            return None
        file.seek(begin)
        rows = np.frombuffer(file.read(size - size % _ROW.itemsize), _ROW)
    return _readings(rows)


def _records(file: BinaryIO, begin: int, end: int) -> _Places:
    """Records between two places of a file: as the index says, or one by one from the end until a gap."""
    walked = _walk(file, begin, end)
    if _INDEX not in walked:
        return walked
    file.seek(walked[_INDEX][0])
    data = file.read(walked[_INDEX][1])
    found = dict(walked)
    for entry in np.frombuffer(data[: len(data) - len(data) % _ENTRY.itemsize], _ENTRY)[:_MOST_RECORDS]:
        kind, form, size, offset = (int(v) for v in entry)
        if form != _BINARY or not size:
            continue
        if begin + offset + size > end - _FOOT:
            raise BrokenTrailer(f"its index says record {kind} has {size} bytes at {offset}, which is outside of it")
        found[kind] = begin + offset, size
    return found


def _walk(file: BinaryIO, begin: int, end: int) -> _Places:
    found: _Places = {}
    at = end - _FOOT
    for _ in range(_MOST_RECORDS):
        if at - _HEAD < begin:
            break
        file.seek(at - _HEAD)
        form, kind, *size = file.read(_HEAD)
        length = int.from_bytes(bytes(size), "little")
        at -= _HEAD + length
        if at < begin:
            if not found:
                raise BrokenTrailer(f"its last record, {kind}, says {length} bytes, more than there are")
            break
        if form == _BINARY:
            found.setdefault(kind, (at, length))
    return found


def _readings(rows: np.ndarray) -> Readings:
    signs = [{b"N": 1.0, b"S": -1.0}, {b"E": 1.0, b"W": -1.0, b"O": -1.0}]
    lat, lon = (
        np.abs(rows[angle]) * np.array([sign.get(word, np.nan) for word in rows[letter].tolist()])
        for angle, letter, sign in (("lat", "ns", signs[0]), ("lon", "ew", signs[1]))
    )
    nothing = np.full(len(rows), np.nan)
    return Readings(
        stamp_s=nothing,
        time_s=rows["s"].astype(float) + rows["ms"] / 1000,
        lat_lon_height=np.stack([lat, lon, rows["height"].astype(float)], axis=1).reshape(-1, 3),
        fix=np.where(rows["state"] == b"A", 3.0, 0.0),
        dop=nothing,
    )
