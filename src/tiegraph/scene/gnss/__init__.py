"""Positions of a receiver from common files: one table of formats, one form of the result.

A format is recognised by the contents of the file, never by its suffix: a ``.txt`` may be NMEA, ODM's geo.txt or a
CSV. Each has a reader that returns its rows (``fixes.Gnss``); usable rows are selected for all formats alike
(``fixes.judged``).

Sentences of NMEA and tracks of GPX are read here and not by pynmeagps and gpxpy: errors name the line in the file,
which these do not know, and one damaged sentence ends no log. The tests write files with both.

Times become seconds since 1970, UTC, if the format defines them: GPS time loses its leap seconds, seconds of a
GPS week need the week. If a file names no day or week (NMEA without RMC and ZDA, SBET), its rows get the day
or week of the frames (``fixes.on_clock_of``). A CSV's column ``time`` is of the clock of the frames, whatever that is.

Heights are above the ellipsoid. NMEA's are above the geoid and include the undulation, which is added; formats with
heights above the sea and no undulation (GPX, KML, RTKLIB's geodetic heights) are used unchanged, with a note.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import geodetic_from_crs
from tiegraph.scene.bags import is_bag
from tiegraph.scene.cells import SIGMAS, geotxt, is_file, positions
from tiegraph.scene.gnss import solutions, tracks
from tiegraph.scene.gnss.fixes import EMPTY, HEIGHTS_M, SIGMA_RANGE_M, Gnss, above_ellipsoid, judged
from tiegraph.scene.table import Table, table_of
from tiegraph.scene.textfile import crs_above, decoded, filled_lines, parse_crs_line, say_axes, units_of, whole_file
from tiegraph.scene.times import times_of

if TYPE_CHECKING:
    import pyproj

_HEAD = 1 << 16  # bytes for recognising a format
_CRS = re.compile(r"(?i)EPSG:\d+(?:\+\d+)?$|\+(?:proj|init)=|WGS\s*84\s*UTM\s*\d+\s*[NS]$")
_GCP = re.compile(r"[-+.\d]+(?:\s+[-+.\d]+){4}\s+\S+")
_SEA = re.compile("msl|asl|geoid|ortho|egm|navd|標高")  # in the name or unit of heights above the sea
_TILT = ("pitch", "roll", "omega", "phi")  # any column with such a word


def read_columns(path: Path, raw: bytes) -> Gnss:
    """Rows of a table with the columns time (or image), lat, lon, height, and if there: sigma or sigma_h and sigma_v,
    heading. Below a line ``# crs: EPSG:n`` places may be east, north, height of that grid.

    Times are as ``scene.times`` reads them, lengths in the unit of their header. Raises InputError naming the
    columns found if one is missing, and for angles in radians.
    """
    text, doubts = decoded(path, raw, "GNSS file")
    lines = filled_lines(text)
    table = table_of(path, "GNSS file", lines, "time,lat,lon,height or image,lat,lon,height", positions, doubts)
    return _fixes(table, crs_above(lines, path))


def _stated(text: str) -> Iterator[tuple[int, str]]:
    return ((n, line) for n, line in filled_lines(text) if not line.startswith("#"))


def read_geotxt(path: Path, raw: bytes) -> Gnss:
    """Rows of ODM's geo.txt: first line the CRS, then image x y [z] [yaw pitch roll] [sigma_h sigma_v] [more].

    Raises InputError for an unknown CRS, a place outside it, no rows, and for a list of control points.
    """
    text, doubts = decoded(path, raw, "GNSS file")
    (n, first), *lines = _stated(text)
    crs = parse_crs_line(first, f"{path}, line {n}")
    control = next((n for n, line in lines if _GCP.match(line)), None)
    if control is not None:
        raise InputError(
            f"{path}, line {control}: x y z px py image, as in a gcp_list.txt: give control points by --gcp"
        )
    return _fixes(table_of(path, "GNSS file", lines, "image x y z", geotxt, doubts), crs)


def _fixes(table: Table, crs: pyproj.CRS | None) -> Gnss:
    notes, column, image = list(table.notes), table.find("name"), table.find("image")
    if image is None and (is_file(table.cell(0, column)) or times_of(table) is None):
        image = column  # of names or labels, if these are files, or there are no times
    times = times_of(table) if image is None else None
    llh, used = _places(table, crs, [] if image is not None or times is not None else ["time (or image)"], notes)
    sigma = _sigma(table, notes)
    heading, turned = _heading(table, notes)
    what = (("latitude", "northing"), ("longitude", "easting"), ("height", "ellipsoidal height"))
    columns = {a: used.get(a, used.get(b)) for a, b in what}
    used |= {"image": image, **(times.used if times else {}), **turned, **{s: table.find(s) for s in SIGMAS}}

    def text_of(row: int, what: str) -> str:
        if what == "time":
            return table.cell(row, times.column if times else None)
        if what == "accuracy":  # the one that shows that a row has no position
            sigmas = [c for s in SIGMAS if (c := table.find(s)) is not None]
            return table.cell(row, next((c for c in sigmas if table.metres(c)[row] > SIGMA_RANGE_M[1]), None))
        return table.cell(row, columns[what])

    return Gnss(
        path=table.path,
        line=[line for line, _ in table.rows],
        lat_lon_height=llh,
        time_s=np.full(len(table.rows), np.nan) if times is None else times.seconds,
        names=[table.cell(k, image) for k in range(len(table.rows))] if image is not None else (),
        sigma_m=sigma,
        heading_deg=heading,
        notes=[*notes, table.said(used), *(times.notes if times else ())],
        period_s=times.period_s if times else 0.0,
        text=text_of,
    )


def _places(
    table: Table, crs: pyproj.CRS | None, missing: list[str], notes: list[str]
) -> tuple[np.ndarray, dict[str, int | None]]:
    """(R, 3) latitude, longitude, height, and their columns, the first three in this order."""
    grid = crs if crs is not None and table.find("easting") is not None else None
    roles = ["latitude", "longitude", "height"] if grid is None else ["easting", "northing", "height"]
    if grid is None and table.find("ellipsoidal height") is not None:
        roles[2] = "ellipsoidal height"
    found = [table.find(role) for role in roles]
    missing += [n for n, c in zip(("lat", "lon", "height"), found) if c is None]
    if missing:
        raise InputError(
            f"{table.path}: no column {', '.join(missing)}; found: {', '.join(table.columns)}. Expected: time or "
            "image, lat, lon, height (below a line '# crs: EPSG:n' also easting, northing, height), and optionally "
            "sigma or sigma_h and sigma_v (metres), heading; a table of times may have gps_week and gps_sow, "
            "gps_seconds, or time_ns instead of time. Write these names into its first line"
        )
    if grid is None:
        halves = {f"{w} of the Earth": table.half(c, w) for c, w in zip(found, ("NS", "EW"))}
        angles = [table.angles(c, w) for c, w in zip(found, ("NS", "EW"))]
        height = table.metres(found[2])
        if _SEA.search(f"{table.columns[found[2] or 0]} {table.unit(found[2])}"):
            notes += above_ellipsoid(table.path, height, np.full(len(height), np.nan))[1]
        return np.stack([*angles, height], axis=1), {**dict(zip(roles, found)), **halves}
    scale = [(table.unit_m(c) or u) / u for c, u in zip(found, units_of(grid))]
    xyz = np.stack([s * table.numbers(c) for c, s in zip(found, scale)], axis=1)
    notes += say_axes(grid, table.path.name) if table.columns[found[0] or 0] == "x" else ()
    return _geodetic(grid, xyz, table), dict(zip(roles, found))


def _geodetic(crs: pyproj.CRS, xyz: np.ndarray, table: Table) -> np.ndarray:
    """(R, 3) latitude, longitude, height of x (east), y (north), z (R, 3) in a CRS; NaN = no height."""
    x, y, z = xyz.T
    out = geodetic_from_crs(np.stack([x, y, np.nan_to_num(z)], axis=1), crs.srs)
    bad = np.flatnonzero(np.isfinite(x + y) & ~np.isfinite(out[:, :2]).all(axis=1))
    if crs.is_geographic:
        bad = np.flatnonzero((np.abs(y) > 90) | (np.abs(x) > 360))
    if len(bad):
        k = int(bad[0])
        swapped = "latitude and longitude exchanged (x is the longitude), or " if crs.is_geographic else ""
        raise InputError(
            f"{table.where(k)}: x {x[k]:.10g}, y {y[k]:.10g} lies outside {crs.name}: {swapped}another CRS? "
            "Correct the line that names it"
        )
    out[np.isnan(z), 2] = np.nan
    return out


def _sigma(table: Table, notes: list[str]) -> np.ndarray:
    """(R, 3) sigmas in metres, NaN = not given; one that is too large stays, and marks a row without a position."""

    def column(role: str) -> np.ndarray:
        found = table.find(role)
        values = table.metres(found)
        remedy = "no standard deviation in metres: taken as not given"
        return _believed(table, found, values, values >= SIGMA_RANGE_M[0], notes, remedy)

    flat, both, east, north, up = (column(s) for s in SIGMAS)
    flat = np.where(np.isnan(flat), both, flat)
    return np.stack([np.where(np.isnan(s), flat, s) for s in (east, north)] + [up], axis=1)


def _heading(table: Table, notes: list[str]) -> tuple[np.ndarray, dict[str, int | None]]:
    """(R,) headings, and their columns."""
    found = table.find("heading")
    values = table.angles(found)
    lat = table.find("latitude")  # its name may be phi
    tilted = [k for k, c in enumerate(table.columns) if k != lat and set(c.split("_")) & set(_TILT)]
    if found is not None and tilted:
        most = max(float(np.nanmax(np.abs((table.angles(k) + 180) % 360 - 180), initial=0)) for k in tilted)
        if most > 20.0:  # for a body tilted by more, yaw in a table of yaw, pitch and roll is no heading
            notes.append(
                f"{table.path.name}: {', '.join(table.columns[k] for k in (found, *tilted))}: cameras tilted by up to "
                f"{most:.0f} degrees: these angles are not used, the images give the attitudes"
            )
            return np.full(len(values), np.nan), {}
    good = _believed(table, found, values, np.abs(values) <= 360, notes, "no angle in degrees: not used")
    return good, {"heading": found, **{f"tilt {n}": k for n, k in enumerate(tilted, start=1) if found is not None}}


def _believed(
    table: Table, column: int | None, values: np.ndarray, good: np.ndarray, notes: list[str], remedy: str
) -> np.ndarray:
    """(R,) values that are good, NaN for the others; those that are neither good nor empty are noted."""
    if column is None:
        return values
    odd = [k for k in np.flatnonzero(~good).tolist() if table.cell(k, column).lower() not in EMPTY]
    if odd:
        notes.append(
            f"{table.path.name}, line {table.line(odd[0])}: {table.columns[column]!r} {table.cell(odd[0], column)!r} "
            f"is {remedy}, as in {len(odd)} of {len(values)} rows"
        )
    return np.where(good, values, np.nan)


FORMATS: dict[str, tuple[Callable[[str, bytes], object], Callable[[Path, bytes], Gnss]]] = {
    "GPX": (lambda text, raw: tracks.GPX.match(text), tracks.read_gpx),
    "KML": (lambda text, raw: tracks.is_zip(raw) or tracks.KML.match(text), tracks.read_kml),
    "SBET": (lambda text, raw: solutions.is_sbet(raw), solutions.read_sbet),
    "RTKLIB": (lambda text, raw: solutions.RTKLIB.search(text), solutions.read_rtklib),
    "DJI MRK": (lambda text, raw: solutions.MRK.match(text), solutions.read_mrk),
    "ODM geo.txt": (lambda text, raw: _CRS.match(next(_stated(text), (0, ""))[1]), read_geotxt),
    "NMEA 0183": (lambda text, raw: tracks.NMEA.search(raw), tracks.read_nmea),
    "CSV": (lambda text, raw: True, read_columns),
}
"""For each format a test whether the first bytes of a file, as text and as bytes, are of it, and its reader.
The first that fits is used."""


def read_gnss(path: Path, heights_m: tuple[float, float] = HEIGHTS_M) -> Gnss:
    """Read positions of any of ``FORMATS``, or of a ROS bag (of a topic of one: ``scene.bags``); ``heights_m``: range
    of plausible heights.

    Rows without a usable position are left out and noted with their lines. Raises InputError, naming file and line, if
    the file cannot be read, is damaged, or has no usable row.
    """
    if is_bag(Path(path)):
        return judged(solutions.read_navsat(Path(path)), heights_m)
    raw = whole_file(Path(path), "give the GNSS file as a CSV file")
    utf16 = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    head = raw[:_HEAD].decode("utf-16" if utf16 else "utf-8-sig", errors="replace")
    read = next(read for told, read in FORMATS.values() if told(head, raw[:_HEAD]))
    return judged(read(Path(path), raw), heights_m)
