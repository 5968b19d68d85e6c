"""Small text tables, all read in one way: CSV, semicolons, tabs or blanks.

The header may follow # or %, be below a preamble, in another language, with units in brackets, at the ends of names
or in a line of their own. Without one, the reader of the table decides by the cells what the columns are.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.cells import (
    ROLES,
    UNIT_M,
    UNIT_S,
    comma_marks,
    degrees,
    known_words,
    length_m,
    number,
    plain,
    without_unit,
)
from tiegraph.scene.textfile import (
    column_names,
    delimiter_of,
    delimiter_of_rows,
    filled_lines,
    holds_values,
    plain_word,
    split_cells,
    text_of,
)
from tiegraph.text import some

_HALVES = ("{}_ref", "{}ref", "{}_hemisphere", "{}_hemi", "{}_dir", "{}_direction")  # of the column of an angle
_TIMES = ("time", "GPS time", "seconds since 1980", "seconds of the week")
_LEVELS = re.compile(r"(?i).*(msl|asl|hae|ell|geoid|ortho|egm|navd|wgs|level|datum).*")  # in brackets, and no units
Rows = Sequence[tuple[int, tuple[str, ...]]]
Layout = Callable[[Sequence[tuple[str, ...]]], tuple[str, ...]]
"""Names of the columns of rows without a header; () if undecided."""


@dataclass(frozen=True)
class Table:
    """Rows of cells with their line numbers; column names in lower case without units, which are separate."""

    path: Path
    columns: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    units: tuple[str, ...] = ()  # of each column, in lower case; "" = none
    notes: tuple[str, ...] = ()  # doubts about the file as a whole
    head: tuple[int, str] = (0, "")  # line and text of the header; 0 = there is none
    delimiter: str | None = ","  # None = blanks

    def find(self, role: str | tuple[str, ...]) -> int | None:
        """Index of the first column with one of the names of a role (``cells.ROLES``), or of some names, with or
        without a unit at its end. Raises InputError if that name occurs twice."""
        names = ROLES[role] if isinstance(role, str) else role
        name = next((a for a in names if a in self.columns), None)
        if name is None:
            units = UNIT_S if role in _TIMES else {**UNIT_M, "deg": 1, "degrees": 1}
            split = [without_unit(c) for c in self.columns]
            return next((split.index(s) for a in names for s in split if s[0] == a and s[1] in units), None)
        found = [k for k, c in enumerate(self.columns) if c == name]
        if len(found) > 1:
            raise InputError(
                f"{self.path}: the header has the column {name!r} {len(found)} times (columns "
                f"{', '.join(str(k + 1) for k in found)}): keep the right one, and rename the others"
            )
        return found[0]

    def unit(self, column: int | None) -> str:
        """Unit of a column by its header, or by a column beside it (antenna_height_units); "" if neither."""
        if column is None:
            return ""
        name = self.columns[column]
        beside = self.find((f"{name}_unit", f"{name}_units"))
        in_cells = {self.cell(k, beside).lower() for k in range(len(self.rows) if beside is not None else 0)} - {""}
        return self.units[column] or without_unit(name)[1] or (in_cells.pop() if len(in_cells) == 1 else "")

    def line(self, row: int) -> int:
        """Line number of a row in the file."""
        return self.rows[row][0]

    def where(self, row: int) -> str:
        """The file and the line of a row."""
        return f"{self.path}, line {self.line(row)}"

    def cell(self, row: int, column: int | None) -> str:
        """Text of a cell, "" if the column or the cell is not there."""
        cells = self.rows[row][1]
        return cells[column] if column is not None and column < len(cells) else ""

    @cached_property
    def comma(self) -> bool | None:
        """``cells.comma_marks`` of all cells."""
        return comma_marks([c for _, cells in self.rows for c in cells if "," in c])

    def plain(self, row: int, column: int | None) -> str:
        """Text of a cell, a number with a point and no groups. Raises InputError if it is ambiguous."""
        cell = self.cell(row, column)
        return cell if not self.comma and number(cell) == number(cell) else plain(cell, self.comma, self.where(row))

    def numbers(self, column: int | None) -> np.ndarray:
        """(R,) numbers of a column, NaN where there is none."""
        return np.array([number(self.plain(k, column)) for k in range(len(self.rows))], float)

    def metres(self, column: int | None) -> np.ndarray:
        """(R,) lengths of a column, NaN where there is none. Raises InputError for an invalid unit."""
        size = self.unit_m(column) or 1.0
        return np.array([length_m(self.plain(k, column), size) for k in range(len(self.rows))], float)

    def unit_m(self, column: int | None) -> float | None:
        """Metres of the unit of a column of lengths; None if its header gives none. Raises InputError for another."""
        unit = self.unit(column)
        if unit and unit not in UNIT_M and not _LEVELS.fullmatch(unit):
            name = self.columns[column or 0]
            raise InputError(f"{self.path}: column {name!r} has lengths in {unit!r}: give m, cm, mm or ft")
        return UNIT_M.get(unit)

    def half(self, column: int | None, letters: str) -> int | None:
        """The column with the half of the Earth, NS or EW, of an angle, if there is one."""
        if column is None:
            return None
        north, east = letters.lower()
        return self.find((*(h.format(self.columns[column]) for h in _HALVES), f"{north}_{east}", north + east))

    def angles(self, column: int | None, letters: str = "") -> np.ndarray:
        """(R,) degrees of a column, negative on the second half of the Earth of ``letters``, NS or EW. The
        letter is in the cell or in a column beside; NaN where there is none. Cells may have minutes and seconds.

        Raises InputError for another letter, and for another unit.
        """
        if self.unit(column).startswith(("rad", "gon", "grad", "mil")):
            unit = "radians" if self.unit(column).startswith("rad") else self.unit(column)
            raise InputError(f"{self.path}: column {self.columns[column or 0]!r} is in {unit}: write degrees")
        if column is None or not letters:
            return self.numbers(column)
        out, half = np.full(len(self.rows), np.nan), self.half(column, letters)
        for k in range(len(out)):
            out[k], letter = degrees(self.plain(k, column))
            word = self.cell(k, half).upper() or letter
            if np.isnan(out[k]) or not word:
                continue
            if word[0] not in letters:
                where = self.columns[half if half is not None else column]
                raise InputError(f"{self.where(k)}: {where} {word!r} is not {' or '.join(letters)}")
            out[k] = abs(out[k]) * (-1 if word[0] == letters[1] else 1)
        return out

    def some_lines(self, rows: Sequence[int] | np.ndarray) -> str:
        """The line numbers of some rows, in words."""
        return some_lines([self.line(k) for k in rows])

    def said(self, used: Mapping[str, int | None]) -> str:
        """The use of the columns, and which are not used.

        Raises InputError for a column of letters N and S, or E and W, that is none of those used.
        """
        roles = {k: role for role, k in used.items() if k is not None}
        read, over = [], []
        for k, name in enumerate(self.columns):
            unit = f" [{self.units[k]}]" if self.units[k] else ""
            if k in roles:
                read.append(name + unit + ("" if roles[k].replace(" ", "_").startswith(name) else f" ({roles[k]})"))
            else:
                over += [name] if name else []
                self._refuse_halves(k)
        parts = (("columns read", read), ("passed over", over))
        return (
            f"{self.path.name}: "
            + "; ".join(f"{what}: {', '.join(names)}" for what, names in parts if names)
            + ("; decimal commas are read as points" if self.comma else "")
        )

    def _refuse_halves(self, column: int) -> None:
        found = {self.cell(k, column).upper() for k in range(len(self.rows))} - {""}
        if found and (found <= {"N", "S"} or found <= {"E", "W"}) and found & {"S", "W"}:
            raise InputError(
                f"{self.path}: column {self.columns[column]!r} has halves of the Earth ({', '.join(sorted(found))}), "
                "but of an unknown column: call it lat_ref or lon_ref, or leave it out"
            )


def some_lines(lines: Sequence[int]) -> str:
    """The first of some line numbers, in words."""
    return f"line {some(map(str, lines), 5)}"


def read_table(path: Path, purpose: str, example: str, layout: Layout | None = None) -> Table:
    """Read a table; lines that start with # or % are comments (one as wide as the rows may be the header).

    ``example`` is a suitable header, ``layout`` names the columns of a table without one. Raises InputError,
    naming file and line, if the file cannot be read as text, is empty, has no header, has a row with more cells than
    the header (decimal commas, a missing column name) or a second header that names other columns.
    """
    text, notes = text_of(Path(path), purpose)
    return table_of(Path(path), purpose, filled_lines(text), example, layout, notes)


def table_of(
    path: Path, purpose: str, lines: Sequence[tuple[int, str]], example: str, layout: Layout | None = None,
    notes: Sequence[str] = (),
) -> Table:  # fmt: skip
    """The table in some numbered lines of a file, stripped and not empty; raises as ``read_table``."""
    if not any(line[0] not in "#%" for _, line in lines):
        raise InputError(f"{path}: no rows; give the {purpose} as a CSV file with a header line, such as {example}")
    first, start = _first_rows(lines)
    text = "" if start is None else lines[start][1].lstrip("#% ")
    delimiter = delimiter_of_rows(lines[first][1]) if start is None else delimiter_of(text)
    if start is not None and first < len(lines):
        delimiter = [*_row_delimiters(lines[first][1], delimiter, len(column_names(text))), delimiter][0]
    below = lines[first if start is None else start + 1 :]
    given = [(n, tuple(split_cells(line, delimiter))) for n, line in below if line[0] not in "#%"]
    if start is None:
        names = layout([cells for _, cells in given]) if layout else ()
        if not names:
            raise InputError(
                f"{path}, line {lines[first][0]}: neither a header nor the cells show what the columns are: "
                f"{lines[first][1]!r:.99}; write a first line with their names, such as {example}"
            )
        named = list(names)
    else:
        named = column_names(text)
    columns, units = tuple(plain_word(c) for c in named), [_unit(c) for c in named]
    if given and all(re.fullmatch(r"[(\[].*[)\]]", c) for c in given[0][1] if c):  # a line of units below the names
        if len(given[0][1]) == len(columns):
            units = [_unit(c) for c in given[0][1]]
        given = given[1:]
    bare = [(n, line.lstrip("#% ")) for n, line in below if line[0] in "#%"]
    lost = [n for n, line in bare if len(split_cells(line, delimiter)) == len(columns) > 1 and holds_values(line)]
    notes = list(notes)
    if lost:
        notes.append(f"{path.name}, {some_lines(lost)}: {len(lost)} rows begin with # or % and are passed over")
    rows = _rows(path, purpose, columns, given, notes)
    if not rows:
        raise InputError(f"{path}: no rows below its header; give the {purpose} as a CSV file with a row a moment")
    if start is None and any(columns):
        notes.append(f"{path.name}: no header; by its cells the columns are {', '.join(columns)}")
    head = (0, "") if start is None else lines[start]
    return Table(
        path=path, columns=columns, rows=rows, units=tuple(units), notes=tuple(notes), head=head, delimiter=delimiter
    )


def _first_rows(lines: Sequence[tuple[int, str]]) -> tuple[int, int | None]:
    """Index of the first line with a value, and of its header, None if it has none."""
    plain_lines = [k for k, (_, line) in enumerate(lines) if line[0] not in "#%"]
    first = next((k for k in plain_lines if holds_values(lines[k][1])), None)
    if first is None:
        return plain_lines[0] + 1, plain_lines[0]
    for k in range(first - 1, -1, -1):
        text = lines[k][1]
        bare = text.lstrip("#% ")
        names = tuple(plain_word(c) for c in column_names(bare))
        few = known_words(names) < 2 and not delimiter_of(bare) and names[0] not in ROLES["time"]
        prose = text[0] in "#%" and (few or holds_values(bare))
        if prose or not known_words(names):
            continue
        if text[0] not in "#%" or _row_delimiters(lines[first][1], delimiter_of(bare), len(names)):
            return first, k
    above = [k for k in plain_lines if k < first]
    return first, (above[-1] if above else None)


def _row_delimiters(row: str, delimiter: str | None, width: int) -> list[str | None]:
    """Delimiters with which the rows below a header have its width; first its own."""

    def fits(delimiter: str | None) -> bool:
        cells = split_cells(row, delimiter)
        filled = [k for k, cell in enumerate(cells) if cell]  # without the empty ones at its end
        return len(_joined_date(tuple(cells[: max(filled, default=0) + 1]), width)) == width

    return [d for d in (delimiter, delimiter_of_rows(row), None) if fits(d)]


def _rows(
    path: Path, purpose: str, columns: tuple[str, ...], given: Rows, notes: list[str]
) -> tuple[tuple[int, tuple[str, ...]], ...]:
    """The rows without repeated headers and with empty cells at their ends cut off."""
    known, out = {c for c in columns if c}, []
    for line, cells in given:
        cells = _joined_date(cells, len(columns))
        words = [c for c in cells if c[:1].isalpha()]
        if len(words) > 1 and len(known & {plain_word(c) for c in words}) > 1:
            if tuple(plain_word(c) for c in cells) != columns:
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
    """A date and a time separated by a blank (RTKLIB writes them below one column name) as one cell again."""
    if len(cells) == columns + 1 and re.fullmatch(r"\d{4}[-/]\d\d[-/]\d\d", cells[0]) and ":" in cells[1]:
        return (f"{cells[0]} {cells[1]}", *cells[2:])
    return cells


def _unit(text: str) -> str:
    found = re.search(r"[(\[](.*?)[)\]]", text)
    return found[1].strip().lower() if found else ""
