"""Small text tables with a header: CSV, semicolons, tabs or blanks."""

import bisect
import codecs
import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.regular import regular
from tiegraph.text import composed

TIME_LIMIT_S = 1e11  # the year 5138: what is larger in size is no time in seconds
_UNIT_S = {"ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_UNIT_M = {
    "m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048,
    "feet": 0.3048, "foot": 0.3048, "ftus": 1200 / 3937, "us-ft": 1200 / 3937, "us ft": 1200 / 3937,
    "us survey feet": 1200 / 3937,
}  # fmt: skip
# A half of the Earth, degrees, minutes, seconds, a half: "N35.5", "35 deg 41' 22.2\" N", "35°41'22.2\"".
_ANGLE = re.compile(
    r"\s*([NSEW])?\s*([+-]?\d+(?:\.\d*)?)\s*(?:°|DEG|D)?\s*(?:(\d+(?:\.\d*)?)\s*['′M])?\s*(?:(\d+(?:\.\d*)?)\s*(?:\"|″|''|S(?=\s)))?"
    r"\s*([NSEW])?\s*"
)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+")
_SHOWN_LINES = 5


@dataclass(frozen=True)
class Table:
    """Rows of cells with their line numbers; column names in lower case without units, which stand apart."""

    path: Path
    columns: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    units: tuple[str, ...] = ()  # what stood in brackets behind each column name, in lower case; "" = nothing
    notes: tuple[str, ...] = ()  # what was doubtful about the file as a whole

    def find(self, aliases: tuple[str, ...]) -> int | None:
        """Index of the first column with one of some names. Raises InputError if that name stands twice."""
        name = next((a for a in aliases if a in self.columns), None)
        if name is None:
            return None
        found = [k for k, c in enumerate(self.columns) if c == name]
        if len(found) > 1:
            raise InputError(
                f"{self.path}: the header has the column {name!r} {len(found)} times (columns "
                f"{', '.join(str(k + 1) for k in found)}): leave the one that counts, and rename the others"
            )
        return found[0]

    def unit(self, column: int | None) -> str:
        """Unit of a column as its header gives it in brackets, in lower case; "" if it gives none."""
        return self.units[column] if column is not None and column < len(self.units) else ""

    def unit_m(self, column: int | None) -> float | None:
        """Metres of the unit of a column of lengths; None if its header gives none, or says something else there."""
        return _UNIT_M.get(self.unit(column))

    def line(self, row: int) -> int:
        """Line number of a row in the file."""
        return self.rows[row][0]

    def cell(self, row: int, column: int | None) -> str:
        """Text of a cell, "" if the column or the cell is not there."""
        cells = self.rows[row][1]
        return cells[column] if column is not None and column < len(cells) else ""

    def numbers(self, column: int | None) -> np.ndarray:
        """(R,) numbers of a column, NaN where there is none. Raises InputError for decimal commas."""
        if column is None:
            return np.full(len(self.rows), np.nan)
        out = np.array([number(self.cell(k, column)) for k in range(len(self.rows))], float)
        for k in np.flatnonzero(np.isnan(out)).tolist():
            if _DECIMAL_COMMA.fullmatch(self.cell(k, column)):
                raise InputError(
                    f"{self.path}, line {self.line(k)}: {self.cell(k, column)!r} has a decimal comma: write numbers "
                    "with a point"
                )
        return out

    def angles(self, column: int | None, half: int | None, letters: str) -> np.ndarray:
        """(R,) degrees of a column, negative on the second half of the Earth that ``letters``, NS or EW, name. The
        letter stands in the cell or in a column ``half``; NaN where there is none. Cells may have minutes and seconds.

        Raises InputError for another letter, and for decimal commas.
        """
        out = self.numbers(column)
        for k in range(len(out)):
            cell, word = self.cell(k, column), self.cell(k, half).upper()
            if np.isnan(out[k]) and (found := _ANGLE.fullmatch(cell.upper())):
                whole, minutes, seconds = (float(found[n] or 0) for n in (2, 3, 4))
                out[k] = np.copysign(abs(whole) + minutes / 60 + seconds / 3600, whole)
                word = word or found[1] or found[5] or ""
            if np.isnan(out[k]) or not word:
                continue
            if word[0] not in letters:
                where = self.columns[half if half is not None else column or 0]
                raise InputError(f"{self.path}, line {self.line(k)}: {where} {word!r} is not {' or '.join(letters)}")
            out[k] = abs(out[k]) * (-1 if word[0] == letters[1] else 1)
        return out

    def times(self, column: int | None, date: int | None = None) -> np.ndarray:
        """(R,) seconds of a time column: numbers, ISO 8601, or hh:mm:ss with a date column; NaN where there is none.

        A unit in the header, time (ns) or time_ns, is heeded; without one, times since 1970 tell it by their size.
        """
        self.numbers(column)
        cells = [self.cell(k, column) for k in range(len(self.rows))]
        if date is not None:
            cells = [f"{self.cell(k, date)} {c}" for k, c in enumerate(cells)]
        seconds = np.array([parse_time(c) for c in cells], float)
        named = "" if column is None else self.columns[column].rpartition("_")[2]
        unit = _UNIT_S.get(self.unit(column) or named)
        seconds = in_seconds(seconds) if unit is None else seconds * unit
        return np.where(np.abs(seconds) <= TIME_LIMIT_S, seconds, np.nan)

    def some_lines(self, rows: Sequence[int] | np.ndarray) -> str:
        """The line numbers of some rows, in words: "line 4, 5, 9 ..."."""
        return some_lines([self.line(k) for k in rows])


