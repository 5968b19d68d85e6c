"""Time of each frame: from a table, from EXIF, or from numbers in the names."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scan.folders import LONE_PASS
from tiegraph.scene.cells import in_seconds, seconds_of
from tiegraph.scene.cells import times as times_by_content
from tiegraph.scene.exif import Exif
from tiegraph.scene.names import all_found, plain_name
from tiegraph.scene.table import Table, read_table
from tiegraph.scene.times import times_of

_UNIX_NAME = re.compile(r"(?:^|\D)(\d{10}(?:[._]\d{1,9})?|\d{13}|\d{16}|\d{19})$")
_DATE_NAME = re.compile(r"(?:^|\D)((?:19|20)\d{6})[_\-T ]?(\d{6})(\d{0,6})(?:\D|$)")
_UNIX_RANGE_S = (631152000.0, 4102444800.0)  # 1990 ... 2100: other numbers of ten digits are serial numbers


@dataclass(frozen=True)
class FrameRow:
    """One frame while the scene is built: its rig, pass (-1 = loose), label within the pass and image numbers."""

    rig: int
    sequence: int
    key: str
    images: tuple[int, ...]


def read_times(
    path: Path, frames: Sequence[FrameRow], sequences: Sequence[str], names: Sequence[str]
) -> tuple[np.ndarray, list[str]]:
    """(F,) seconds from a table with the columns time and image, or time and frame and, with several passes, pass.

    An image is given by its name below the folder, or by its file name if no other has it. NaN for frames not listed;
    of several images of a frame the median counts. Notes list doubts. Raises InputError for missing columns,
    invalid times, a frame or image with two times, one time for all frames, and if no row fits a frame.
    """
    table = read_table(path, "times file", "image,time", times_by_content)
    time = times_of(table)
    image, frame, sequence = (table.find(c) for c in ("image", "frame", "pass"))
    image = table.find("name") if image is None and frame is None else image
    if time is None or (image is None and frame is None):
        raise InputError(
            f"{path}: found the columns {', '.join(table.columns)}; expected time and image, or pass, frame and time"
        )
    if image is None and sequence is None and len(sequences) > 1:
        raise InputError(f"{path}: a frame's name is not unique over {len(sequences)} passes: add a column pass")
    seconds = time.seconds
    for k in np.flatnonzero(np.isnan(seconds))[:1].tolist():
        said = f"{table.cell(k, time.column)!r} is no time (seconds or ISO 8601)"
        raise InputError(f"{table.where(k)}: {said}; correct it, or leave out rows without a time")
    said = table.said({**time.used, **({"image": image} if image is not None else {"frame": frame, "pass": sequence})})
    notes = [*table.notes, said, *time.notes]
    keys: list[tuple[str, ...]]
    lookup: dict[tuple[str, ...], int]
    if image is not None:
        keys = [(plain_name(table.cell(k, image)),) for k in range(len(seconds))]
        found = frames_of_names([key[0] for key in keys], frames, names)
        lookup = {key: of for key, of in zip(keys, found) if of is not None}
    else:
        passes = _passes(table, sequence, sequences, notes)
        keys = [(passes[k], _plain(table.cell(k, frame))) for k in range(len(seconds))]
        lookup = {(sequences[f.sequence] if f.sequence >= 0 else "", _plain(f.key)): k for k, f in enumerate(frames)}
    _refuse_two_times(table, keys, seconds, notes)
    rows: dict[int, list[int]] = {}
    for k, key in enumerate(keys):
        if key in lookup:
            rows.setdefault(lookup[key], []).append(k)
    _say_unknown(table, [k for k, key in enumerate(keys) if key not in lookup], keys, names, notes)
    if not rows and len(frames):
        here = f"; the passes here are {', '.join(sequences)}" if sequence is not None and sequences else ""
        raise InputError(
            f"{path}, line {table.line(0)}: none of its {len(seconds)} rows names an image or frame found here "
            f"({'/'.join(keys[0])}), such as {names[frames[0].images[0]]}{here}"
        )
    out = np.full(len(frames), np.nan)
    for found, mine in rows.items():
        out[found] = np.median(seconds[mine])
    _say_spread(table, rows, seconds, notes)
    if len(rows) > 1 and np.nanmax(out) == np.nanmin(out):
        raise InputError(
            f"{path}, line {table.line(0)}: all {len(rows)} frames have the time {np.nanmax(out):g} s: write the time "
            "of each, or omit --times"
        )
    return out, notes


def _passes(table: Table, sequence: int | None, sequences: Sequence[str], notes: list[str]) -> list[str]:
    """Pass of each row; rows without one belong to the only pass."""
    only = sequences[0] if len(sequences) == 1 else ""
    named = sorted({table.cell(k, sequence) for k in range(len(table.rows))} - {""})
    if only == LONE_PASS and len(named) == 1 and named[0] != only:
        notes.append(
            f"{table.path.name}, line {table.line(0)}: pass {named[0]!r} is taken as the only pass here, whose "
            "folders have no name for it"
        )
        return [only] * len(table.rows)
    return [table.cell(k, sequence) or only for k in range(len(table.rows))]


def _refuse_two_times(table: Table, keys: Sequence[tuple[str, ...]], seconds: np.ndarray, notes: list[str]) -> None:
    first: dict[tuple[str, ...], int] = {}
    again = []
    for k, key in enumerate(keys):
        other = first.setdefault(key, k)
        if seconds[other] != seconds[k]:
            raise InputError(
                f"{table.path}, line {table.line(k)}: {'/'.join(key)} has the time {seconds[k]:.10g} s, but "
                f"{seconds[other]:.10g} s in line {table.line(other)}: keep the right one"
            )
        if other != k:
            again.append(k)
    if again:
        notes.append(
            f"{table.path.name}, line {table.line(again[0])}: {'/'.join(keys[again[0]])} is listed twice, with one "
            f"time, as do {len(again)} rows in all"
        )


def _say_unknown(
    table: Table, unknown: list[int], keys: Sequence[tuple[str, ...]], names: Sequence[str], notes: list[str]
) -> None:
    if unknown and len(unknown) < len(keys):
        key = keys[unknown[0]]
        notes.append(
            f"{table.path.name}, line {table.line(unknown[0])}: {len(unknown)} of {len(keys)} rows name frames or "
            f"images that are not here, such as {'/'.join(key)}"
            + (f"; {absent(key[0], names)}" if len(key) == 1 else "")
        )


def _say_spread(table: Table, rows: dict[int, list[int]], seconds: np.ndarray, notes: list[str]) -> None:
    """Notes on images of one frame that were taken apart."""
    wide = [mine for mine in rows.values() if np.ptp(seconds[mine]) > 0.5]
    if wide:
        mine = max(wide, key=lambda m: float(np.ptp(seconds[m])))
        notes.append(
            f"{table.path.name}, {table.some_lines(mine)}: images of one frame are {np.ptp(seconds[mine]):.2f} s "
            f"apart, as in {len(wide)} frames; their median is taken: do these images belong together?"
        )


def absent(name: str, names: Sequence[str]) -> str:
    """Why an image's name is not found, and a remedy; ``names`` are those of the images."""
    file = PurePosixPath(plain_name(name)).name
    twins = [n for n in names if file in (PurePosixPath(n).name, PurePosixPath(n).stem)]
    if len(twins) > 1 and "/" not in plain_name(name):
        return f"several images have this name: write {twins[0]} or {twins[1]}"
    return f"names are relative to the image folder, like {twins[0] if twins else names[0]}"


def frames_of_names(given: Sequence[str], frames: Sequence[FrameRow], names: Sequence[str]) -> tuple[int | None, ...]:
    """Frame of each given name of an image, as ``names.all_found`` says."""
    return all_found(given, ((names[image], k) for k, frame in enumerate(frames) for image in frame.images))


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
    stems = [PurePosixPath(names[f.images[0]]).stem for f in frames]
    found = np.array([time_in_name(stem) for stem in stems], float)
    if len(found) < 2 or np.isnan(found).any():
        return np.full(len(frames), np.nan)
    return found


def time_in_name(stem: str) -> float:
    """The time that a file's stem gives, seconds since 1970; NaN if it is none."""
    match = _UNIX_NAME.search(stem)
    if match:
        seconds = float(in_seconds(np.array([float(match[1].replace("_", "."))]))[0])
        if _UNIX_RANGE_S[0] <= seconds <= _UNIX_RANGE_S[1]:
            return seconds
    match = _DATE_NAME.search(stem)
    if match:
        return seconds_of(match[1] + match[2], "%Y%m%d%H%M%S") + float(f"0.{match[3] or 0}")
    return float("nan")
