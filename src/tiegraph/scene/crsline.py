"""The coordinate system that a line of a table names: the first of ODM's files, a comment above a header."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import utm_by_name

if TYPE_CHECKING:
    import pyproj

_COMMENT = re.compile(
    r"(?i)[#%]\s*(?:crs|coordinate\s?system)?\s*[:=,]?\s*"
    r"(EPSG:\d+(?:\+\d+)?|\+proj.*|WGS\s*84\s*UTM.*|(?:PROJ|GEOG|GEOC|COMPD|BOUND|COMPOUND)\w*\[.*)"
)


def crs_above(lines: Iterable[tuple[int, str]], path: object) -> pyproj.CRS | None:
    """The CRS of the first comment line that names one, as ``# crs: EPSG:6677``, or as Metashape writes it, above a
    table's header. Raises InputError for one that is none."""
    for number, line in lines:
        if line[0] not in "#%":
            break
        if found := _COMMENT.fullmatch(line):
            return parse_crs_line(found[1], f"{path}, line {number}")
    return None


def parse_crs_line(text: str, where: str, more: str = "") -> pyproj.CRS:
    """The CRS that a text names: an EPSG code, a PROJ string, WKT, the name in EPSG's registry, or "WGS84 UTM 54N".

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
        if found is not None and (re.search(r"[:=\[]", bare) or found.name.lower() == bare.lower()):
            return found
        raise pyproj.exceptions.CRSError(bare)
    except pyproj.exceptions.CRSError:
        raise InputError(
            f"{where}: {text!r:.99} is no coordinate system; name one, such as EPSG:32654, WGS84 UTM 54N or +proj=utm "
            f"+zone=54 +datum=WGS84 +units=m{more}"
        ) from None


def north_first(crs: pyproj.CRS) -> bool:
    """Whether the first axis of a grid points north, as surveyors' X does (Germany, Poland, Japan)."""
    return crs.is_projected and crs.axis_info[0].direction.lower() == "north"
