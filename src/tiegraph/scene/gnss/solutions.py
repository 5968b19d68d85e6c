"""Positions with sigmas from other programs: RTKLIB's .pos, Applanix' SBET, DJI's MRK and ROS's fixes.

**RTKLIB** (manual 2.4.2, B.1): columns and time scale by the header. Places are lat, lon, height or ECEF; a
baseline from a station without stated coordinates is refused. Times are dates or week and seconds, of GPS time,
UTC or JST.

**SBET**, smoothed best estimate of trajectory (Applanix POSPac, also written by other INS software): 17 doubles a
record. Time (s of the GPS week), latitude and longitude (rad), altitude (m above the ellipsoid), velocities x, y, z,
roll, pitch, platform heading, wander angle, accelerations x, y, z, angular rates x, y, z; little-endian, without a
header.

**DJI's Timestamp.MRK**, beside the images of a drone with RTK: a row an image, at the centre of its sensor.
``number, seconds of the week, [week], offsets of the antenna (mm) N, E, V, Lat, Lon, Ellh, sigmas N, E, up (m), Q``
(DJI, Phantom 4 RTK; Matrice 4 user manual): the position is already moved from the antenna to the image. Images
are identified by the last number in their names, DJI_0012.JPG or DJI_20240501120000_0012_V.JPG.

**ROS's sensor_msgs/NavSatFix** in a bag: the height is above the ellipsoid, the covariance that of east, north and up.
"""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import enu_axes, geodetic_from_ecef
from tiegraph.scene.bags import open_bag, split_topics, stamp_ns
from tiegraph.scene.cells import degrees, number, parse_time
from tiegraph.scene.gnss.fixes import Gnss
from tiegraph.scene.textfile import decoded, text_lines
from tiegraph.scene.times import GPS_EPOCH_S, WEEK_S, check_week, gps_note, utc_from_gps

_HEADER = re.compile(r"%[ \t]*(GPST|UTC|JST)\b[ \t,;]+(latitude|x-ecef|e-baseline)")
RTKLIB = re.compile(rf"(?m)^[ \t]*{_HEADER.pattern}")
_SPLIT = re.compile(r"[\s,;]+")
_QUALITY = {1: "fixed", 2: "float", 3: "SBAS", 4: "DGPS", 5: "single", 6: "PPP"}


@dataclass(frozen=True)
class _Header:
    """Time scale, columns after the time, and whether degrees are written as degrees, minutes and seconds."""

    line: int
    scale: str
    columns: tuple[str, ...]
    sexagesimal: bool

    def find(self, *names: str) -> list[int]:
        """Columns by name; missing ones are left out."""
        return [self.columns.index(n) for n in names if n in self.columns]


