"""Positions and times of a camera's receiver in its files, and the factory's calibration of its lenses.

Of the libraries, telemetry-parser 0.3.0 (MIT or Apache) leaves GPS9 as bytes, does not read the index of a trailer and
has no wheel for Python 3.13. The needed part of both formats is a table, so it is read here, each size checked before
it is used.

**GoPro**: a telemetry track, on the clock of the video. A payload lasts about a second and contains devices (DEVC),
these streams (STRM). In a stream, the entries before the readings describe them. GPS5 (to HERO10): latitude, longitude,
height and two speeds, divided by SCAL; once a payload the time of the first (GPSU, UTC as yymmddhhmmss.sss), the fix
(GPSF) and the DOP times 100 (GPSP). GPS9 (from HERO11): each row has days since 2000 and seconds of the day, UTC, DOP
and fix itself. GPSA is MSLV where heights are above the sea; without, they are above the ellipsoid (gpmf-parser's
README and issues 4, 46, 81).

Readings have no stamps of their own: they divide the time of their payload evenly, as in GoPro's own parser.

The form of the track is key, length, value (GPMF; github.com/gopro/gpmf-parser, "GPMF Deeper Dive"): an entry is four
letters, a letter for the type of its numbers, the bytes of a row, the number of rows, and the rows, big-endian, filled
up to four bytes. Entries nest; the reader here reads one level at a time, so depth costs nothing.

**Insta360**: a trailer behind an MP4, with positions and times of the camera's receiver or the remote's. The file ends
with 32 bytes, the length of the trailer, a version and 32 letters. Records precede them, each followed by its format,
its kind and its length; newer cameras leave gaps between the records, and record 0, the last, lists their places.
Record 7 has rows of 53 bytes: UTC since 1970 in seconds and milliseconds, A or V (acquired, void), latitude with N or
S, longitude with E or W (O in French), speed, course, height. As ExifTool (QuickTimeStream) and telemetry-parser read
it.

The factory's calibration of the two lenses is in the file too, as numbers joined by "_", the first the number of
lenses; the last gives the form (above its lowest 16 bits). The oldest, 0, has for each lens radius, centre x, y, yaw,
pitch, roll, then width, height and kind (ExifTool's Parameters). Form 3 has for each the mirror parameter xi of a
unified sphere (Mei 2007), fx, fy, cx, cy, yaw, pitch, roll, three metres, k1, k2, k3, p1, p2, width, height, kind.
Lengths are pixels of both lenses side by side, angles degrees. telemetry-parser reads them so (insta360/rig.rs). The
strings of an X5 are public (Insta360Develop/Desktop-CameraSDK-Cpp, issue 85): form 3 meets the radius that form 0
states at 100 degrees to 0.2 %, and form 2, another model, to 0.4 % from 20 degrees on. The exact relative pose of the
lenses is not used, only the rolls. Form 2 needs a table by the kind of lens, form 6 adds terms that no second source
describes.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tiegraph.scan.recording import BrokenTrack, Fixes, Readings, Samples, believed, samples, tracks
from tiegraph.scene.atomic import regular
from tiegraph.scene.cells import date_text, seconds_of
from tiegraph.scene.times import DAY_S

_NUMBERS = {
    "b": ">i1", "B": ">u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "j": ">i8", "J": ">u8", "f": ">f4",
    "d": ">f8", "q": ">i4", "Q": ">i8",
}  # fmt: skip
_FIXED_POINT = {"q": 2.0**16, "Q": 2.0**32}
_REPEATED = re.compile(r"([A-Za-z])(?:\[(\d{1,3})\])?")
_HEAD = 8
_EPOCH_S = datetime(2000, 1, 1, tzinfo=timezone.utc).timestamp()
_GPS5, _GPS9 = 5, 9  # numbers a row


@dataclass(frozen=True)
class Entry:
    """An entry: its key, the letter of its type (zero: it contains entries), bytes a row, and the bytes of its rows."""

    key: str
    kind: str
    size: int
    data: bytes

    def text(self) -> str:
        """Its bytes as characters, without padding."""
        return self.data.decode("latin-1").rstrip("\0 ")

    def rows(self, types: str = "") -> np.ndarray:
        """(rows, numbers a row) f8; ``types``: the letters of an entry of type "?" (TYPE). Raises BrokenTrack."""
        numbers = self.size // np.dtype(_NUMBERS.get(self.kind, ">u1")).itemsize
        letters = _letters(types) if self.kind == "?" else self.kind * numbers
        if not letters or any(c not in _NUMBERS for c in letters):
            kind = types[:40] if self.kind == "?" else self.kind
            raise BrokenTrack(f"{self.key}: numbers of type {kind!r} are not known")
        row = np.dtype([(f"n{k}", _NUMBERS[c]) for k, c in enumerate(letters)])
        if row.itemsize != self.size:
            raise BrokenTrack(f"{self.key}: rows of type {letters} have {row.itemsize} bytes, not {self.size}")
        table = np.frombuffer(self.data, row)
        columns = [table[f"n{k}"].astype(float) / _FIXED_POINT.get(c, 1.0) for k, c in enumerate(letters)]
        return np.stack(columns, axis=1)


def entries(data: bytes) -> Iterator[Entry]:
    """The consecutive entries. Raises BrokenTrack if one is longer than the rest of the data."""
    at = 0
    while len(data) - at >= _HEAD and any(data[at : at + 4]):  # a key of zeros fills up the rest
        key = data[at : at + 4].decode("latin-1")
        size, count = data[at + 5], int.from_bytes(data[at + 6 : at + 8], "big")
        begin, length = at + _HEAD, size * count
        if begin + length > len(data):
            raise BrokenTrack(f"{key!r} announces {count} rows of {size} bytes, but {len(data) - begin} bytes are left")
        yield Entry(key, chr(data[at + 4]), size=size, data=data[begin : begin + length])
        at = begin + length + -length % 4


def _letters(types: str) -> str:
    """The letters of a row; a letter with a number in brackets is repeated that often."""
    found = [(c, int(n or 1)) for c, n in _REPEATED.findall(types)]
    if _REPEATED.sub("", types) or sum(n for _, n in found) > 255:  # one byte gives the length of a row
        return ""
    return "".join(c * n for c, n in found)


_Stream = dict[str, Entry]


@dataclass(frozen=True)
class Telemetry:
    """Content of a telemetry track: fixes (None = none usable), when the video began (s since 1970, UTC; NaN =
    unknown), and the origin of both in words."""

    fixes: Fixes | None
    start_s: float
    note: str


def read_gpmf(video: Path, max_gap_s: float) -> Telemetry | None:
    """The telemetry of a GoPro's video; None for a file without such a track. Damage is noted, never raised."""
    try:
        with regular(video, None).open("rb") as file:
            track = next((t for t in tracks(file) if t.format == b"gpmd"), None)
            if track is None:
                return None
            table = samples(file, track)
            found, above_sea, broken = _read(file, table)
    except (BrokenTrack, OSError) as error:
        return Telemetry(None, np.nan, f"its GPMF track cannot be read ({error}): no times or positions from it")
    damaged = f"{len(broken)} of its {len(table.size)} GPMF payloads cannot be read ({broken[0]})" if broken else ""
    kind = "GPS9" if found["GPS9"] else "GPS5"
    if not any(len(p) for p in found[kind]):
        return Telemetry(None, np.nan, "; ".join(filter(None, ["its GPMF track has no fixes of a receiver", damaged])))
    kept, words = believed(Readings.concatenate(found[kind]))
    where = "above the sea" if above_sea else "above the ellipsoid"
    start, begins = _start(kept)
    said = [begins, f"positions from its GPMF track ({kind}): {words}, heights {where}", damaged]
    fixes = Fixes(kept.stamp_s, kept.lat_lon_height, max_gap_s) if len(kept) else None
    return Telemetry(fixes, start, "; ".join(filter(None, said)))


