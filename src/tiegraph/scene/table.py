"""Small text tables with a header: CSV, semicolons, tabs or blanks."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.regular import regular


@dataclass(frozen=True)
class Table:
    """Rows of cells with their line numbers; column names in lower case without units."""

    path: Path
    columns: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]

    def find(self, aliases: tuple[str, ...]) -> int | None:
        """Index of the first column with one of some names."""
        return next((self.columns.index(a) for a in aliases if a in self.columns), None)

    def cell(self, row: int, column: int | None) -> str:
        """Text of a cell, "" if the column or the cell is not there."""
        cells = self.rows[row][1]
        return cells[column] if column is not None and column < len(cells) else ""

    def numbers(self, column: int | None) -> np.ndarray:
        """(R,) numbers of a column, NaN where there is none."""
        return np.array([_number(self.cell(k, column)) for k in range(len(self.rows))], float)

    def times(self, column: int | None, date: int | None = None) -> np.ndarray:
        """(R,) seconds of a time column: numbers, ISO 8601, or hh:mm:ss with a date column; NaN where there is none."""
        cells = [self.cell(k, column) for k in range(len(self.rows))]
        if date is not None:
            cells = [f"{self.cell(k, date)} {c}" for k, c in enumerate(cells)]
        return in_seconds(np.array([parse_time(c) for c in cells], float))


def read_table(path: Path, purpose: str) -> Table:
    """Read a table; lines that start with # or % are comments (the last one before the numbers may be the header).

    Raises InputError if the file cannot be read, is empty or has no header.
    """
    try:
        text = regular(path).read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the {purpose} as a CSV file") from None
    lines = [(k + 1, line.strip()) for k, line in enumerate(text.splitlines()) if line.strip()]
    if not any(line[0] not in "#%" for _, line in lines):
        raise InputError(f"{path}: no rows; give the {purpose} as a CSV file with a header line")
    start = next(k for k, (_, line) in enumerate(lines) if line[0] not in "#%")
    header = lines[start][1]
    if not any(re.search("[A-Za-z]", c) for c in _cells(header, _delimiter(header))[:2]) and start > 0:
        start -= 1
        header = lines[start][1].lstrip("#% ")
    delimiter = _delimiter(header)
    columns = tuple(_column(c) for c in _cells(header, delimiter))
    if not any(re.search("[a-z]", c) for c in columns):
        raise InputError(
            f"{path}, line {lines[start][0]}: the {purpose} needs a header line with column names, got {header!r}"
        )
    rows = tuple((n, tuple(_cells(line, delimiter))) for n, line in lines[start + 1 :] if line[0] not in "#%")
    return Table(Path(path), columns, rows)


def parse_time(text: str) -> float:
    """Seconds of a number, an ISO 8601 time (without zone: taken as UTC) or hh:mm:ss; NaN if it is none of them."""
    number = _number(text)
    if number == number:
        return number
    clock = re.fullmatch(r"(\d{1,2}):(\d\d):(\d\d(?:\.\d+)?)Z?", text.strip())
    if clock:
        return int(clock[1]) * 3600 + int(clock[2]) * 60 + float(clock[3])
    whole, _, fraction = text.strip().replace("/", "-").replace("Z", "+00:00").partition(".")
    digits = re.match(r"\d+", fraction)
    try:
        stamp = datetime.fromisoformat(whole + (fraction[digits.end() :] if digits else ""))
    except ValueError:
        return float("nan")
    stamp = stamp if stamp.tzinfo else stamp.replace(tzinfo=timezone.utc)
    return stamp.timestamp() + (float(f"0.{digits[0]}") if digits else 0.0)


def in_seconds(times: np.ndarray) -> np.ndarray:
    """Times since 1970 in milli-, micro- or nanoseconds as seconds; other times unchanged."""
    known = times[np.isfinite(times)]
    size = float(np.median(np.abs(known))) if len(known) else 0.0
    for limit, factor in ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3)):
        if size > limit:
            return times * factor
    return times


def _delimiter(line: str) -> str | None:
    best = max(",;\t", key=line.count)
    return best if best in line else None


def _cells(line: str, delimiter: str | None) -> list[str]:
    return [c.strip().strip('"').strip() for c in line.split(delimiter)]


def _column(text: str) -> str:
    text = re.sub(r"[(\[].*?[)\]]", "", text.strip().strip("#%").lower())
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
