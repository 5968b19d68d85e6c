"""RTKLIB's solution files (.pos): columns and time scale as the header names them (RTKLIB manual 2.4.2, B.1).

Places are lat, lon, height or ECEF; a baseline from a station whose place the file does not say is refused. Times are
dates or week and seconds, of GPS time, UTC or JST.
"""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import enu_axes, geodetic_from_ecef
from tiegraph.scene.cells import number, parse_time
from tiegraph.scene.gnss.fixes import Fixes
from tiegraph.scene.gpstime import GPS_EPOCH_S, WEEK_S, check_week, utc_from_gps
from tiegraph.scene.textfile import decoded, text_lines
from tiegraph.scene.timecolumns import gps_note

_HEADER = re.compile(r"%[ \t]*(GPST|UTC|JST)\b[ \t,;]+(latitude|x-ecef|e-baseline)")
_ANY_HEADER = re.compile(rf"(?m)^[ \t]*{_HEADER.pattern}")
_SPLIT = re.compile(r"[\s,;]+")
_QUALITY = {1: "fixed", 2: "float", 3: "SBAS", 4: "DGPS", 5: "single", 6: "PPP"}


@dataclass(frozen=True)
class _Header:
    """Time scale, columns after the time, and whether degrees stand as degrees, minutes and seconds."""

    line: int
    scale: str
    columns: tuple[str, ...]
    sexagesimal: bool

    def find(self, *names: str) -> list[int]:
        """Columns by name; those that are not there are left out."""
        return [self.columns.index(n) for n in names if n in self.columns]


def is_rtklib(text: str, raw: bytes) -> bool:
    """Whether the header of a solution stands in the first lines of a file."""
    return bool(_ANY_HEADER.search(text))


def read_rtklib(path: Path, raw: bytes) -> Fixes:
    """Rows of a solution with their standard deviations.

    Raises InputError, with the line, for baselines, another datum than WGS84, rows of more columns than the header, and
    weeks that are none.
    """
    text, notes = decoded(path, raw, "GNSS file")
    lines = [(n, line.strip()) for n, line in enumerate(text_lines(text), start=1) if line.strip()]
    comments = [(n, line) for n, line in lines if line.startswith("%")]
    header = _header(path, comments)
    notes += _heights(path, comments)
    rows = [(n, _SPLIT.split(line.strip(",;"))) for n, line in lines if not line.startswith("%") and n > header.line]
    if not rows:
        raise InputError(f"{path}: no rows below its header; process the observations again")
    width = 2 + len(header.columns) + 4 * header.sexagesimal
    long = next(((n, cells) for n, cells in rows if len(cells) > width), None)
    if long is not None:
        raise InputError(
            f"{path}, line {long[0]}: {len(long[1])} columns, but the header in line {header.line} names {width}: are "
            "these two solutions in one file? Give one"
        )
    whole = [cells if len(cells) == width else [] for _, cells in rows]  # a line that is cut off has cut off numbers
    table = np.array([_numbers(cells[2:], header) for cells in whole])
    llh, axes = _places(table, header)
    time_s = np.array([_time(path, n, cells) for (n, _), cells in zip(rows, whole)])
    time_s = _utc(time_s, header.scale)
    if header.scale == "GPST":
        notes.append(gps_note(path.name, time_s))
    quality = header.find("q")
    if quality:
        kinds = Counter(_QUALITY.get(int(q), f"Q {q:g}") for q in table[:, quality[0]] if q == q)
        notes.append(f"{path.name}: " + ", ".join(f"{count} {kind}" for kind, count in kinds.most_common()))
    return Fixes(
        path=path,
        line=[n for n, _ in rows],
        lat_lon_height=llh,
        time_s=time_s,
        sigma_m=_sigma(table, header, axes),
        notes=notes,
    )


