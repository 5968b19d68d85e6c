"""Ground control and check points: surveyed coordinates and the pixels of their marks.

Two forms are read. OpenDroneMap's ``gcp_list.txt``: first line the CRS, then ``x y z px py image [name] [more]``. And
CSV with a header: points (name, x, y, z or lat, lon, height; sigma_xy, sigma_z, role) and marks (name, image, px, py),
in one table with rows of either kind or of both at once, in two tables of one file, or in two files. Pixels count from
the outer corner of the upright image's first pixel: its centre is (0.5, 0.5). A point named as a coded target
(``targets.py``) needs no marks. A CSV may contain scale bars too, or nothing else.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import within_area
from tiegraph.scene.cells import SIGMAS, is_file, known_words, length_m, number, says_value
from tiegraph.scene.cells import points as points_by_content
from tiegraph.scene.table import Table, table_of
from tiegraph.scene.targets import BAR_FORM, FORM, FileBar, Target, count_of, names_bars, read_bars, target_of
from tiegraph.scene.textfile import (
    coordinates_of,
    crs_above,
    delimiter_of_rows,
    filled_lines,
    header_words,
    parse_crs_line,
    say_axes,
    split_cells,
    text_of,
    units_of,
)

SIGMA_M = (0.02, 0.02, 0.03)  # of a point without sigma in its file: network RTK with a pole
_LARGEST_COPY = 4.0  # of a marked image over the survey's: images are halved at most twice for a survey
MAX_SIGMA_M = 100.0  # a larger sigma of a surveyed point means another unit, or a typing error
_NEED = {"points": "coordinates", "marks": "a pixel in an image"}
_CHECK = ("check", "checkpoint", "check_point", "checkpoints", "cp", "chk")
_CONTROL = ("", "gcp", "control", "control_point", "controlpoint")
_TITLE = re.compile(
    r"(?i)\[?\s*(points|marks|gcps?|control points|check points|observations|(?:scale )?bars)\s*\]?\s*:?[,;\s]*"
)
FORMS = (
    "points need the columns name, x, y, z (or name, lat, lon, height; if known sigma_xy, sigma_z, role: gcp or "
    "check), marks name, image, px, py, in one table, in two tables of one file with a header each, or in two files "
    "(--gcp POINTS --marks MARKS); '# crs: EPSG:n' in the first line gives the CRS of x, y, z; or give ODM's "
    f"gcp_list.txt. Points named as coded targets need no marks: {FORM}. {BAR_FORM[0].upper()}{BAR_FORM[1:]}"
)
_EXAMPLE = (
    "name,easting,northing,height or, of a list with north before east (PNEZD), name,northing,easting,height,code, "
    "below a line '# crs: EPSG:n' (which decides the order if only one lies in the area of the CRS)"
)


@dataclass(frozen=True)
class FilePoint:
    """A surveyed point as in its file: coordinates in ``crs`` (east, north, height or lat, lon, height)."""

    name: str
    xyz: tuple[float, float, float]
    sigma_m: tuple[float, float, float]
    check: bool
    line: int


@dataclass(frozen=True)
class FileMark:
    """One mark: point name, image name, pixel."""

    name: str
    image: str
    xy: tuple[float, float]
    line: int


@dataclass(frozen=True)
class GcpFile:
    """A control point file as read; ``crs`` None = that of the survey's world."""

    path: Path
    crs: str | None
    geographic: bool  # coordinates are lat, lon, height in degrees
    points: tuple[FilePoint, ...]
    marks: tuple[FileMark, ...]
    notes: tuple[str, ...] = ()
    marks_path: Path | None = None  # of a file with the marks alone
    bars: tuple[FileBar, ...] = ()
    largest_copy: float = 1.0  # of the images, in which marks may have been made, times these

    @property
    def of_marks(self) -> Path:
        """The file of the marks."""
        return self.marks_path or self.path

    @property
    def targets(self) -> dict[str, Target]:
        """The coded targets among the points and the ends of the bars, by their names in the file."""
        named = {p.name: target_of(p.name) for p in self.points} | {n: target_of(n) for b in self.bars for n in b.ends}
        return {name: target for name, target in named.items() if target is not None}


