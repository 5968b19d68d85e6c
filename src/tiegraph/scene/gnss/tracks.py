"""Tracks of receivers and telephones: sentences of NMEA 0183, GPX, KML.

**NMEA**: GGA has place and time of day, RMC or ZDA the date, GST the standard deviations. Other sentences, and
binary messages between them, are skipped; damaged sentences are recognised by their checksums and noted.

**GPX** tracks, **KML** tracks (gx:Track) and KML placemarks named as images, packed (KMZ) or not. Heights of both are
above the sea by their specifications, in GPX with the undulation (geoidheight) if a program writes it. Times are
UTC.
"""

import io
import re
import zipfile
import zlib
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.cells import number, parse_time, seconds_of
from tiegraph.scene.gnss.fixes import Gnss, above_ellipsoid
from tiegraph.scene.textfile import parse_xml
from tiegraph.scene.times import DAY_S, going_on

# What the first bytes of a file contain
GPX, KML = (re.compile(rf"(?s)\s*<(?:.*?<)?(?:\w+:)?{root}[\s>]") for root in ("gpx", "kml"))
NMEA = re.compile(rb"(?m)^[^<\r\n]{0,64}\$[A-Z]{2}(?:GGA|RMC|ZDA|GST|GNS|GLL|GSA|GSV|VTG),")
_SENTENCE = re.compile(rb"\$([A-Z]{2}(GGA|RMC|ZDA|GST),[^$*]*)(\*[0-9A-Fa-f]{2})?\s*$")
_FIXES = {"1": "single", "2": "differential", "3": "PPS", "4": "RTK fixed", "5": "RTK float", "6": "dead reckoning",
          "7": "manual", "8": "simulated"}  # fmt: skip
_NAN = float("nan")
_BY_WORTH = "0876129354"  # kinds of fix, the best last: some receivers write PPS for PPP


@dataclass
class _Log:
    """The contents of a file's sentences, in their order."""

    rows: list[tuple[int, list[str]]] = field(default_factory=list)  # line and cells of a GGA
    dates: list[tuple[int, float, float]] = field(default_factory=list)  # rows before it, second of the day, its day
    sigma: dict[int, list[float]] = field(default_factory=dict)  # east, north, up of a row
    damaged: list[tuple[int, str]] = field(default_factory=list)  # line and sentence
    talkers: int = 0  # GGA sentences of an epoch that has one already

    def date(self, time: str, day: str) -> None:
        """``day`` as ddmmyyyy; an invalid one counts as missing."""
        second, midnight = _second(time), seconds_of(day, "%d%m%Y")
        if second == second and midnight == midnight:
            self.dates.append((len(self.rows), second, midnight))


def read_nmea(path: Path, raw: bytes) -> Gnss:
    """The GGA sentences of a log; heights are above the ellipsoid by their own undulation.

    Without RMC and ZDA times are those of the day. Raises InputError for no GGA, none that is whole, and heights that
    are not in metres.
    """
    log = _read(raw)
    if not log.rows:
        if log.damaged:
            n, text = log.damaged[0]
            raise InputError(
                f"{path}, line {n}: {text!r:.80} has no or a wrong checksum, as have all {len(log.damaged)} sentences "
                "with positions, times and dates: was the file edited or cut off? Copy it again from the receiver"
            )
        raise InputError(
            f"{path}: no GGA sentence; the others have no height: let the receiver write GGA, and RMC or ZDA"
        )
    notes = _said(path, log)
    cells = [c for _, c in log.rows]
    odd = next((k for k, c in enumerate(cells) if {c[10], c[12]} - {"M", ""}), None)
    if odd is not None:
        raise InputError(
            f"{path}, line {log.rows[odd][0]}: {','.join(cells[odd])}: heights in other units than metres (M)"
        )
    fixed = np.array([c[6] not in ("", "0") for c in cells])
    above_sea, undulation = (np.array([number(c[k]) for c in cells]) for k in (9, 11))
    height, said = above_ellipsoid(path, above_sea, undulation)
    places = np.array([[_angle(c[2], c[3]), _angle(c[4], c[5])] for c in cells])
    llh = np.column_stack([places, height])
    llh[~fixed] = np.nan
    seconds = np.array([_second(c[1]) for c in cells])
    dated = bool(log.dates)
    if not dated:
        notes.append(f"{path.name}: no RMC or ZDA gives a date: its times of day (UTC) are those of the frames' day")
    return Gnss(
        path=path,
        line=[n for n, _ in log.rows],
        lat_lon_height=llh,
        time_s=seconds + _days(log, seconds) if dated else going_on(seconds, DAY_S),
        sigma_m=np.array([log.sigma.get(k, [_NAN] * 3) for k in range(len(cells))]),
        notes=[*notes, *said],
        period_s=0.0 if dated else DAY_S,
    )


