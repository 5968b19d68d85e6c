"""The coordinate system named in a line of a table: the first of ODM's files, a comment above a header."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import utm_by_name, within_area
from tiegraph.scene.table import Table

if TYPE_CHECKING:
    import pyproj

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
    if not (crs.is_projected and crs.axis_info[0].direction.lower() == "north"):
        return ()
    return (
        f"{name}: X of {crs.name} is the northing, but x is read as the easting and y as the northing; if x is the "
        "northing here, give a CSV whose header says northing and easting",
    )


def units_of(crs: pyproj.CRS | None) -> tuple[float, float, float]:
    """Metres of the units of east, north and height of a grid, in that of east if it has no heights."""
    if crs is None or not crs.is_projected:
        return (1.0, 1.0, 1.0)
    axes = [a.unit_conversion_factor for a in crs.axis_info]
    return (axes[0], axes[1], axes[2] if len(axes) > 2 else axes[0])


def exchanged(crs: str, places: np.ndarray) -> int | None:
    """Index of the first of places (N, 2), latitude and longitude or east and north of a grid, that must be
    exchanged: latitudes above 90, or outside the grid's area of use."""
    import pyproj

    if pyproj.CRS.from_user_input(crs).is_geographic:
        bad = np.abs(places[:, 0]) > 90
    else:
        bad = within_area(crs, places[:, ::-1]) & ~within_area(crs, places)
    return int(np.flatnonzero(bad)[0]) if bad.any() else None


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