def _read(file: BinaryIO, table: Samples) -> tuple[dict[str, list[Readings]], bool, list[str]]:
    """Readings by kind, whether heights are above the sea, and the reasons for unreadable payloads."""
    found: dict[str, list[Readings]] = {"GPS5": [], "GPS9": []}
    end, above_sea, broken = file.seek(0, 2), False, []
    if table.size.sum() > end:
        raise BrokenTrack(f"its {len(table.size)} payloads together are larger than the file")
    for offset, size, begin, length in zip(table.offset, table.size, table.begin_s, table.length_s):
        if offset < 0 or offset + size > end:
            broken.append("a payload lies beyond the end of the file: is it cut off?")
            continue
        file.seek(int(offset))
        try:
            for stream in _streams(file.read(int(size))):
                for kind, read in (("GPS5", _gps5), ("GPS9", _gps9)):
                    if kind in stream:
                        readings = read(stream)
                        stamps = begin + length * np.arange(len(readings)) / max(len(readings), 1)
                        found[kind].append(replace(readings, stamp_s=stamps))
                        above_sea = stream["GPSA"].text() == "MSLV" if "GPSA" in stream else above_sea
        except BrokenTrack as error:
            broken.append(str(error))
    return found, above_sea, broken


def _streams(payload: bytes) -> Iterator[_Stream]:
    for device in entries(payload):
        if device.key == "DEVC" and device.kind == "\0":
            for stream in entries(device.data):
                if stream.key == "STRM" and stream.kind == "\0":
                    yield {e.key: e for e in entries(stream.data)}