def _read(raw: bytes) -> _Log:
    lines = re.split(rb"\r\n|\r|\n", raw)
    found = [(n, m) for n, line in enumerate(lines, start=1) if b"$" in line and (m := _SENTENCE.search(line))]
    summed = any(m[3] for _, m in found)  # a receiver writes checksums always or never
    void: list[tuple[str, str]] = []
    row_at: dict[str, int] = {}  # the last GGA of a time of day
    early: dict[str, list[float]] = {}  # sigmas of a GST that stands before its GGA
    log = _Log()
    for n, match in found:
        cells = match[1].decode("ascii", errors="replace").split(",")
        time, rows = cells[1], log.rows
        least = {b"GGA": 13, b"RMC": 10, b"ZDA": 5, b"GST": 9}[match[2]]
        checksum = np.bitwise_xor.reduce(np.frombuffer(match[1], np.uint8))
        if len(cells) < least or (summed and not (match[3] and checksum == int(match[3][1:], 16))):
            log.damaged.append((n, match[0].decode("ascii", errors="replace").strip()))
        elif match[2] == b"GGA" and rows and rows[-1][1][1] == time != "":
            log.talkers += 1  # two in one epoch (GP single, GN fixed): the better fix counts
            rows[-1] = max(rows[-1], (n, cells), key=lambda row: _BY_WORTH.find(row[1][6]))
        elif match[2] == b"GGA":
            row_at[time] = len(rows)
            if time in early:
                log.sigma[len(rows)] = early.pop(time)
            rows.append((n, cells))
        elif match[2] == b"GST":
            north, east, up = (number(c) for c in cells[6:9])
            if time in row_at:
                log.sigma[row_at.pop(time)] = [east, north, up]
            else:
                early[time] = [east, north, up]
        elif match[2] == b"ZDA":
            log.date(time, f"{cells[2]:0>2}{cells[3]:0>2}{cells[4]}")
        elif cells[2] == "A":
            log.date(time, _four_digits(cells[9]))
        else:
            void.append((time, _four_digits(cells[9])))
    if not log.dates:
        for time, day in void[:1]:  # of a receiver without a fix, but with a clock
            log.date(time, day)
    return log


def _four_digits(day: str) -> str:
    """ddmmyyyy of ddmmyy."""
    return day[:4] + ("19" if day[4:] >= "80" else "20") + day[4:]


def _said(path: Path, log: _Log) -> list[str]:
    notes = []
    if log.damaged:
        n, text = log.damaged[0]
        notes.append(
            f"{path.name}, line {n}: {text!r:.60} is cut off or has a wrong checksum: {len(log.damaged)} such "
            "sentences are left out"
        )
    if log.talkers:
        notes.append(f"{path.name}: {log.talkers} epochs have two positions, of two talkers: the better fix counts")
    kinds = Counter(_FIXES.get(c[6], "no fix") for _, c in log.rows)
    counted = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    return [*notes, f"{path.name}: {len(log.rows)} positions by NMEA: {counted}"]


def _days(log: _Log, seconds: np.ndarray) -> np.ndarray:
    """(R,) start of the day of each row: by the date before or after it, the one whose time of day is nearer."""
    starts, second, day = np.array(log.dates).T
    clock = np.nan_to_num(seconds)
    after = np.searchsorted(starts, np.arange(len(seconds)), side="right")
    before, after = np.maximum(after - 1, 0), np.minimum(after, len(starts) - 1)
    off = [np.abs((second[k] - clock + DAY_S / 2) % DAY_S - DAY_S / 2) for k in (before, after)]
    which = np.where(off[1] < off[0], after, before)
    return day[which] + DAY_S * np.round((second[which] - clock) / DAY_S)


def _angle(text: str, side: str) -> float:
    """Degrees of ddmm.mmmm or dddmm.mmmm with N, S, E or W."""
    found = re.fullmatch(r"(\d{1,3})(\d\d(?:\.\d*)?)", text)
    if found is None or side not in ("N", "S", "E", "W"):
        return _NAN
    minutes = float(found[2])
    degrees = int(found[1]) + minutes / 60 if minutes < 60 else _NAN
    return -degrees if side in ("S", "W") else degrees


def _second(text: str) -> float:
    """Second of the day of hhmmss.ss."""
    found = re.fullmatch(r"(\d\d)(\d\d)(\d\d(?:\.\d*)?)", text)
    return int(found[1]) * 3600 + int(found[2]) * 60 + float(found[3]) if found else _NAN


_IMAGE = re.compile(r"(?i)\.(jpe?g|png|tiff?|dng|bmp|webp|heic|insp)$")


