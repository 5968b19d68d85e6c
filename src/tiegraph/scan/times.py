"""When each frame was taken: from a table, from EXIF, or from numbers in the names that are times."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path, PurePosixPath

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.exif import Exif
from tiegraph.scene.gnss import IMAGE, TIME
from tiegraph.scene.table import in_seconds, read_table

_FRAME = ("frame", "frame_id", "frame_name", "shot")
_PASS = ("pass", "track", "run", "strip")
_UNIX_NAME = re.compile(r"(?:^|\D)(\d{10}(?:[._]\d{1,9})?|\d{13}|\d{16}|\d{19})$")
_DATE_NAME = re.compile(r"(?:^|\D)((?:19|20)\d{6})[_\-T ]?(\d{6})(\d{0,6})(?:\D|$)")
_UNIX_RANGE_S = (631152000.0, 4102444800.0)  # 1990 ... 2100: other numbers of ten digits are serial numbers


@dataclass(frozen=True)
class FrameRow:
    """One frame while the scene is built: its rig, pass (-1 = loose), label within the pass and image numbers."""

    rig: int
    track: int
    key: str
    images: tuple[int, ...]


def read_times(path: Path, frames: Sequence[FrameRow], tracks: Sequence[str], names: Sequence[str]) -> np.ndarray:
    """(F,) seconds from a table with the columns time and image, or time and frame and, with several passes, pass.

    An image is given by its name below the folder, or by its file name if no other has it. NaN for frames not listed.
    Raises InputError for missing columns, times that are none, and when no row fits a frame.
    """
    table = read_table(path, "times file")
    time, image, frame, track = (table.find(c) for c in (TIME, IMAGE, _FRAME, _PASS))
    if time is None or (image is None and frame is None):
        raise InputError(
            f"{path}: found the columns {', '.join(table.columns)}; expected time and image, or pass, frame and time"
        )
    if image is None and track is None and len(tracks) > 1:
        raise InputError(f"{path}: a frame's name is not unique over {len(tracks)} passes: add a column pass")
    seconds = table.times(time)
    if np.isnan(seconds).any():
        row = int(np.flatnonzero(np.isnan(seconds))[0])
        raise InputError(
            f"{path}, line {table.rows[row][0]}: {table.cell(row, time)!r} is no time (seconds or ISO 8601)"
        )
    lookup = _by_image(frames, names) if image is not None else _by_frame(frames, tracks)
    out = np.full(len(frames), np.nan)
    for row in range(len(table.rows)):
        if image is not None:
            found = lookup.get((table.cell(row, image),))
        else:
            name = tracks[0] if len(tracks) == 1 else table.cell(row, track)
            found = lookup.get((name, _plain(table.cell(row, frame))))
        if found is not None:
            out[found] = seconds[row]
    if np.isnan(out).all() and len(frames):
        example = names[frames[0].images[0]]
        raise InputError(
            f"{path}: none of its {len(table.rows)} rows names an image or frame found here, such as {example}"
        )
    return out


def frame_by_image(frames: Sequence[FrameRow], names: Sequence[str]) -> dict[str, int]:
    """Frame of an image by its name below the folder, or by its file name where that is unique."""
    return {key[0]: frame for key, frame in _by_image(frames, names).items()}


def _by_image(frames: Sequence[FrameRow], names: Sequence[str]) -> dict[tuple[str, ...], int]:
    short: dict[str, set[int]] = {}
    full: dict[tuple[str, ...], int] = {}
    for k, frame in enumerate(frames):
        for image in frame.images:
            full[(names[image],)] = k
            short.setdefault(PurePosixPath(names[image]).name, set()).add(k)
            short.setdefault(PurePosixPath(names[image]).stem, set()).add(k)
    unique: dict[tuple[str, ...], int] = {
        (name,): next(iter(found)) for name, found in short.items() if len(found) == 1
    }
    return {**unique, **full}


def _by_frame(frames: Sequence[FrameRow], tracks: Sequence[str]) -> dict[tuple[str, ...], int]:
    return {(tracks[f.track] if f.track >= 0 else "", _plain(f.key)): k for k, f in enumerate(frames)}


def _plain(key: str) -> str:
    return str(int(key)) if key.isdigit() else key


def exif_times(frames: Sequence[FrameRow], exif: Sequence[Exif]) -> np.ndarray:
    """(F,) median of the images' EXIF times, NaN where no image has one."""
    out = np.full(len(frames), np.nan)
    for k, frame in enumerate(frames):
        known = [exif[i].time_s for i in frame.images if np.isfinite(exif[i].time_s)]
        if known:
            out[k] = np.median(known)
    return out


def name_times(frames: Sequence[FrameRow], names: Sequence[str]) -> np.ndarray:
    """(F,) times written in the file names, as Unix time or as a date; NaN for all unless every frame has one."""
    found = np.array([_time_in(PurePosixPath(names[f.images[0]]).stem) for f in frames], float)
    if len(found) < 2 or np.isnan(found).any() or np.ptp(found) == 0:
        return np.full(len(frames), np.nan)
    return found


def _time_in(stem: str) -> float:
    match = _UNIX_NAME.search(stem)
    if match:
        seconds = float(in_seconds(np.array([float(match[1].replace("_", "."))]))[0])
        if _UNIX_RANGE_S[0] <= seconds <= _UNIX_RANGE_S[1]:
            return seconds
    match = _DATE_NAME.search(stem)
    if match:
        try:
            stamp = datetime.strptime(match[1] + match[2], "%Y%m%d%H%M%S").replace(tzinfo=timezone.utc)
        except ValueError:
            return float("nan")
        return stamp.timestamp() + (float(f"0.{match[3]}") if match[3] else 0.0)
    return float("nan")