def _scaled(stream: _Stream, key: str, columns: int) -> np.ndarray:
    """(rows, columns) in degrees, metres and other units: divided by SCAL."""
    types = stream["TYPE"].text() if "TYPE" in stream else ""
    rows = stream[key].rows(types)
    if "SCAL" not in stream:
        raise BrokenTrack(f"{key} without a scale (SCAL)")
    scale = stream["SCAL"].rows().ravel()
    if rows.shape[1] != columns or len(scale) not in (1, columns) or not np.all(scale):
        raise BrokenTrack(f"{key} with {rows.shape[1]} numbers a row and {len(scale)} scales: expected {columns}")
    return rows / scale


def _gps5(stream: _Stream) -> Readings:
    rows = _scaled(stream, "GPS5", _GPS5)
    count = len(rows)
    time = np.full(count, np.nan)
    if "GPSU" in stream:  # of second 60, a leap second, NaN too
        time[:1] = seconds_of(f"20{stream['GPSU'].text()}", "%Y%m%d%H%M%S.%f")
    said = [stream[key].rows().ravel()[:1] if key in stream else np.zeros(0) for key in ("GPSF", "GPSP")]
    fix, dop = (np.full(count, value[0] if len(value) else np.nan) for value in said)
    return Readings(np.full(count, np.nan), time, rows[:, :3], fix=fix, dop=dop / 100.0)


def _gps9(stream: _Stream) -> Readings:
    rows = _scaled(stream, "GPS9", _GPS9)
    time = _EPOCH_S + DAY_S * rows[:, 5] + rows[:, 6]
    return Readings(np.full(len(rows), np.nan), time, rows[:, :3], fix=rows[:, 8], dop=rows[:, 7])


def _start(kept: Readings) -> tuple[float, str]:
    """Start of the video by the times of its receiver (s since 1970, UTC), and in words; NaN if there are none."""
    late = (kept.time_s - kept.stamp_s)[np.isfinite(kept.time_s)]
    if not len(late):
        return float("nan"), ""
    start = float(np.median(late))
    spread = float(np.median(np.abs(late - start)))
    second, part = divmod(round(1e6 * start), 10**6)
    doubt = f", which contradict each other by {spread:.1f} s" if spread > 0.5 else ""  # payloads differ by 0.1
    when = f"{date_text(second)}.{part // 1000:03d} UTC"
    return start, f"begins at {when} by {len(late)} times of its receiver{doubt}"


