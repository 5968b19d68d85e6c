"""Ground control and check points: surveyed places and the pixels where they were marked.

Two forms are read. OpenDroneMap's ``gcp_list.txt``: first line the CRS, then ``x y z px py image [name] [more]``. And
CSV with a header: points (name, x, y, z or lat, lon, height; sigma_xy, sigma_z, role) and marks (name, image, px, py),
in one table with rows of either kind or of both at once, in two tables of one file, or in two files. Pixels count from
the outer corner of the upright image's first pixel: its centre is (0.5, 0.5). A point named as a coded target
(``targets.py``) needs no marks. A CSV may hold scale bars too, or nothing else.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import utm_by_name
from tiegraph.scene.regular import regular
from tiegraph.scene.table import Table, table_of, text_lines
from tiegraph.scene.targets import BAR_FORM, FORM, FileBar, Target, count_of, names_bars, read_bars, target_of
from tiegraph.scene.tuning import ControlTuning

if TYPE_CHECKING:
    import pyproj

MAX_SIGMA_M = 100.0  # no survey of a point is worse: another unit, or a typing error
_CHECK = ("check", "checkpoint", "check_point", "checkpoints", "cp", "chk")
_CONTROL = ("", "gcp", "control", "control_point", "controlpoint")
_NAME = ("name", "point", "gcp", "gcp_name", "label", "id", "point_name", "point_id", "gcp_id", "marker", "target")
_IMAGE = ("image", "file", "filename", "file_name", "image_name", "photo")
_X, _Y, _Z = ("x", "east", "easting", "e", "geo_x"), ("y", "north", "northing", "n", "geo_y"), ("z", "geo_z")
_LAT, _LON = ("lat", "latitude", "lat_deg"), ("lon", "long", "lng", "longitude", "lon_deg")
_HEIGHT = ("height", "h", "alt", "altitude", "elevation", "height_m", *_Z)
_PX = ("px", "im_x", "pixel_x", "x_px", "image_x", "u", "col", "column")
_PY = ("py", "im_y", "pixel_y", "y_px", "image_y", "v", "row")
_TITLE = re.compile(
    r"(?i)\[?\s*(points|marks|gcps?|control points|check points|observations|(?:scale )?bars)\s*\]?\s*:?[,;\s]*"
)
FORMS = (
    "points need the columns name, x, y, z (or name, lat, lon, height; if known sigma_xy, sigma_z, role: gcp or "
    "check), marks name, image, px, py, in one table, in two tables of one file with a header each, or in two files "
    "(--gcp POINTS --marks MARKS); '# crs: EPSG:n' in the first line says the CRS of x, y, z; or give ODM's "
    f"gcp_list.txt. Points named as coded targets need no marks: {FORM}. {BAR_FORM[0].upper()}{BAR_FORM[1:]}"
)
_SIGMA, _SIGMA_XY, _SIGMA_Z = ("sigma", "sigma_m"), ("sigma_xy", "sigma_h", "sigma_xy_m"), ("sigma_z", "sigma_v")


@dataclass(frozen=True)
class FilePoint:
    """A surveyed point as its file gives it: coordinates in ``crs`` (east, north, height or lat, lon, height)."""

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
    marks_path: Path | None = None  # of a file that holds the marks alone
    bars: tuple[FileBar, ...] = ()
    largest_copy: float = 1.0  # of the images, in which marks may have been made, times these

    @property
    def of_marks(self) -> Path:
        """The file the marks stand in."""
        return self.marks_path or self.path

    @property
    def targets(self) -> dict[str, Target]:
        """The coded targets among the points and the ends of the bars, by the names that the file has for them."""
        named = {p.name: target_of(p.name) for p in self.points} | {n: target_of(n) for b in self.bars for n in b.ends}
        return {name: target for name, target in named.items() if target is not None}


def read_gcps(path: Path, tuning: ControlTuning, marks: Path | None = None) -> GcpFile:
    """Read control points of either form; ``marks`` is the file of their marks, if that is one of its own.

    Raises InputError, naming file and line, for an unreadable file, an unknown CRS, numbers that are none, points
    without marks, marks of a point without coordinates, and a name with two places.
    """
    found = _read(Path(path), "--gcp", tuning)
    if marks is not None:
        found = _joined(found, _read(Path(marks), "--marks", tuning))
    if not (found.points or found.bars) or not (found.marks or found.targets):
        there, lacking = ("marks", "points") if not (found.points or found.bars) else ("points", "marks")
        raise InputError(f"--gcp {path}: {there}, but no {lacking} with {_NEED[lacking]}; {FORMS}")
    _check_targets(found)
    names = {p.name for p in found.points} | {n for b in found.bars for n in b.ends}
    lost = next((m for m in found.marks if m.name not in names), None)
    if lost is not None:
        where = f"{found.of_marks}, line {lost.line}"
        there = "the file" if found.marks_path is None else found.path.name
        raise InputError(f"{where}: a mark of point {lost.name!r}, which has no coordinates in {there}")
    said = (*found.notes, *_doubtful(found))
    return replace(found, marks=_once_each(found), notes=said, largest_copy=tuning.largest_copy)


def read_points(path: Path, tuning: ControlTuning) -> GcpFile:
    """Points of a file of either form, marked or not. Raises what ``read_gcps`` raises, but for lacking marks."""
    found = _read(Path(path), "--points", tuning)
    if not found.points:
        raise InputError(f"--points {path}: no points with {_NEED['points']}; {FORMS}")
    return found


def _check_targets(found: GcpFile) -> None:
    """Raise InputError for numbers a family has not, a target by two names, and ends of bars nothing is known of."""
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
        lost = next((n for n in bar.ends if n not in marked and n not in found.targets), None)
        if lost is not None:
            raise InputError(
                f"{found.path}, line {bar.line}: the end {lost!r} of this bar is neither marked nor a coded target; "
                f"{FORM} (--marks gives marks of others)"
            )


_NEED = {"points": "coordinates", "marks": "a pixel in an image"}


def _joined(one: GcpFile, other: GcpFile) -> GcpFile:
    """Points of the one file with the marks of the other, whichever is which."""
    points, marks = (one, other) if one.points or one.bars else (other, one)
    if marks.points or points.marks:
        both = "points" if marks.points else "marks"
        raise InputError(
            f"--gcp {one.path} and --marks {other.path}: both hold {both}; leave --marks away, or keep the points in "
            "the one and the marks in the other"
        )
    return replace(points, marks=marks.marks, marks_path=marks.path, notes=(*points.notes, *marks.notes))


def _read(path: Path, option: str, tuning: ControlTuning) -> GcpFile:
    """The points and marks of a file of either form, as they stand there."""
    try:
        data = regular(path).read_bytes()
    except OSError as error:
        raise InputError(f"{option} {path}: cannot be read ({error.strerror})") from None
    text = data.decode("utf-8-sig", errors="replace")  # a name of a point may be in another encoding
    if "\0" in text:
        raise InputError(f"{option} {path}: no text file in UTF-8; {FORMS}")
    lines = [(k + 1, line.strip()) for k, line in enumerate(text_lines(text)) if line.strip()]
    lines = [(number, line) for number, line in lines if not _TITLE.fullmatch(line)]
    if not lines:
        raise InputError(f"{option} {path}: the file is empty; {FORMS}")
    # The first line that is no comment names columns; the CRS in the first line of the other form does not.
    read = _read_csv if _is_header(next((line for _, line in lines if line[0] not in "#%"), "")) else _read_odm
    return read(path, lines, tuning)


def _once_each(found: GcpFile) -> tuple[FileMark, ...]:
    """The marks without exact repeats. Raises InputError for a point marked at two places of one image."""
    first: dict[tuple[str, str], FileMark] = {}
    for mark in found.marks:
        known = first.setdefault((mark.name, mark.image), mark)
        if known.xy != mark.xy:
            raise InputError(
                f"{found.of_marks}, line {mark.line}: point {mark.name!r} is marked in {mark.image!r} at {mark.xy}, "
                f"but in line {known.line} at {known.xy}: leave the right one"
            )
    return tuple(first.values())


def _doubtful(found: GcpFile) -> list[str]:
    """What is odd about a file and yet can be used."""
    name, notes = found.path.name, []
    repeats = len(found.marks) - len({(m.name, m.image) for m in found.marks})
    if repeats:
        notes.append(f"{found.of_marks.name}: {repeats} marks are given twice; once each is used")
    first: dict[tuple[float, ...], FilePoint] = {}
    for point in found.points:
        known = first.setdefault(point.xyz, point)
        if known is not point:
            notes.append(
                f"{name}, line {point.line}: point {point.name!r} is at the very place of {known.name!r} in line "
                f"{known.line}: one point by two names?"
            )
    return notes


def _is_header(line: str) -> bool:
    return _names_columns(line) or names_bars(line)


def _names_columns(line: str) -> bool:
    words = {re.sub(r"[^a-z0-9_]+", "", w) for w in re.split(r"[,;\t ]+", line.lower())}
    known = {*_NAME, *_IMAGE, *_X, *_Y, *_HEIGHT, *_LAT, *_LON, *_PX, *_PY}
    return len(words & known) >= 3 and "+proj" not in line


# --- OpenDroneMap ---------------------------------------------------------------------------------------------------


def _read_odm(path: Path, lines: list[tuple[int, str]], tuning: ControlTuning) -> GcpFile:
    crs = parse_crs_line(lines[0][1], f"{path}, line {lines[0][0]}")
    points: dict[str, FilePoint] = {}
    by_place: dict[tuple[float, ...], str] = {}
    marks = []
    for number, line in lines[1:]:
        if line[0] in "#%":
            continue
        words = [w.strip() for w in line.split("\t")] if line.count("\t") >= 5 else line.split()
        if len(words) < 6:
            raise InputError(f"{path}, line {number}: expected x y z px py image [name], got {line!r}")
        x, y, z, px, py = (_number(w, path, number) for w in words[:5])
        place = (y, x, z) if crs.is_geographic else (x, y, z)  # its x is the longitude
        name = words[6] if len(words) > 6 else by_place.setdefault(place, f"point {len(by_place) + 1}")
        check = len(words) > 7 and words[7].lower() in _CHECK
        _add(points, FilePoint(name=name, xyz=place, sigma_m=tuning.sigma_m, check=check, line=number), path)
        marks.append(FileMark(name=name, image=words[5], xy=(px, py), line=number))
    return GcpFile(
        path=path, crs=crs.srs, geographic=crs.is_geographic, points=tuple(points.values()), marks=tuple(marks)
    )


def parse_crs_line(text: str, where: str) -> pyproj.CRS:
    """The CRS of an ODM header: an EPSG code, a PROJ string, WKT, or "WGS84 UTM 54N". Raises InputError."""
    import pyproj

    bare = text.strip().lstrip("#").strip()
    zones = utm_by_name(bare)
    try:
        if len(zones) == 1:
            return pyproj.CRS.from_user_input(zones[0])
        found = pyproj.CRS.from_user_input(bare) if re.match(r"[A-Za-z+]", bare) else None
        # PROJ takes the CRS with the most similar name for any word: only a name written out is meant
        if found is not None and (re.search(r"[:=\[]", bare) or found.name.lower() == bare.lower()):
            return found
        raise pyproj.exceptions.CRSError(bare)
    except pyproj.exceptions.CRSError:
        raise InputError(
            f"{where}: {text!r:.99} is no coordinate system; the first line of a gcp_list.txt is one, such as "
            "EPSG:32654, WGS84 UTM 54N or +proj=utm +zone=54 +datum=WGS84 +units=m; that of a CSV is a header: "
            f"{FORMS}"
        ) from None


def _number(text: str, path: Path, line: int) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(f"{path}, line {line}: {text!r:.99} is no number")
    return value


# --- CSV ------------------------------------------------------------------------------------------------------------


def _read_csv(path: Path, lines: list[tuple[int, str]], tuning: ControlTuning) -> GcpFile:
    """The points and marks of one table or several, each begun by its header."""
    heads = [k for k, (_, line) in enumerate(lines) if line[0] not in "#%" and _is_header(line)]
    cuts = [0, *heads[1:], len(lines)]
    tables = [
        table_of(path, "control point file", lines[a:b])
        for a, b in zip(cuts, cuts[1:])
        if any(line[0] not in "#%" for _, line in lines[max(a, heads[0]) + 1 : b])  # a header without rows says nothing
    ]
    points: dict[str, FilePoint] = {}
    marks: list[FileMark] = []
    bars: list[FileBar] = []
    geographic = set()
    crs = _csv_crs(lines, path)
    units_m = _units_m(crs, path)
    for table in tables:
        if names_bars(" ".join(table.columns)):
            bars += read_bars(table, tuning)
        else:
            geographic |= _read_table(table, points, marks, tuning, units_m)
    if len(geographic) > 1:
        raise InputError(f"{path}: points by x, y, z in one table and by lat, lon, height in another: give one kind")
    degrees = True in geographic
    notes = tuple(note for table in tables for note in table.notes)
    return GcpFile(
        path=path,
        crs="EPSG:4979" if crs is None and degrees else crs,
        geographic=degrees,
        points=tuple(points.values()),
        marks=tuple(marks),
        notes=notes,
        bars=tuple(bars),
    )


def _read_table(
    table: Table, points: dict[str, FilePoint], marks: list[FileMark], tuning: ControlTuning, units_m: Sequence[float]
) -> set[bool]:
    """Add a table's points and marks; {whether its coordinates are in degrees}, empty without any. Coordinates become
    those of their CRS, whose axes have ``units_m``."""
    path = table.path
    geographic = table.find(_LAT) is not None and table.find(_LON) is not None
    columns = [table.find(a) for a in ((_LAT, _LON, _HEIGHT) if geographic else (_X, _Y, _HEIGHT))]
    name, image, px, py = (table.find(a) for a in (_NAME, _IMAGE, _PX, _PY))
    if image is not None and px is None and py is None and None not in columns[:2] and columns[2] is None:
        px, py, columns = columns[0], columns[1], [None] * 3  # name, image, x, y: of a mark
    found = f"{path}: found the columns {', '.join(table.columns)}"
    whole = [None not in group for group in (columns, (image, px, py))]
    if name is None or not any(whole):
        raise InputError(f"{found}; {FORMS}")
    if not whole[1] and not all(m is None for m in (image, px, py)):
        raise InputError(f"{found}; marks need the three columns image, px and py")
    stated = [table.unit_m(c) for c in columns]
    scale = [1.0 if s is None else s / u for s, u in zip(stated, (1.0, 1.0, 1.0) if geographic else units_m)]
    for row, (line, _) in enumerate(table.rows):
        label = table.cell(row, name)
        if not label:
            raise InputError(f"{path}, line {line}: the point has no name")
        if whole[0] and any(table.cell(row, c) for c in columns):
            place = tuple(s * _number(table.cell(row, c), path, line) for c, s in zip(columns, scale))
            sigma_m, check = _row_facts(table, row, tuning)
            point = FilePoint(name=label, xyz=place, sigma_m=sigma_m, check=check, line=line)  # type: ignore[arg-type]
            _add(points, point, path)
        if table.cell(row, image):
            xy = _number(table.cell(row, px), path, line), _number(table.cell(row, py), path, line)
            marks.append(FileMark(name=label, image=table.cell(row, image), xy=xy, line=line))
    return {geographic} if whole[0] else set()


def _add(points: dict[str, FilePoint], new: FilePoint, path: Path) -> None:
    known = points.setdefault(new.name, new)
    for what, before, now in (("place", known.xyz, new.xyz), ("role", known.check, new.check)):
        if before != now:
            said = f"point {new.name!r} has another {what} than in line {known.line}"
            raise InputError(f"{path}, line {new.line}: {said}; name it otherwise, or leave the right one")


def _row_facts(table: Table, row: int, tuning: ControlTuning) -> tuple[tuple[float, float, float], bool]:
    def number(aliases: tuple[str, ...], otherwise: float) -> float:
        column = table.find(aliases)
        cell = table.cell(row, column)
        if not cell:
            return otherwise
        value = _number(cell, table.path, table.rows[row][0]) * (table.unit_m(column) or 1.0)
        if not 0 < value <= MAX_SIGMA_M:
            raise InputError(
                f"{table.path}, line {table.rows[row][0]}: {aliases[0]} = {cell}: a sigma is above 0 and at most "
                f"{MAX_SIGMA_M:g} m; leave the cell empty if it is not known"
            )
        return value

    flat = number(_SIGMA_XY, number(_SIGMA, tuning.sigma_m[0]))
    up = number(_SIGMA_Z, number(_SIGMA, tuning.sigma_m[2]))
    role = table.cell(row, table.find(("role", "type", "kind"))).lower().replace(" ", "_")
    if role not in (*_CHECK, *_CONTROL):
        raise InputError(f"{table.path}, line {table.rows[row][0]}: role {role!r} is neither gcp nor check")
    return (flat, flat, up), role in _CHECK


def _units_m(crs: str | None, path: Path) -> tuple[float, float, float]:
    """Metres of the units of east, north and height of a CRS, in that of east where it has no heights."""
    parsed = None if crs is None else parse_crs_line(crs, str(path))
    if parsed is None or not parsed.is_projected:
        return (1.0, 1.0, 1.0)
    axes = [a.unit_conversion_factor for a in parsed.axis_info]
    return (axes[0], axes[1], axes[2] if len(axes) > 2 else axes[0])


def _csv_crs(lines: list[tuple[int, str]], path: Path) -> str | None:
    """A comment line ``# crs: EPSG:n`` before the header."""
    for number, line in lines:
        if line[0] not in "#%":
            break
        named = re.fullmatch(r"[#%]\s*(?:crs\s*[:=]?\s*)?(EPSG:\d+(?:\+\d+)?|\+proj.*|WGS\s*84\s*UTM.*)", line, re.I)
        if named:
            return parse_crs_line(named[1], f"{path}, line {number}").srs
    return None
