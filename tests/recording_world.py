"""Files as cameras write them: MP4 with two video tracks, with GoPro's telemetry, with Insta360's trailer.

The bytes are made from the formats' descriptions (ISO/IEC 14496-12; gpmf-parser's README; telemetry-parser), box by box
and number by number, and use nothing of the readers.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np

import video_world

EPOCH_2000 = datetime(2000, 1, 1, tzinfo=timezone.utc)


def film(path: Path, level: int = 20, seconds: float = 2.0, size: int = 64) -> Path:
    """A grey MP4 of ten pictures a second that grows lighter by one level each."""
    return video_world.film(path, (np.full((size, size, 3), level + k, np.uint8) for k in range(round(10 * seconds))))


# --- boxes ----------------------------------------------------------------------------------------------------------


def box(kind: bytes, *data: bytes) -> bytes:
    return struct.pack(">I4s", 8 + sum(map(len, data)), kind) + b"".join(data)


def split(data: bytes) -> list[tuple[bytes, bytes]]:
    """Kinds and contents of the boxes that stand one behind the other."""
    out, at = [], 0
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        out.append((data[at + 4 : at + 8], data[at + 8 : at + size]))
        at += size
    return out


def moved(track: bytes, by: int) -> bytes:
    """A track whose chunks (stco) lie so many bytes later."""
    at = track.index(b"stco") + 8
    count = int.from_bytes(track[at : at + 4], "big")
    places = np.frombuffer(track[at + 4 : at + 4 + 4 * count], ">u4").astype(np.int64) + by
    return track[: at + 4] + places.astype(">u4").tobytes() + track[at + 4 + 4 * count :]


def created(path: Path, time_s: float) -> Path:
    """The MP4 with another creation time (seconds since 1970)."""
    data = bytearray(path.read_bytes())
    struct.pack_into(">I", data, data.index(b"mvhd") + 8, round(time_s) + 2082844800)
    path.write_bytes(data)
    return path


def two_tracks(path: Path, first: Path, second: Path) -> Path:
    """An MP4 with the video tracks of two; both have their header at the end, as OpenCV writes it."""
    one, other = first.read_bytes(), second.read_bytes()
    boxes, more = split(one), dict(split(other))
    begin = one.index(b"moov") - 4
    new = box(b"mdat", more[b"mdat"])
    track = bytearray(moved(dict(split(more[b"moov"]))[b"trak"], begin + 4 - (other.index(b"mdat") - 4) - 4))
    struct.pack_into(">I", track, bytes(track).index(b"tkhd") + 16, 2)  # its number
    path.write_bytes(one[:begin] + new + box(b"moov", dict(boxes)[b"moov"], box(b"trak", bytes(track))))
    return path


def edited(path: Path, number: int, edits: Sequence[tuple[float, float]], wide: bool = False) -> Path:
    """The MP4 with an edit list of its track with a number: (length, place in the media or -1 for nothing, both s); its
    header is at the end."""
    data = path.read_bytes()
    boxes, made = split(dict(split(data))[b"moov"]), []
    scale = int.from_bytes(dict(boxes)[b"mvhd"][12:16], "big")
    for kind, inside in boxes:
        if kind == b"trak" and (number := number - 1) < 0:
            parts = [(k, i) for k, i in split(inside) if k != b"edts"]
            unit = int.from_bytes(dict(split(dict(parts)[b"mdia"]))[b"mdhd"][12:16], "big")
            rows = [(round(scale * length), -1 if at < 0 else round(unit * at), 65536) for length, at in edits]
            table = b"".join(struct.pack(">QqI" if wide else ">IiI", *row) for row in rows)
            made.append(box(b"edts", box(b"elst", struct.pack(">II", wide << 24, len(rows)), table)))
            inside, number = b"".join([box(*parts[0]), made.pop(), *(box(*p) for p in parts[1:])]), 99
        made.append(box(kind, inside))
    path.write_bytes(data[: data.rindex(b"moov") - 4] + box(b"moov", *made))
    return path


@dataclass(frozen=True)
class Layout:
    """How payloads lie in the file: seconds each lasts, payloads a chunk, long offsets."""

    seconds: float = 1.0
    in_chunk: int = 1
    wide: bool = False
    format: bytes = b"gpmd"


ONE_EACH = Layout()


def with_telemetry(path: Path, payloads: Sequence[bytes], layout: Layout = ONE_EACH) -> Path:
    """The MP4 with a telemetry track beside its own."""
    data = path.read_bytes()
    begin = data.rindex(b"moov") - 4
    places, at = [], begin + 8
    for k, payload in enumerate(payloads):
        if k % layout.in_chunk == 0:
            places.append(at)
        at += len(payload)
    whole, rest = divmod(len(payloads), layout.in_chunk)
    runs = [(1, layout.in_chunk)] * bool(whole) + [(whole + 1, rest)] * bool(rest)
    tables = (
        box(b"stsd", struct.pack(">II", 0, 1), box(layout.format, bytes(6), b"\0\1")),
        box(b"stts", struct.pack(">IIII", 0, 1, len(payloads), round(1000 * layout.seconds))),
        box(b"stsc", struct.pack(">II", 0, len(runs)), *(struct.pack(">III", *run, 1) for run in runs)),
        box(b"stsz", struct.pack(">III", 0, 0, len(payloads)), *(struct.pack(">I", len(p)) for p in payloads)),
        box(
            b"co64" if layout.wide else b"stco",
            struct.pack(">II", 0, len(places)),
            *(struct.pack(">Q" if layout.wide else ">I", p) for p in places),
        ),
    )
    media = box(
        b"mdia",
        box(b"mdhd", struct.pack(">IIIIII", 0, 0, 0, 1000, round(1000 * layout.seconds) * len(payloads), 0)),
        box(b"hdlr", bytes(8), b"meta", bytes(12), b"GoPro MET\0"),
        box(b"minf", box(b"gmhd", bytes(16)), box(b"stbl", *tables)),
    )
    track = box(b"trak", box(b"tkhd", struct.pack(">IIIII", 7, 0, 0, 3, 0), bytes(64)), media)
    path.write_bytes(data[:begin] + box(b"mdat", *payloads) + box(b"moov", data[begin + 8 :], track))
    return path


# --- GPMF -----------------------------------------------------------------------------------------------------------


def klv(key: str, kind: str, size: int, *rows: bytes) -> bytes:
    """An entry: key, type, bytes a row, rows, filled up to four bytes."""
    data = b"".join(rows)
    return struct.pack(">4scBH", key.encode(), kind.encode(), size, len(rows)) + data + bytes(-len(data) % 4)


def nest(key: str, *children: bytes) -> bytes:
    data = b"".join(children)
    return struct.pack(">4scBH", key.encode(), b"\0", 4, len(data) // 4) + data


@dataclass(frozen=True)
class Fix:
    """A fix of the receiver as the test means it."""

    time: datetime
    lat: float
    lon: float
    height: float
    dop: float = 1.2
    fix: int = 3


def device(*streams: bytes) -> bytes:
    accelerometer = nest("STRM", klv("SCAL", "s", 2, struct.pack(">h", 418)), klv("ACCL", "s", 6, bytes(6), bytes(6)))
    named = klv("DVNM", "c", 11, b"Hero11 Blac")
    return nest("DEVC", klv("DVID", "L", 4, struct.pack(">I", 1)), named, accelerometer, *streams)


def gps5(fixes: Sequence[Fix], above_sea: bool = True, utc: str = "") -> bytes:
    """A payload as of HERO5 to HERO10: one time, fix and DOP for all, those of the first."""
    first = fixes[0]
    utc = utc or first.time.strftime("%y%m%d%H%M%S.") + f"{first.time.microsecond // 1000:03d}"
    rows = [struct.pack(">5i", round(f.lat * 1e7), round(f.lon * 1e7), round(f.height * 1e3), 1, 2) for f in fixes]
    return device(
        nest(
            "STRM",
            klv("STNM", "c", 43, b"GPS (Lat., Long., Alt., 2D speed, 3D speed)"),
            klv("GPSF", "L", 4, struct.pack(">I", first.fix)),
            klv("GPSU", "U", 16, utc.encode()),
            klv("GPSP", "S", 2, struct.pack(">H", round(100 * first.dop))),
            klv("SCAL", "l", 4, *(struct.pack(">i", s) for s in (10**7, 10**7, 1000, 1000, 100))),
            *([klv("GPSA", "F", 4, b"MSLV")] if above_sea else []),
            klv("GPS5", "l", 20, *rows),
        )
    )


def gps9(fixes: Sequence[Fix], scales: Sequence[int] = (10**7, 10**7, 1000, 1000, 100, 1, 1000, 100, 1)) -> bytes:
    """A payload as of HERO11 on: each row with its time, DOP and fix."""
    rows = []
    for f in fixes:
        since = f.time - EPOCH_2000
        ms = round(since.seconds * 1000 + since.microseconds / 1000)
        place = round(f.lat * 1e7), round(f.lon * 1e7), round(f.height * 1e3)
        rows.append(struct.pack(">7iHH", *place, 1, 2, since.days, ms, round(100 * f.dop), f.fix))
    scale = klv("SCAL", "l", 4, *(struct.pack(">i", s) for s in scales))
    kinds = klv("TYPE", "c", 1, *(c.encode() for c in "lllllllSS"))
    return device(nest("STRM", klv("GPSA", "F", 4, b"MSLV"), kinds, scale, klv("GPS9", "?", 32, *rows)))


SPEED = float(np.hypot(1e-5 * 111_199, 2e-5 * 74_625))  # of ``walk``, m/s, by the lengths of degrees at 48 degrees


def walk(start: datetime, count: int, rate_hz: float, **other: float) -> list[Fix]:
    """A receiver that goes 1e-5 degrees north and 2e-5 west a second and climbs 0.5 m."""
    seconds = np.arange(count) / rate_hz
    return [
        Fix(start + timedelta(seconds=float(s)), 48.0 + 1e-5 * s, 11.0 - 2e-5 * s, 500 + 0.5 * s, **other)
        for s in seconds
    ]


# --- Insta360 -------------------------------------------------------------------------------------------------------


def gps_record(fixes: Sequence[Fix]) -> bytes:
    """Record 7: 53 bytes a row; angles without a sign beside a letter."""
    out = []
    for f in fixes:
        seconds, ms = divmod(round(f.time.timestamp() * 1000), 1000)
        row = struct.pack("<QHc", seconds, ms, b"A" if f.fix else b"V")
        row += struct.pack("<dc", abs(f.lat), b"N" if f.lat >= 0 else b"S")
        row += struct.pack("<dc", abs(f.lon), b"E" if f.lon >= 0 else b"W")
        out.append(row + struct.pack("<ddd", 1.5, 90.0, f.height))
    assert all(len(r) == 53 for r in out)
    return b"".join(out)


def with_trailer(path: Path, records: Sequence[tuple[int, bytes]], gap: int = 0) -> Path:
    """The file with a trailer of records (kind, bytes); with a gap before each, as of the X4, an index comes last."""
    body, index = b"", b""
    for kind, data in records:
        body += b"\xa5" * gap
        index += struct.pack("<BBII", kind, 0, len(data), len(body))
        body += data + struct.pack("<BBI", 0, kind, len(data))
    if gap:
        body += index + bytes(10) + struct.pack("<BBI", 0, 0, len(index) + 10)
    foot = bytes(32) + struct.pack("<II", len(body) + 72, 3) + b"8db42d694ccc418790edff439fe026bf"
    path.write_bytes(path.read_bytes() + body + foot)
    return path