_OLD, _SPHERE = 0, 3
_A_LENS = {_OLD: 6, _SPHERE: 19}  # numbers
_BEHIND = {_OLD: 4, _SPHERE: 2}  # the number of lenses before, and the numbers after the lenses
_LENSES = 2
_FITTED = np.radians(np.arange(1.0, 88.5))  # COLMAP's fisheyes end at 90 degrees
_LETTERS = b"8db42d694ccc418790edff439fe026bf"
_FOOT, _RECORD_HEAD = 72, 6
_INDEX, _GPS, _BINARY = 0, 7, 0
_MOST_RECORDS = 1000
_ROW = np.dtype(
    [("s", "<u8"), ("ms", "<u2"), ("state", "S1"), ("lat", "<f8"), ("ns", "S1"), ("lon", "<f8"), ("ew", "S1"),
     ("speed", "<f8"), ("course", "<f8"), ("height", "<f8")]
)  # fmt: skip
_ENTRY = np.dtype([("kind", "u1"), ("format", "u1"), ("size", "<u4"), ("offset", "<u4")])
_Places = dict[int, tuple[int, int]]  # first byte and length of a record by its kind


def read_trailer(video: Path) -> Readings | None:
    """The receiver's readings, their stamps NaN; None for a file without such a trailer or record.

    Raises BrokenTrack, and OSError for a file that cannot be read.
    """
    with regular(video, None).open("rb") as file:
        end = file.seek(0, 2)
        if end < _FOOT:
            return None
        file.seek(end - _FOOT)
        foot = file.read(_FOOT)
        if not foot.endswith(_LETTERS):
            return None
        length = int.from_bytes(foot[32:36], "little")
        if not _FOOT <= length <= end:
            raise BrokenTrack(f"its stated length is {length} bytes, but the file has {end}")
        begin, size = _records(file, end - length, end).get(_GPS, (0, 0))
        if not size:
            return None
        file.seek(begin)
        rows = np.frombuffer(file.read(size - size % _ROW.itemsize), _ROW)
    return _readings(rows)


def _records(file: BinaryIO, begin: int, end: int) -> _Places:
    """Records between two places of a file: by the index, or one by one from the end until a gap."""
    walked = _walk(file, begin, end)
    if _INDEX not in walked:
        return walked
    file.seek(walked[_INDEX][0])
    data = file.read(walked[_INDEX][1])
    found = dict(walked)
    for entry in np.frombuffer(data[: len(data) - len(data) % _ENTRY.itemsize], _ENTRY)[:_MOST_RECORDS]:
        kind, form, size, offset = (int(v) for v in entry)
        if form != _BINARY or not size:
            continue
        if begin + offset + size > end - _FOOT:
            raise BrokenTrack(f"its index lists record {kind} with {size} bytes at {offset}, which is outside of it")
        found[kind] = begin + offset, size
    return found


def _walk(file: BinaryIO, begin: int, end: int) -> _Places:
    found: _Places = {}
    at = end - _FOOT
    for _ in range(_MOST_RECORDS):
        if at - _RECORD_HEAD < begin:
            break
        file.seek(at - _RECORD_HEAD)
        form, kind, *size = file.read(_RECORD_HEAD)
        length = int.from_bytes(bytes(size), "little")
        at -= _RECORD_HEAD + length
        if at < begin:
            if not found:
                raise BrokenTrack(f"its last record, {kind}, announces {length} bytes, more than there are")
            break
        if form == _BINARY:
            found.setdefault(kind, (at, length))
    return found