def read_gcps(path: Path, marks: Path | None = None) -> GcpFile:
    """Read control points of either form; ``marks`` is the file of their marks, if separate.

    Raises InputError, naming file and line, for an unreadable file, an unknown CRS, invalid numbers, points
    without marks, marks of a point without coordinates, and a name with two places.
    """
    found = _read(Path(path), "--gcp")
    if marks is not None:
        points, other = found, _read(Path(marks), "--marks")
        if not (points.points or points.bars):
            points, other = other, points
        if other.points or points.marks:
            both = "points" if other.points else "marks"
            raise InputError(
                f"--gcp {path} and --marks {marks}: both contain {both}; omit --marks, or keep the points in the one "
                "and the marks in the other"
            )
        found = replace(points, marks=other.marks, marks_path=other.path, notes=(*points.notes, *other.notes))
    places = found.points or found.bars
    if not places or not (found.marks or found.targets):
        there, lacking = ("points", "marks") if places else ("marks", "points")
        raise InputError(f"--gcp {path}: {there}, but no {lacking} with {_NEED[lacking]}; {FORMS}")
    _check_targets(found)
    names = {p.name for p in found.points} | {n for b in found.bars for n in b.ends}
    for lost in (m for m in found.marks if m.name not in names):
        there = "the file" if found.marks_path is None else found.path.name
        said = f"a mark of point {lost.name!r}, which has no coordinates in {there}"
        raise InputError(f"{found.of_marks}, line {lost.line}: {said}")
    said = (*found.notes, *_doubtful(found))
    return replace(found, notes=said, largest_copy=_LARGEST_COPY)


def read_points(path: Path) -> GcpFile:
    """Points of a file of either form, marked or not. Raises as ``read_gcps``, except for lacking marks."""
    found = _read(Path(path), "--points")
    if not found.points:
        raise InputError(f"--points {path}: no points with {_NEED['points']}; {FORMS}")
    return found


def _check_targets(found: GcpFile) -> None:
    """Raise InputError for numbers a family lacks, a target by two names, and unknown ends of bars."""
    lines = {n: b.line for b in found.bars for n in b.ends} | {p.name: p.line for p in found.points}
    names: dict[Target, str] = {}
    for name, target in found.targets.items():
        where = f"{found.path}, line {lines[name]}"
        most = count_of(target.family)
        if target.number >= most:
            raise InputError(f"{where}: target {name!r}: that family has {most} targets, numbered 0 to {most - 1}")
        if names.setdefault(target, name) != name:
            raise InputError(f"{where}: {name!r} and {names[target]!r} are one target: name it in one way only")
    marked = {m.name for m in found.marks}
    for bar in found.bars:
        for lost in (n for n in bar.ends if n not in marked and n not in found.targets):
            raise InputError(
                f"{found.path}, line {bar.line}: the end {lost!r} of this bar is neither marked nor a coded target; "
                f"{FORM} (--marks gives marks of others)"
            )


def _read(path: Path, option: str) -> GcpFile:
    text, doubts = text_of(path, "control point file")
    lines = [(n, line) for n, line in filled_lines(text) if not _TITLE.fullmatch(line)]
    if not lines:
        raise InputError(f"{option} {path}: the file is empty; {FORMS}")
    found = (_read_odm if _is_odm(lines) else _read_csv)(path, lines)
    _refuse_exchanged(found)
    return replace(found, notes=(*doubts, *found.notes))


def _refuse_exchanged(found: GcpFile) -> None:
    """Raise InputError for the first point whose coordinates must be exchanged: its latitude is above 90, or it lies
    outside its grid's area of use, and exchanged inside."""
    import pyproj

    if found.crs is None:
        return
    places = np.array([p.xyz[:2] for p in found.points], float).reshape(-1, 2)
    bad = within_area(found.crs, places[:, ::-1]) & ~within_area(found.crs, places)
    if pyproj.CRS.from_user_input(found.crs).is_geographic:
        bad = np.abs(places[:, 0]) > 90
    for k in np.flatnonzero(bad)[:1]:
        point, named = found.points[k], "lon,lat" if found.geographic else "northing,easting"
        raise InputError(
            f"{found.path}, line {point.line}: the first two coordinates of point {point.name!r} are exchanged "
            f"({named}): give a CSV whose header names the columns, such as name,{named},height"
        )


def _is_odm(lines: list[tuple[int, str]]) -> bool:
    """Whether the first line that is no comment is a CRS, or invalid: neither names of columns nor a row of a list of
    points. A row x y z px py image lacks the CRS above."""
    first = next((line for _, line in lines if line[0] not in "#%"), "")
    values = [says_value(c) for c in split_cells(first, delimiter_of_rows(first))]
    a_row = len(values) > 3 and sum(values) > 1 and "[" not in first and not (len(values) > 5 and all(values[:5]))
    return not (_is_header(first) or a_row)