def read_rtklib(path: Path, raw: bytes) -> Gnss:
    """Rows of a solution with their standard deviations.

    Raises InputError, with the line, for baselines, another datum than WGS84, rows of more columns than the header, and
    invalid weeks.
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
    whole = [cells if len(cells) == width else [] for _, cells in rows]  # numbers in a cut-off line are cut off
    table = np.array([_numbers(cells[2:], header) for cells in whole])
    llh, axes = _places(table, header)
    time_s = np.array([_time(path, n, cells) for (n, _), cells in zip(rows, whole)])
    if header.scale == "JST":
        time_s -= 9 * 3600.0
    if header.scale == "GPST":
        time_s = np.where(np.isfinite(time_s), utc_from_gps(np.nan_to_num(time_s) - GPS_EPOCH_S), np.nan)
        notes.append(gps_note(path.name, time_s))
    quality = header.find("q")
    if quality:
        kinds = Counter(_QUALITY.get(int(q), f"Q {q:g}") for q in table[:, quality[0]] if q == q)
        notes.append(f"{path.name}: " + ", ".join(f"{count} {kind}" for kind, count in kinds.most_common()))
    return Gnss(
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
            f"{path}, line {n}: baselines (east, north, up) from a base without coordinates in the rows: write the "
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
    """A note on the heights. Raises InputError for another datum than WGS84."""
    for n, line in comments:
        found = re.search(r"lat/lon/height=([\w-]+)(?:/(\w+))?", line)
        if found and found[1] != "WGS84":
            raise InputError(f"{path}, line {n}: positions on the datum {found[1]}: write the solution on WGS84")
        if found and found[2] == "geodetic":
            return [f"{path.name}: heights above the geoid (out-height = geodetic), used unchanged"]
    return []


def _numbers(cells: list[str], header: _Header) -> list[float]:
    if not cells:
        return [float("nan")] * len(header.columns)
    values = [number(c) for c in cells]
    if not header.sexagesimal:
        return values
    angles = ("{}°{}'{}\"".format(*cells[k : k + 3]) for k in (0, 3))
    return [*(degrees(a)[0] for a in angles), *values[6:]]


def _places(table: np.ndarray, header: _Header) -> tuple[np.ndarray, np.ndarray | None]:
    """(R, 3) lat, lon, height, and for ECEF the axes east, north, up (R, 3, 3) there."""
    if header.columns[0] == "latitude":
        return table[:, header.find("latitude", "longitude", "height")], None
    xyz = table[:, header.find("x-ecef", "y-ecef", "z-ecef")]
    llh = geodetic_from_ecef(xyz)
    return llh, enu_axes(llh[:, 0], llh[:, 1])


def _sigma(table: np.ndarray, header: _Header, axes: np.ndarray | None) -> np.ndarray:
    """(R, 3) standard deviations east, north, up; NaN (3,) if the columns are not there."""
    if axes is None:
        found = header.find("sde", "sdn", "sdu")
        return table[:, found] if len(found) == 3 else np.full(3, np.nan)
    found = header.find("sdx", "sdy", "sdz", "sdxy", "sdyz", "sdzx")
    if len(found) != 6:
        return np.full(3, np.nan)
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


_FIELDS = 17
_RECORD = 8 * _FIELDS
_ENOUGH_S = 0.05  # between rows: the carrier of a camera leaves a straight line by millimetres in that time
_STEP_S = 10.0  # between two records, at most; they are written some 200 times a second


def is_sbet(raw: bytes) -> bool:
    """Whether the first records of a file have times of a week and places on the Earth."""
    records = _records(raw[: 2 * _RECORD])
    if not len(records) or not np.isfinite(records).all():
        return False
    time, lat, lon = records[:, :3].T
    steps = np.diff(time)
    return bool(
        np.all((time >= 0) & (time <= 2 * WEEK_S))
        and np.all((np.abs(lat) <= np.pi / 2) & (np.abs(lon) <= 2 * np.pi))
        and np.all((steps > 0) & (steps <= _STEP_S))
        and np.any(np.abs(records[:, 1:3]) > 1e-6)  # not the tiny numbers that other bytes give
    )


def _records(raw: bytes) -> np.ndarray:
    whole = len(raw) // _RECORD
    return np.frombuffer(raw[: whole * _RECORD], "<f8").reshape(whole, _FIELDS)


def read_sbet(path: Path, raw: bytes) -> Gnss:
    """Records of an SBET file; the week is that of the frames. Raises InputError for a cut-off file."""
    if len(raw) % _RECORD:
        raise InputError(
            f"{path}: {len(raw)} bytes are no whole records of {_RECORD} bytes: the SBET file is cut off; copy it again"
        )
    records = _records(raw).astype(float)
    step = float(np.median(np.diff(records[:, 0]))) if len(records) > 1 else _ENOUGH_S
    every = max(1, round(_ENOUGH_S / step)) if step > 0 else 1
    line = range(1, len(records) + 1, every)
    records = records[::every]
    llh = records[:, 1:4].copy()
    llh[:, :2] = np.degrees(llh[:, :2])
    thinned = f"; of its records one in {every} is used" if every > 1 else ""
    notes = [
        f"{path.name}: an SBET file has seconds of the GPS week and no week: that of the frames' times (UTC) is used; "
        f"its angles are not used{thinned}"
    ]
    return Gnss(path=path, line=line, lat_lon_height=llh, time_s=records[:, 0], notes=notes, period_s=WEEK_S)


MRK = re.compile(r"\s*(\d+)\s+\d+\.\d+\s+\[\d+\]")
_NUMBER = r"([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)"
_THREE = r"\s*,\s*".join([_NUMBER] * 3)
_PLACE = re.compile(rf"{_NUMBER}\s*,\s*Lat\s+{_NUMBER}\s*,\s*Lon\s+{_NUMBER}\s*,\s*Ellh\s+{_THREE}\s+(\d+)\s*,\s*Q")


def read_mrk(path: Path, raw: bytes) -> Gnss:
    """Rows of a Timestamp.MRK, named "#<number>"; those without a position (Q 0; 16 is single, 34 float, 50 fixed) are
    empty.

    Raises InputError, with the line, for an invalid row.
    """
    text, notes = decoded(path, raw, "GNSS file")
    lines = [(n, line) for n, line in enumerate(text_lines(text), start=1) if line.strip()]
    rows, flags = [], []
    for n, line in lines:
        start, place = MRK.match(line), _PLACE.search(line)
        if start is None or place is None:
            raise InputError(
                f"{path}, line {n}: {line.strip()!r:.80} is no row of a Timestamp.MRK: number, seconds, [week], N, E, "
                "V, Lat, Lon, Ellh, three sigmas, Q; is the file cut off? Copy it again, or remove that line"
            )
        values = [float(v) for v in place.groups()[:6]]
        flags.append(int(place[7]))
        rows.append((n, start[1], values if flags[-1] else [np.nan] * 6))
    table = np.array([values for _, _, values in rows])
    fixed = ", ".join(f"{count} of Q {flag}" for flag, count in sorted(Counter(flags).items(), reverse=True))
    return Gnss(
        path=path,
        line=[n for n, _, _ in rows],
        lat_lon_height=table[:, :3],
        time_s=np.full(len(rows), np.nan),
        names=[f"#{int(number)}" for _, number, _ in rows],
        sigma_m=table[:, [4, 3, 5]],
        notes=[*notes, f"{path.name}: positions of the images as DJI gives them, {fixed} (50 = fixed)"],
    )


KINDS = ("sensor_msgs/NavSatFix",)


def read_navsat(path: Path) -> Gnss:
    """The fixes of a bag's only topic of fixes, or of the one behind the path; a line is the number of a message.

    Raises InputError for several topics, none, a damaged bag, and if no message has a fix.
    """
    bag_path, asked = split_topics(path)
    rows, lines, lost = [], [], 0
    with open_bag(bag_path) as bag:
        topic = bag.only(KINDS, asked)
        for number, (fix, received_ns) in enumerate(bag.messages(topic), start=1):
            if fix.status.status == -1:  # NavSatStatus.STATUS_NO_FIX
                lost += 1
                continue
            unknown = fix.position_covariance_type == 0  # COVARIANCE_TYPE_UNKNOWN
            variance = np.full(3, np.nan) if unknown else np.asarray(fix.position_covariance, float)[[0, 4, 8]]
            place = fix.latitude, fix.longitude, fix.altitude
            rows.append((1e-9 * stamp_ns(fix.header, received_ns), *place, *variance))
            lines.append(number)
    if not rows:
        raise InputError(f"{path}: none of the messages of {topic} has a fix (status -1): give another source")
    table = np.array(rows, float)
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(table[:, 4:])
    notes = [f"{bag_path.name}: positions of {topic}"]
    if lost:
        notes[0] += f"; {lost} of them without a fix are left out"
    return Gnss(path=bag_path, line=lines, lat_lon_height=table[:, 1:4], time_s=table[:, 0], sigma_m=sigma, notes=notes)