def _readings(rows: np.ndarray) -> Readings:
    signs = [{b"N": 1.0, b"S": -1.0}, {b"E": 1.0, b"W": -1.0, b"O": -1.0}]
    lat, lon = (
        np.abs(rows[angle]) * np.array([sign.get(word, np.nan) for word in rows[letter].tolist()])
        for angle, letter, sign in (("lat", "ns", signs[0]), ("lon", "ew", signs[1]))
    )
    nothing = np.full(len(rows), np.nan)
    return Readings(
        stamp_s=nothing,
        time_s=rows["s"].astype(float) + rows["ms"] / 1000,
        lat_lon_height=np.stack([lat, lon, rows["height"].astype(float)], axis=1).reshape(-1, 3),
        fix=np.where(rows["state"] == b"A", 3.0, 0.0),
        dop=nothing,
    )


@dataclass(frozen=True)
class FactoryLens:
    """A lens: its centre and the size of the picture it was measured in, both lenses' (px), its roll (deg); and if
    the string has them, the parameters of the sphere: xi, f (px), k1, k2, k3."""

    centre_px: tuple[float, float]
    size: tuple[float, float]
    roll_deg: float
    sphere: tuple[float, ...] = ()

    def radius_px(self, angle: np.ndarray) -> np.ndarray:
        """Radial distance in the image of points at angles off the axis, radians. Mei 2007, equation 12;
        tangential distortion, a few pixels of 2700, is omitted."""
        xi, focal, k1, k2, k3 = self.sphere
        r = np.sin(angle) / (np.cos(angle) + xi)
        return np.asarray(focal * r * (1 + r**2 * (k1 + r**2 * (k2 + r**2 * k3))))

    def opencv_fisheye(self, number: int, width: int) -> tuple[float, ...]:
        """Parameters of OPENCV_FISHEYE for the half of that number (0, 1) of a picture, ``width`` px a half: the
        least-squares polynomial up to 88 degrees. () if the numbers are impossible for a lens."""
        scale = _LENSES * width / self.size[0]
        radius = scale * self.radius_px(_FITTED)
        if not np.isfinite(radius).all() or not radius.any():
            return ()
        terms = np.stack([_FITTED**n for n in (1, 3, 5, 7, 9)], axis=1)
        focal, *bent = np.linalg.lstsq(terms, radius, rcond=None)[0]
        x, y = scale * self.centre_px[0] - number * width, scale * self.centre_px[1]
        return tuple(float(v) for v in (focal, focal, x, y, *(b / focal for b in bent)))


def factory_lenses(text: str) -> tuple[FactoryLens, FactoryLens] | None:
    """The two lenses by the newest readable string (separated by blanks); None if none is readable."""
    found = [pair for word in text.split() if (pair := _lenses(word)) is not None]
    return max(found, key=lambda pair: len(pair[0].sphere), default=None)


def _lenses(word: str) -> tuple[FactoryLens, FactoryLens] | None:
    numbers = [float(v) for v in word.split("_")]
    if not np.isfinite(numbers).all():
        return None
    form = int(numbers[-1]) >> 16
    count = _A_LENS.get(form, 0)
    if not count or numbers[0] != _LENSES or len(numbers) != _LENSES * count + _BEHIND[form]:
        return None
    size = numbers[-3], numbers[-2]  # of the old form; in the other, each lens has its own
    one, other = (_lens(numbers[1 + k * count : 1 + (k + 1) * count], size) for k in range(_LENSES))
    return (one, other) if one.size == other.size and one.size[0] == _LENSES * one.size[1] > 0 else None


def _lens(n: list[float], size: tuple[float, float]) -> FactoryLens:
    if len(n) == _A_LENS[_OLD]:
        return FactoryLens((n[1], n[2]), size, n[5])
    return FactoryLens((n[3], n[4]), (n[16], n[17]), n[7], sphere=(n[0], (n[1] + n[2]) / 2, *n[11:14]))