def _doubtful(found: GcpFile) -> list[str]:
    """Oddities of a file that can be used nevertheless."""
    name, notes = found.path.name, []
    repeats = len(found.marks) - len({(m.name, m.image) for m in found.marks})
    if repeats:
        notes.append(f"{found.of_marks.name}: {repeats} marks are given twice; one of each is used")
    first: dict[tuple[float, ...], FilePoint] = {}
    for point in found.points:
        known = first.setdefault(point.xyz, point)
        if known is not point:
            notes.append(
                f"{name}, line {point.line}: point {point.name!r} has the same coordinates as {known.name!r} in line "
                f"{known.line}: one point by two names?"
            )
    return notes


def _is_header(line: str) -> bool:
    names = header_words(line)
    return known_words(names) > 2 or names_bars(names)


def _read_odm(path: Path, lines: list[tuple[int, str]]) -> GcpFile:
    more = f"; the first line of a gcp_list.txt is one; that of a CSV is a header: {FORMS}"
    crs = parse_crs_line(lines[0][1], f"{path}, line {lines[0][0]}", more)
    points: dict[str, FilePoint] = {}
    by_place: dict[tuple[float, ...], str] = {}
    marks = []
    for n, line in lines[1:]:
        if line[0] in "#%":
            continue
        words = split_cells(line, "\t" if line.count("\t") >= 5 else None)
        if len(words) < 6:
            raise InputError(f"{path}, line {n}: expected x y z px py image [name], got {line!r}")
        if not is_file(words[5]) and any(map(is_file, words[6:])):
            raise InputError(
                f"{path}, line {n}: the image {words[5]!r} has no suffix, but a later word has: separate the "
                "columns by tabs if names have blanks, or put such names between quotes"
            )
        x, y, z, px, py = (_number(w, path, n) for w in words[:5])
        place = (y, x, z) if crs.is_geographic else (x, y, z)  # its x is the longitude
        name = words[6] if len(words) > 6 else by_place.setdefault(place, f"point {len(by_place) + 1}")
        check = len(words) > 7 and words[7].lower() in _CHECK
        _add(points, FilePoint(name=name, xyz=place, sigma_m=SIGMA_M, check=check, line=n), path)
        marks.append(FileMark(name=name, image=words[5], xy=(px, py), line=n))
    return GcpFile(
        path=path,
        crs=crs.srs,
        geographic=crs.is_geographic,
        points=tuple(points.values()),
        marks=tuple(marks),
        notes=say_axes(crs, path.name),
    )


def _number(text: str, path: Path, line: int) -> float:
    value = number(text)
    if not np.isfinite(value):
        raise InputError(f"{path}, line {line}: {text!r:.99} is no number")
    return value


def _read_csv(path: Path, lines: list[tuple[int, str]]) -> GcpFile:
    """The points and marks of one or several tables, each with its header, or of one without."""
    heads = [k for k, (_, line) in enumerate(lines) if line[0] not in "#%" and _is_header(line)] or [0]
    cuts = [0, *heads[1:], len(lines)]
    above = crs_above(lines, path)
    found = GcpFile(path=path, crs=None if above is None else above.srs, geographic=False, points=(), marks=())
    kinds = set()
    for a, b in zip(cuts, cuts[1:]):
        if all(line[0] in "#%" or _is_header(line) for _, line in lines[a:b]):
            continue  # a header without rows says nothing
        table = table_of(path, "control point file", lines[a:b], _EXAMPLE, lambda rows: points_by_content(rows, above))
        if names_bars(table.columns):
            bars, note = read_bars(table)
            found = replace(found, bars=(*found.bars, *bars), notes=(*found.notes, *table.notes, note))
        else:
            found, kind = _with_table(found, table)
            kinds |= kind
    if len(kinds) > 1:
        raise InputError(f"{path}: points by x, y, z in one table and by lat, lon, height in another: give one kind")
    degrees = True in kinds
    return replace(found, crs="EPSG:4979" if found.crs is None and degrees else found.crs, geographic=degrees)


