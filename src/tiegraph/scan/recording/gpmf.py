"""GoPro's telemetry track: positions and times of its receiver, on the clock of the video.

A payload lasts about a second and contains devices (DEVC), these streams (STRM). In a stream, the entries before the
readings describe them. GPS5 (to HERO10): latitude, longitude, height and two speeds, divided by SCAL; once a
payload the time of the first (GPSU, UTC as yymmddhhmmss.sss), the fix (GPSF) and the DOP times 100 (GPSP). GPS9 (from
HERO11): each row has days since 2000 and seconds of the day, UTC, DOP and fix itself. GPSA is MSLV where heights are
above the sea; without, they are above the ellipsoid (gpmf-parser's README and issues 4, 46, 81).

Readings have no stamps of their own: they divide the time of their payload evenly, as in GoPro's own parser.

The form of the track is key, length, value (GPMF; github.com/gopro/gpmf-parser, "GPMF Deeper Dive"): an entry is four
letters, a letter for the type of its numbers, the bytes of a row, the number of rows, and the rows, big-endian, filled
up to four bytes. Entries nest; the reader here reads one level at a time, so depth costs nothing.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tiegraph.scan.recording import Fixes, Readings, believed
from tiegraph.scan.recording.tracks import BrokenTrack, Samples, samples, tracks
from tiegraph.scan.tuning import PicturesTuning
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


def read_gpmf(video: Path, max_gap_s: float, tuning: PicturesTuning) -> Telemetry | None:
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
    kept, words = believed(Readings.concatenate(found[kind]), tuning)
    where = "above the sea" if above_sea else "above the ellipsoid"
    start, begins = _start(kept, tuning)
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


def _start(kept: Readings, tuning: PicturesTuning) -> tuple[float, str]:
    """Start of the video by the times of its receiver (s since 1970, UTC), and in words; NaN if there are none."""
    late = (kept.time_s - kept.stamp_s)[np.isfinite(kept.time_s)]
    if not len(late):
        return float("nan"), ""
    start = float(np.median(late))
    spread = float(np.median(np.abs(late - start)))
    second, part = divmod(round(1e6 * start), 10**6)
    doubt = f", which contradict each other by {spread:.1f} s" if spread > tuning.receiver_apart_s else ""
    when = f"{date_text(second)}.{part // 1000:03d} UTC"
    return start, f"begins at {when} by {len(late)} times of its receiver{doubt}"
