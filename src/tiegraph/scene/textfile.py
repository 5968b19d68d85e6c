"""Text files: their lines, the cells in them, the coordinate system that a line names (the first of ODM's files, a
comment above a header); XML as a tree of elements with their lines, without entities and name spaces.
"""

from __future__ import annotations

import codecs
import csv
import re
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from xml.parsers import expat

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import utm_by_name
from tiegraph.scene.atomic import regular
from tiegraph.scene.cells import known_words, says_value
from tiegraph.text import composed

if TYPE_CHECKING:
    import pyproj

    from tiegraph.scene.table import Table

_HEAD = 1 << 14  # characters in which a header is searched for


def text_lines(text: str) -> list[str]:
    """The lines of a text as editors count them (``str.splitlines`` also splits at form feeds and other separators),
    in composed form, as names are."""
    return re.split(r"\r\n|\r|\n", composed(text))


def filled_lines(text: str) -> list[tuple[int, str]]:
    """The numbered lines of a text that are not empty, without blanks at their ends; a tab before all is an indent,
    another follows an empty cell. Excel's ``sep=;`` is left out."""
    lines = [(k, line.strip(" \x0b\x0c\ufeff")) for k, line in enumerate(text_lines(text), start=1)]
    lines = [(k, line) for k, line in lines if line.strip(' \t,;|"') and not re.fullmatch(r"(?i)\"?sep=.\"?", line)]
    indented = all(line[0] == "\t" or line.lstrip()[0] in "#%" for _, line in lines)
    lines = [(k, line.lstrip() if line.lstrip()[0] in "#%" else line[indented:]) for k, line in lines]
    return [(k, line.rstrip()) for k, line in lines]