def _with_table(file: GcpFile, table: Table) -> tuple[GcpFile, set[bool]]:
    """A file with a table's points and marks; {whether its coordinates are in degrees}, empty without any."""
    path, notes = table.path, [*file.notes, *table.notes]
    roles, crs = coordinates_of(table, file.crs, notes)
    geographic = "latitude" in roles
    columns = [table.find(role) for role in roles]
    name, image, px, py = (table.find(r) for r in ("name", "image", "pixel x", "pixel y"))
    if image is not None and px is None and py is None and None not in columns[:2] and columns[2] is None:
        px, py, columns = columns[0], columns[1], [None] * 3  # name, image, x, y: of a mark
    found = f"{path}: found the columns {', '.join(table.columns)}"
    whole = [None not in group for group in (columns, (image, px, py))]
    if name is None or not any(whole):
        raise InputError(f"{found}; {FORMS}")
    if not whole[1] and not all(m is None for m in (image, px, py)):
        raise InputError(f"{found}; marks need the three columns image, px and py")
    parsed = None if crs is None else parse_crs_line(crs, str(path))
    units_m = (1.0, 1.0, 1.0) if geographic else units_of(parsed)
    stated = [table.unit_m(c) for c in columns]
    scale = [1.0 if s is None else s / u for s, u in zip(stated, units_m)]
    points, marks = {p.name: p for p in file.points}, list(file.marks)
    angles = [table.angles(c, letters) for c, letters in zip(columns, ("NS", "EW"))] if geographic else []
    for row, (line, _) in enumerate(table.rows):
        label = table.cell(row, name)
        if not label:
            raise InputError(f"{path}, line {line}: the point has no name")
        if whole[0] and any(table.cell(row, c) for c in columns):
            values = [float(a[row]) for a in angles] + [float("nan")] * (3 - len(angles))
            values = [v if v == v else _number(table.plain(row, c), path, line) for v, c in zip(values, columns)]
            place = tuple(s * v for s, v in zip(scale, values))
            sigma_m, check = _row_facts(table, row)
            _add(points, FilePoint(name=label, xyz=place, sigma_m=sigma_m, check=check, line=line), path)  # type: ignore[arg-type]
        if table.cell(row, image):
            xy = _number(table.plain(row, px), path, line), _number(table.plain(row, py), path, line)
            marks.append(FileMark(name=label, image=table.cell(row, image), xy=xy, line=line))
    used = dict(zip(("name", "image", "pixel x", "pixel y", *roles), (name, image, px, py, *columns)))
    if geographic:
        used |= {f"{w} of the Earth": table.half(c, w) for c, w in zip(columns, ("NS", "EW"))}
    facts = (*SIGMAS, "role") if whole[0] else ()
    notes.append(
        table.said({**used, **{r: table.find(r) for r in facts}, **({"crs": table.find("crs")} if crs else {})})
    )
    if whole[0] and parsed is not None and table.columns[columns[0] or 0] == "x":
        notes += say_axes(parsed, path.name)
    made = replace(file, points=tuple(points.values()), marks=tuple(marks), notes=tuple(notes), crs=crs)
    return made, {geographic} if whole[0] else set()


def _add(points: dict[str, FilePoint], new: FilePoint, path: Path) -> None:
    known = points.setdefault(new.name, new)
    for what, before, now in (("place", known.xyz, new.xyz), ("role", known.check, new.check)):
        if before != now:
            said = f"point {new.name!r} has another {what} than in line {known.line}"
            raise InputError(f"{path}, line {new.line}: {said}; rename it, or keep the right one")


def _row_facts(table: Table, row: int) -> tuple[tuple[float, float, float], bool]:
    def sigma(what: str, otherwise: float) -> float:
        column = table.find(what)
        cell = table.cell(row, column)
        if not cell:
            return otherwise
        value = length_m(table.plain(row, column), table.unit_m(column) or 1.0)
        value = value if np.isfinite(value) else _number(cell, table.path, table.line(row))
        if not 0 < value <= MAX_SIGMA_M:
            raise InputError(
                f"{table.where(row)}: {table.columns[column or 0]} = {cell}: a sigma is above 0 and at most "
                f"{MAX_SIGMA_M:g} m; leave the cell empty if it is not known"
            )
        return value

    both = sigma("sigma", SIGMA_M[0])
    flat = sigma("horizontal sigma", max(sigma("sigma to the east", both), sigma("sigma to the north", both)))
    up = sigma("vertical sigma", sigma("sigma", SIGMA_M[2]))
    role = table.cell(row, table.find("role")).lower().replace(" ", "_")
    if role not in (*_CHECK, *_CONTROL):
        raise InputError(f"{table.where(row)}: role {role!r} is neither gcp nor check")
    return (flat, flat, up), role in _CHECK