def some_lines(lines: Sequence[int]) -> str:
    """The first of some line numbers, in words: "line 4, 5, 9 ..."."""
    shown = ", ".join(str(n) for n in lines[:_SHOWN_LINES])
    return f"line {shown}" + (" ..." if len(lines) > _SHOWN_LINES else "")


def read_table(path: Path, purpose: str) -> Table:
    """Read a table; lines that start with # or % are comments (the last one before the numbers may be the header).

    Raises InputError, naming file and line, if the file cannot be read as text, is empty, has no header, has a row with
    more cells than the header (decimal commas, a missing column name) or a second header that names other columns.
    """
    text, notes = decoded(Path(path), whole_file(Path(path), purpose), purpose)
    lines = [(k + 1, line.strip()) for k, line in enumerate(text_lines(text)) if line.strip()]
    return table_of(Path(path), purpose, lines, notes)


def table_of(path: Path, purpose: str, lines: Sequence[tuple[int, str]], notes: Sequence[str] = ()) -> Table:
    """The table in some numbered lines of a file, stripped and not empty; raises what ``read_table`` raises."""
    notes = list(notes)
    if not any(line[0] not in "#%" for _, line in lines):
        raise InputError(f"{path}: no rows; give the {purpose} as a CSV file with a header line")
    start = next(k for k, (_, line) in enumerate(lines) if line[0] not in "#%")
    header = lines[start][1]
    if not any(re.search("[A-Za-z]", c) for c in _cells(header, _delimiter(header))[:2]) and start > 0:
        start -= 1
        header = lines[start][1].lstrip("#% ")
    delimiter = _delimiter(header)
    # Blanks part columns only where they do not stand before a unit: "Time (s) Latitude [deg]" has two.
    named = _cells(header if delimiter else re.sub(r"\s+(?=[(\[])", "", header), delimiter)
    columns = tuple(_column(c) for c in named)
    if not any(re.search("[a-z]", c) for c in columns):
        raise InputError(
            f"{path}, line {lines[start][0]}: the {purpose} needs a header line with column names, got {header!r}"
        )
    given = [(n, tuple(_cells(line, delimiter))) for n, line in lines[start + 1 :] if line[0] not in "#%"]
    rows = _rows(path, purpose, columns, given, notes)
    if not rows:
        raise InputError(f"{path}: no rows below its header; give the {purpose} as a CSV file with a row a moment")
    return Table(path=path, columns=columns, rows=rows, units=tuple(_unit(c) for c in named), notes=tuple(notes))


def text_lines(text: str) -> list[str]:
    """The lines of a text as editors count them (``str.splitlines`` also parts at form feeds and other separators), in
    composed form, as names are."""
    return re.split(r"\r\n|\r|\n", composed(text))


