"""When each scan was taken: a file of times beside the scans, row by row or by the scans' names."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.table import in_seconds, parse_time, read_table
from tiegraph.scene.timecolumns import times_of

_FILES = ("times.txt", "timestamps.txt", "times.csv", "timestamps.csv", "timestamps.json")
_START = ("time_start", "start", "stamp")
_NAME = ("scan", "name", "file", "frame")


def find_times(folder: Path) -> Path | None:
    """The file of times in the folder of the scans or in the one above it."""
    places = [place / name for place in (folder, folder.parent) for name in _FILES]
    return next((p for p in places if p.is_file()), None)


def read_scan_times(path: Path, stems: Sequence[str]) -> np.ndarray:
    """(N,) seconds of the scans with these names without ending.

    A .json is a list of numbers, a .csv a table with a column time (or time_start) and, perhaps, one with the scans'
    names; any other file has a number or a date a line. Raises InputError for times that are none or too few.
    """
    try:
        if path.suffix.lower() == ".csv":
            return _of_table(path, stems)
        text = path.read_text()
        rows = json.loads(text) if path.suffix.lower() == ".json" else text.split("\n")
        lines = [(k, str(row).strip()) for k, row in enumerate(rows, start=1)]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: cannot be read as times of scans: {error}") from None
    lines = [(k, line) for k, line in lines if line and not line.startswith("#")]
    seconds = np.array([parse_time(line) for _, line in lines])
    bad = np.flatnonzero(~np.isfinite(seconds))
    if len(bad):
        k, line = lines[bad[0]]
        raise InputError(f"{path}, line {k}: {line[:80]!r} is no time (seconds, or a date and time)")
    return of_scans(path, in_seconds(seconds), stems)


def of_scans(path: Path, rows: np.ndarray, stems: Sequence[str]) -> np.ndarray:
    """The rows (R, ...) of a file that belong to scans: as many as these in their order, else by their numbers.

    Raises InputError where neither fits.
    """
    if len(rows) == len(stems):
        return rows
    numbers = [int(s) if s.isdigit() else -1 for s in stems]
    if min(numbers) >= 0 and max(numbers) < len(rows):
        return rows[numbers]
    raise InputError(f"{path}: {len(rows)} rows for {len(stems)} scans ({stems[0]} to {stems[-1]}): one each is needed")


def _of_table(path: Path, stems: Sequence[str]) -> np.ndarray:
    table = read_table(path, "times of the scans")
    column = table.find(_START)
    if column is not None:
        seconds = table.times(column)
    else:
        found = times_of(table)
        if found is None:
            raise InputError(f"{path}: found the columns {', '.join(table.columns)}; expected one called time")
        seconds = found.seconds
    bad = np.flatnonzero(~np.isfinite(seconds))
    if len(bad):
        raise InputError(f"{path}, line {table.line(int(bad[0]))}: no time (seconds, or a date and time)")
    names = table.find(_NAME)
    if names is None:
        return of_scans(path, seconds, stems)
    by_name = {Path(table.cell(k, names)).stem: seconds[k] for k in range(len(seconds))}
    missing = [s for s in stems if s not in by_name]
    if missing:
        raise InputError(f"{path}: no row for the scan {missing[0]} ({len(missing)} of {len(stems)} have none)")
    return np.array([by_name[s] for s in stems])