def is_zip(raw: bytes) -> bool:
    """Whether the first bytes of a file are those of a ZIP archive: of the formats here, of a KMZ."""
    return raw.startswith(b"PK\x03\x04")


def _unpacked(path: Path, raw: bytes) -> bytes:
    """The KML document of a KMZ: doc.kml, else the first (OGC 12-007r2, C.2). Raises InputError."""
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            inside = [f for f in archive.infolist() if f.filename.lower().endswith(".kml")]
            first = min(inside, key=lambda f: f.filename.lower() != "doc.kml", default=None)
            if first is not None and first.file_size <= (1 << 29):  # bound of memory: of a KMZ's document
                return archive.read(first)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        raise InputError(
            f"{path}: a KMZ or another ZIP archive that is cut off or damaged ({error}): export it again"
        ) from None
    why = "no KML in it" if first is None else f"{first.filename} has {first.file_size / 2**30:.3g} GiB unpacked"
    raise InputError(f"{path}: a ZIP archive, but no KMZ ({why}): give a KMZ or one of the formats of positions")


def read_gpx(path: Path, raw: bytes) -> Gnss:
    """Track points of GPX 1.0 and 1.1 with their times. Raises InputError for damaged XML and for no timed points."""
    root = parse_xml(path, raw)
    points = list(root.all("trkpt"))
    if not points:
        others = sum(1 for n in ("rtept", "wpt") for _ in root.all(n))
        raise InputError(
            f"{path}: no track points (trkpt), {others} of routes and waypoints; export the recorded track"
        )
    if not any(p.said("time") for p in points):
        raise InputError(
            f"{path}, line {points[0].line}: no track point has a time, so they cannot be assigned to images: "
            "export the track with times"
        )
    above_sea, undulation = (np.array([number(p.said(n)) for p in points]) for n in ("ele", "geoidheight"))
    height, notes = above_ellipsoid(path, above_sea, undulation)
    return Gnss(
        path=path,
        line=[p.line for p in points],
        lat_lon_height=np.column_stack(
            [*([number(p.given.get(n, "")) for p in points] for n in ("lat", "lon")), height]
        ),
        time_s=np.array([parse_time(p.said("time")) for p in points]),
        notes=notes,
    )


def read_kml(path: Path, raw: bytes) -> Gnss:
    """Rows of gx:Track (when, coord), or placemarks of points with names of images or a TimeStamp.

    Raises InputError for damaged XML or KMZ, heights above the ground, a track of other times than places, and if
    there is neither.
    """
    root = parse_xml(path, _unpacked(path, raw) if is_zip(raw) else raw)
    for mode in root.all("altitudeMode"):
        if mode.text.strip() == "relativeToGround":
            raise InputError(
                f"{path}, line {mode.line}: heights above the ground (relativeToGround) cannot be used: export "
                "absolute altitudes"
            )
    whens, places = [], []
    for track in root.all("Track"):
        mine = [c for c in track.children if c.name == "when"], [c for c in track.children if c.name == "coord"]
        if len(mine[0]) != len(mine[1]):
            raise InputError(
                f"{path}, line {track.line}: a gx:Track of {len(mine[0])} times and {len(mine[1])} places: is the "
                "file cut off? Export it again"
            )
        whens += mine[0]
        places += mine[1]
    if places:
        times = np.array([parse_time(w.text.strip()) for w in whens])
        return _kml_fixes(path, [p.line for p in places], [p.text.split() for p in places], times)
    marks = [(m, p) for m in root.all("Placemark") for p in m.all("Point")]
    named = [(m.said("name"), p) for m, p in marks if _IMAGE.search(m.said("name"))]
    if named:
        where = [p.said("coordinates").split(",") for _, p in named]
        found = _kml_fixes(path, [p.line for _, p in named], where, np.full(len(named), _NAN))
        return replace(found, names=[n for n, _ in named])
    timed = [(s, p) for m, p in marks for s in m.all("TimeStamp")]
    if not timed:
        raise InputError(
            f"{path}: no gx:Track and no points named as images or with a TimeStamp ({len(marks)} points without); "
            "a line alone has no times: export the track as GPX, or as KML with times"
        )
    times = np.array([parse_time(s.said("when")) for s, _ in timed])
    return _kml_fixes(path, [p.line for _, p in timed], [p.said("coordinates").split(",") for _, p in timed], times)


def _kml_fixes(path: Path, line: list[int], lon_lat_height: list[list[str]], time_s: np.ndarray) -> Gnss:
    lon, lat, above_sea = np.array([[number(v) for v in [*cells, "", "", ""][:3]] for cells in lon_lat_height]).T
    height, notes = above_ellipsoid(path, above_sea, np.full(len(line), _NAN))
    return Gnss(path=path, line=line, lat_lon_height=np.stack([lat, lon, height], axis=1), time_s=time_s, notes=notes)