def _header(path: Path, comments: list[tuple[int, str]]) -> _Header:
    n, line = next((n, line) for n, line in comments if _HEADER.match(line))
    scale, *columns = _SPLIT.split(line.lstrip("% "))
    if columns[0].startswith("e-baseline"):
        raise InputError(
            f"{path}, line {n}: baselines (east, north, up) from a base whose place the rows do not give: write the "
            "solution as lat/lon/height (out-solformat = llh)"
        )
    names = tuple(re.sub(r"\(.*", "", c).lower() for c in columns)
    needed = ("x-ecef", "y-ecef", "z-ecef") if names[0] == "x-ecef" else ("latitude", "longitude", "height")
    if missing := [c for c in needed if c not in names]:
        raise InputError(
            f"{path}, line {n}: the header has no column {', '.join(missing)}; found: {', '.join(names)}: correct it, "
            "or process the observations again"
        )
    return _Header(line=n, scale=scale, columns=names, sexagesimal="(d'" in columns[0])


def _heights(path: Path, comments: list[tuple[int, str]]) -> list[str]:
    """What to say of the heights. Raises InputError for another datum than WGS84."""
    for n, line in comments:
        found = re.search(r"lat/lon/height=([\w-]+)(?:/(\w+))?", line)
        if found and found[1] != "WGS84":
            raise InputError(f"{path}, line {n}: positions on the datum {found[1]}: write the solution on WGS84")
        if found and found[2] == "geodetic":
            return [f"{path.name}: heights above the geoid (out-height = geodetic), taken as they are"]
    return []


def _numbers(cells: list[str], header: _Header) -> list[float]:
    if not cells:
        return [float("nan")] * len(header.columns)
    values = [number(c) for c in cells]
    if not header.sexagesimal:
        return values
    return [_degrees(cells[:3]), _degrees(cells[3:6]), *values[6:]]


def _degrees(cells: list[str]) -> float:
    degrees, minutes, seconds = (number(c) for c in cells)
    size = abs(degrees) + minutes / 60 + seconds / 3600
    return -size if cells[0].startswith("-") else size


def _places(table: np.ndarray, header: _Header) -> tuple[np.ndarray, np.ndarray | None]:
    """(R, 3) lat, lon, height, and of ECEF the axes east, north, up (R, 3, 3) there."""
    if header.columns[0] == "latitude":
        return table[:, header.find("latitude", "longitude", "height")], None
    xyz = table[:, header.find("x-ecef", "y-ecef", "z-ecef")]
    llh = geodetic_from_ecef(xyz)
    return llh, enu_axes(llh[:, 0], llh[:, 1])


def _sigma(table: np.ndarray, header: _Header, axes: np.ndarray | None) -> np.ndarray | None:
    """(R, 3) standard deviations east, north, up; None if the columns are not there.

    Covariances stand as the roots of their sizes with their signs.
    """
    if axes is None:
        found = header.find("sde", "sdn", "sdu")
        return table[:, found] if len(found) == 3 else None
    found = header.find("sdx", "sdy", "sdz", "sdxy", "sdyz", "sdzx")
    if len(found) != 6:
        return None
    xx, yy, zz, xy, yz, zx = (np.sign(table[:, found]) * table[:, found] ** 2).T
    covariance = np.stack([np.stack(r, -1) for r in ((xx, xy, zx), (xy, yy, yz), (zx, yz, zz))], axis=1)
    return np.sqrt(np.clip(np.einsum("rij,rjk,rik->ri", axes, covariance, axes), 0.0, None))


def _time(path: Path, n: int, cells: list[str]) -> float:
    """Seconds since 1970 by the calendar or the weeks of the file, in its scale."""
    if not cells:
        return float("nan")
    if "/" in cells[0] or "-" in cells[0]:
        return parse_time(f"{cells[0]} {cells[1]}")
    week, seconds = number(cells[0]), number(cells[1])
    if not (week == week and 0 <= seconds <= WEEK_S):
        return float("nan")
    check_week(week, f"{path}, line {n}")
    return GPS_EPOCH_S + week * WEEK_S + seconds


def _utc(time_s: np.ndarray, scale: str) -> np.ndarray:
    if scale == "GPST":
        return np.where(np.isfinite(time_s), utc_from_gps(np.nan_to_num(time_s) - GPS_EPOCH_S), np.nan)
    return time_s - 9 * 3600.0 if scale == "JST" else time_s