def whole_file(path: Path, purpose: str) -> bytes:
    """What is in a file. Raises InputError if it cannot be read."""
    try:
        return regular(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the {purpose} as a CSV file") from None


def decoded(path: Path, raw: bytes, purpose: str) -> tuple[str, list[str]]:
    """Text of a file, UTF-8 or UTF-16 with its mark, and notes. Raises InputError if it is none."""
    utf16 = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = raw.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        text = raw.decode("utf-8-sig", errors="replace")
        notes = [f"{path.name}, line {line}: not UTF-8; names with such letters are not found: save it as UTF-8"]
    else:
        notes = []
    if "\0" in text or (notes and text.count("\ufffd") > len(text) / 4):
        raise InputError(f"{path}: is no text (it holds zero bytes or no letters); give the {purpose} as a CSV file")
    return text, notes


def _rows(
    path: Path, purpose: str, columns: tuple[str, ...], given: list[tuple[int, tuple[str, ...]]], notes: list[str]
) -> tuple[tuple[int, tuple[str, ...]], ...]:
    """The rows without repeated headers and with empty cells at their ends cut off."""
    known, out = {c for c in columns if c}, []
    for line, cells in given:
        cells = _joined_date(cells, len(columns))
        if len(known & {_column(c) for c in cells if c[:1].isalpha()}) > 1:
            if tuple(_column(c) for c in cells) != columns:
                raise InputError(f"{path}, line {line}: a second header with other columns; give one table a file")
            notes.append(f"{path.name}, line {line}: the header again, left out; are these several tables in one file?")
            continue
        while len(cells) > len(columns) and not cells[-1]:
            cells = cells[:-1]
        if len(cells) > len(columns):
            raise InputError(
                f"{path}, line {line}: {len(cells)} cells below a header of {len(columns)} ({', '.join(columns)}): "
                "decimal commas, or a column without a name? Write numbers with a point and name every column of the "
                f"{purpose}"
            )
        out.append((line, cells))
    short = [line for line, cells in out if len(cells) < len(columns)]
    if short:
        notes.append(
            f"{path.name}, line {short[0]}: fewer cells than the header has columns ({len(columns)}), as in "
            f"{len(short)} of {len(out)} rows; the missing ones count as empty: was the file cut off?"
        )
    return tuple(out)


def _joined_date(cells: tuple[str, ...], columns: int) -> tuple[str, ...]:
    """A date and a time that a blank parted (RTKLIB writes them below one column name) as one cell again."""
    if len(cells) == columns + 1 and re.fullmatch(r"\d{4}[-/]\d\d[-/]\d\d", cells[0]) and ":" in cells[1]:
        return (f"{cells[0]} {cells[1]}", *cells[2:])
    return cells


def parse_time(text: str) -> float:
    """Seconds of a number, an ISO 8601 time (without zone: taken as UTC) or hh:mm:ss; NaN if it is none of them."""
    seconds = number(text)
    if seconds == seconds:
        return seconds
    clock = re.fullmatch(r"(\d{1,2}):([0-5]\d):([0-5]\d(?:\.\d+)?)Z?", text.strip())
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


def out_of_order(times: np.ndarray) -> np.ndarray:
    """Rows of times (R,) that stand out of order: all but the longest run of rows that never go back, where that is
    most of them; else the rows that go back. One time that is too large is blamed itself, not the row after it."""
    starts: list[float] = []  # first time, negative, of the best run of each length, and its row
    rows: list[int] = []
    after = np.full(len(times), -1)  # the next row of its run
    for k in range(len(times) - 1, -1, -1):  # from the end, so that of two rows that are exchanged the later one is odd
        at = bisect.bisect_right(starts, -float(times[k]))
        after[k] = rows[at - 1] if at else -1
        starts[at : at + 1], rows[at : at + 1] = [-float(times[k])], [k]
    keep = np.zeros(len(times), bool)
    k = rows[-1] if rows else -1
    while k >= 0:
        keep[k] = True
        k = int(after[k])
    back = np.flatnonzero(np.diff(times) < 0) + 1
    return np.flatnonzero(~keep) if 2 * keep.sum() > len(times) else back


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
    """Cells of a line; a delimiter between quotes parts none."""
    parts = line.split(delimiter)
    if delimiter is not None and '"' in line:
        try:
            parts = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
        except csv.Error:  # a cell longer than the reader takes: no table anyway, and what reads it says so
            pass
    return [c.strip().strip('"').strip() for c in parts]


def _unit(text: str) -> str:
    found = re.search(r"[(\[](.*?)[)\]]", text)
    return found[1].strip().lower() if found else ""


def _column(text: str) -> str:
    text = re.sub(r"[(\[].*?[)\]]", "", text.strip().strip("#%").lower())
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")


def number(text: str) -> float:
    """The number that a cell is, NaN if it is none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")