def utf8_text(path: Path, where: str, remedy: str = "") -> str:
    """Text of a UTF-8 file; ``where``: its name in errors. Raises InputError, ending with ``remedy``."""
    try:
        return regular(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: cannot be read as text in UTF-8 ({error}){remedy}") from None


def whole_file(path: Path, remedy: str) -> bytes:
    """The contents of a file. Raises InputError, which ends with ``remedy``, if it cannot be read."""
    try:
        return regular(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {remedy}") from None


def text_of(path: Path, purpose: str) -> tuple[str, list[str]]:
    """Text of a file, and notes, as in ``decoded``."""
    return decoded(path, whole_file(path, f"give the {purpose} as a CSV file"), purpose)


def decoded(path: Path, raw: bytes, purpose: str) -> tuple[str, list[str]]:
    """Text of a file, UTF-8 or UTF-16 with its mark, and notes; another is read as Windows writes it in the West or in
    Japan, whichever gives more names of columns. Raises InputError if it is no text."""
    utf16 = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    notes = []
    try:
        text = raw.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        lost = raw.decode("utf-8-sig", errors="replace")
        if utf16 or "\0" in lost or lost.count("\ufffd") > len(lost) / 4:
            text = "\0"
        else:
            texts = [raw.decode(e, errors="replace") for e in ("cp1252", "cp932")]
            text = max(texts, key=lambda t: max(known_words(_words(line)) for line in text_lines(t[:_HEAD])))
            notes = [f"{path.name}, line {line}: not UTF-8; names with such letters may not be found: save it as UTF-8"]
    if "\0" in text:
        raise InputError(f"{path}: is no text (it has zero bytes or no letters); give the {purpose} as a CSV file")
    return text, notes


def holds_values(line: str) -> bool:
    """Whether a number, an angle or a time is among the cells of a line."""
    return any(says_value(c) for c in split_cells(line, delimiter_of_rows(line)))


def delimiter_of(line: str) -> str | None:
    """The delimiter of a header; None = blanks."""
    best = max("\t;|,", key=line.count)
    return best if best in line else None


def delimiter_of_rows(line: str) -> str | None:
    """The delimiter of a line of values, in which a comma may be a decimal point."""
    return next((d for d in "\t;|," if d in line), None)


def split_cells(line: str, delimiter: str | None) -> list[str]:
    """Cells of a line; a delimiter between quotes separates none."""
    parts = line.split(delimiter)
    if '"' in line:
        one = line if delimiter else " ".join(line.split())
        try:
            parts = next(csv.reader([one], delimiter=delimiter or " ", skipinitialspace=True))
        except csv.Error:  # a cell longer than the reader takes: no table anyway, and its reader reports it
            pass
    return [c.strip().strip('"').strip() for c in parts]


def column_names(header: str) -> list[str]:
    """The columns' names. Blanks separate them only if they do not precede a unit: "Time (s) Latitude [deg]"."""
    delimiter = delimiter_of(header)
    return split_cells(header if delimiter else re.sub(r"\s+(?=[(\[])", "", header), delimiter)


def header_words(line: str) -> tuple[str, ...]:
    """Names of the columns that a line may give; () if it has values."""
    return () if holds_values(line) else _words(line)


def _words(line: str) -> tuple[str, ...]:
    return tuple(plain_word(c) for c in column_names(line))


def plain_word(text: str) -> str:
    """A column's name in lower case, without accents, brackets and signs."""
    text = re.sub(r"[(\[].*?[)\]]", "", text).casefold()
    if not text.isascii():
        parts = unicodedata.normalize("NFKD", text)
        text = unicodedata.normalize("NFC", "".join(c for c in parts if not unicodedata.combining(c)))
    return re.sub(r"[\W_]+", "_", text).strip("_")


_COMMENT = re.compile(
    r"(?i)[#%]\s*(?:crs|coordinate\s?system)?\s*[:=,]?\s*"
    r"(EPSG:\d+(?:\+\d+)?|\+proj.*|WGS\s*84\s*UTM.*|(?:PROJ|GEOG|GEOC|COMPD|BOUND|COMPOUND)\w*\[.*)"
)


def crs_above(lines: Iterable[tuple[int, str]], path: object) -> pyproj.CRS | None:
    """The CRS of the first comment line that names one, as ``# crs: EPSG:6677``, or in Metashape's form, above a
    table's header. Raises InputError for an invalid one."""
    for number, line in lines:
        if line[0] not in "#%":
            break
        if found := _COMMENT.fullmatch(line):
            return parse_crs_line(found[1], f"{path}, line {number}")
    return None


def parse_crs_line(text: str, where: str, more: str = "") -> pyproj.CRS:
    """The CRS of a text: an EPSG code, a PROJ string, WKT, the name in EPSG's registry (WGS84 alone is that of
    degrees) or "WGS84 UTM 54N".

    Raises InputError, which ends with ``more``.
    """
    import pyproj

    bare = text.strip().lstrip("#").strip()
    zones = utm_by_name(bare)
    try:
        if len(zones) == 1:
            return pyproj.CRS.from_user_input(zones[0])
        found = pyproj.CRS.from_user_input(bare) if re.match(r"[A-Za-z+]", bare) else None
        # PROJ takes the CRS with the most similar name for any word: only a name written out is meant
        if found is not None and (
            re.search(r"[:=\[]", bare) or found.name.replace(" ", "").lower() == bare.replace(" ", "").lower()
        ):
            return found
        raise pyproj.exceptions.CRSError(bare)
    except pyproj.exceptions.CRSError:
        raise InputError(
            f"{where}: {text!r:.99} is no coordinate system; name one, such as EPSG:32654, WGS84 UTM 54N or +proj=utm "
            f"+zone=54 +datum=WGS84 +units=m{more}"
        ) from None


def say_axes(crs: pyproj.CRS, name: str) -> tuple[str, ...]:
    """A note on x and y of a file in a grid whose X is the northing, as in many countries' surveying."""
    note = (
        f"{name}: X of {crs.name} is the northing, but x is read as the easting and y as the northing; if x is the "
        "northing here, give a CSV whose header says northing and easting"
    )
    return (note,) if crs.is_projected and crs.axis_info[0].direction.lower() == "north" else ()


def units_of(crs: pyproj.CRS | None) -> tuple[float, float, float]:
    """Metres of the units of east, north and height of a grid, in that of east if it has no heights."""
    axes = [a.unit_conversion_factor for a in crs.axis_info] if crs is not None and crs.is_projected else [1.0, 1.0]
    return (axes[0], axes[1], axes[2] if len(axes) > 2 else axes[0])


def coordinates_of(table: Table, crs: str | None, notes: list[str]) -> tuple[tuple[str, str, str], str | None]:
    """Roles of the columns of places and their CRS: degrees with the height above the ellipsoid if they exist,
    unless a line names a grid; else those of a grid, which a column may name."""
    degrees = table.find("latitude") is not None and table.find("longitude") is not None
    grid = table.find("easting") is not None and table.find("northing") is not None
    named = None if crs is None else parse_crs_line(crs, str(table.path))
    above = "ellipsoidal height" if table.find("ellipsoidal height") is not None else "height"
    if degrees and not (grid and named is not None and named.is_projected):
        if grid:
            notes.append(
                f"{table.path.name}: places by latitude, longitude and {above}; for easting, northing and height put a "
                "line '# crs: EPSG:n' above the header"
            )
        return ("latitude", "longitude", above), crs
    column = table.find("crs")
    stated = {table.cell(k, column) for k in range(len(table.rows))} - {""}
    if crs is None and len(stated) == 1:
        text, where = stated.pop(), f"{table.path}, column {table.columns[column or 0]}"
        remedy = "; or put a line '# crs: EPSG:n' above the header"
        crs = parse_crs_line(f"EPSG:{text}" if text.isdigit() else text, where, remedy).srs
    return ("easting", "northing", "height" if table.find("height") is not None else above), crs


@dataclass
class Element:
    """An element without the prefix of its name."""

    name: str
    line: int
    given: dict[str, str]
    text: str = ""
    children: list[Element] = field(default_factory=list)

    def all(self, name: str) -> Iterator[Element]:
        """Elements of a name at any depth, in their order."""
        todo: list[Element] = [self]
        while todo:
            node = todo.pop()
            if node.name == name:
                yield node
            todo.extend(reversed(node.children))

    def said(self, name: str) -> str:
        """Text of the first child of a name, "" without one."""
        return next((c.text.strip() for c in self.children if c.name == name), "")


def parse_xml(path: Path | str, raw: bytes) -> Element:
    """The elements of an XML file. Raises InputError, with the line, for one that is damaged or defines entities."""
    parser = expat.ParserCreate()
    parser.buffer_text = True
    root = Element("", 0, {})
    open_ = [root]

    def start(name: str, given: dict[str, str]) -> None:
        open_[-1].children.append(Element(name.rpartition(":")[2], parser.CurrentLineNumber, given))
        open_.append(open_[-1].children[-1])

    def data(text: str) -> None:
        open_[-1].text += text

    def entity(*_: object) -> None:
        raise InputError(f"{path}, line {parser.CurrentLineNumber}: defines entities, which no export needs: remove it")

    parser.StartElementHandler, parser.CharacterDataHandler, parser.EntityDeclHandler = start, data, entity
    parser.EndElementHandler = lambda name: open_.pop()
    try:
        parser.Parse(raw, True)
    except InputError:
        raise
    except expat.ExpatError as error:
        raise InputError(
            f"{path}, line {error.lineno}: XML that is cut off or damaged ({expat.ErrorString(error.code)}): export "
            "it again"
        ) from None
    except (LookupError, ValueError) as error:  # of an encoding that expat does not know itself
        raise InputError(f"{path}, line 1: XML that cannot be decoded ({error}): save it as UTF-8") from None
    return root
