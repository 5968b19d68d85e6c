"""Films: a file, a track of one, or a topic of a bag; the fixes of a receiver; and the tracks of an MP4 file.

The boxes (ISO/IEC 14496-12, 4.2) and tracks (8.3 to 8.7) of an MP4 or QuickTime file are read with the places and times
of their samples. Tables state their own length; it is checked against the box and the file before anything is read.
OpenCV's FFmpeg reads only the first video track (``CAP_PROP_VIDEO_STREAM`` is refused), but reads from a Python stream,
in which the other tracks are named free space.
"""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tiegraph.scene.atomic import regular
from tiegraph.scene.bags import shown
from tiegraph.scene.exif import Taken
from tiegraph.scene.names import clean
from tiegraph.scene.sorting import Columns


@dataclass(frozen=True)
class Recording:
    """One film: a file, one of the video tracks of a file, from 0, or an image topic of a bag."""

    file: Path
    track: int | None = None
    topic: str | None = None

    @property
    def name(self) -> str:
        """Its name for messages."""
        if self.topic is not None:
            return shown(self.file, self.topic)
        return clean(self.file.name) + ("" if self.track is None else f", track {self.track + 1}")


# 2000 ... 2100: other times are those of clocks that were never set (0 = 1904, 1970).
RECORDED_RANGE_S = (946684800.0, 4102444800.0)
_MOST_HEIGHT_M = 100_000.0  # above or below the sea: other numbers are no heights
_MOST_DOP = 5.0  # "under 500 is good" for its hundredfold by GoPro (gpmf-parser)


@dataclass(frozen=True)
class Readings(Columns):
    """Readings of a receiver, row by row; NaN = missing. All (N,) but ``lat_lon_height`` (N, 3), degrees and metres."""

    stamp_s: np.ndarray  # on the video's clock
    time_s: np.ndarray  # seconds since 1970, UTC
    lat_lon_height: np.ndarray
    fix: np.ndarray  # 0 = none, 2 = without height, 3
    dop: np.ndarray  # dilution of precision


@dataclass(frozen=True)
class Fixes:
    """Positions of the receiver at stamps of the video, increasing; NaN = not known."""

    stamp_s: np.ndarray  # (R,)
    lat_lon_height: np.ndarray  # (R, 3) degrees, m
    max_gap_s: float
    sigma_m: float = float("nan")  # NaN = the default of a receiver

    def place(self, stamp_s: float) -> Taken:
        """Position of the frame with a stamp: interpolated between the neighbouring fixes, if they are close enough
        in time."""
        last = len(self.stamp_s) - 1
        after = min(max(int(np.searchsorted(self.stamp_s, stamp_s, side="right")), 1), last)
        rows = slice(max(after - 1, 0), after + 1)
        begin, end = self.stamp_s[rows][[0, -1]]
        if not begin <= stamp_s <= end or end - begin > self.max_gap_s:
            return Taken()
        lat, lon, height = self.lat_lon_height[rows].T
        around = np.unwrap(lon, period=360)  # the shorter way round
        at = [float(np.interp(stamp_s, self.stamp_s[rows], v)) for v in (lat, around, height)]
        return Taken(lat_deg=at[0], lon_deg=(at[1] + 180) % 360 - 180, height_m=at[2], sigma_m=self.sigma_m)


def believed(readings: Readings) -> tuple[Readings, str]:
    """Readings with a fix and a small enough DOP, in order of their stamps; and how many were left out, why."""
    lat, lon, height = readings.lat_lon_height.T
    no_fix = (readings.fix < 2) | ((lat == 0) & (lon == 0))
    on_earth = (np.abs(lat) <= 90) & (np.abs(lon) <= 180) & ~(np.abs(height) > _MOST_HEIGHT_M)
    nowhere = ~no_fix & ~on_earth
    poor = ~no_fix & on_earth & (readings.dop > _MOST_DOP)
    reasons = {
        "without a fix": no_fix,
        f"with a DOP above {_MOST_DOP:g}": poor,
        "not on the Earth": nowhere,
    }
    words = ", ".join(f"{rows.sum()} {why}" for why, rows in reasons.items() if rows.any())
    good = readings.where(~(no_fix | nowhere | poor))
    good = good.where(np.argsort(good.stamp_s, kind="stable"))
    level = good.lat_lon_height.copy()
    level[good.fix == 2, 2] = np.nan
    first, last = RECORDED_RANGE_S
    time = np.where((good.time_s >= first) & (good.time_s <= last), good.time_s, np.nan)
    kept = replace(good, time_s=time, lat_lon_height=level)
    return kept, f"{len(kept)} of {len(readings)} fixes used" + (f" ({words} left out)" if words else "")


VIDEO = b"vide"
_MOST_SAMPLES = 1_000_000  # bound of memory: telemetry of 11 days, one a second


class BrokenTrack(ValueError):
    """Tables of a track, entries or records that contradict each other or the file; the text names them."""


@dataclass(frozen=True)
class Track:
    """A track: first and last byte of its box's contents, its kind and the format of its samples (four letters), and
    width and height of its pictures as in its header (8 bytes)."""

    span: tuple[int, int]
    kind: bytes
    format: bytes
    shown: bytes


@dataclass(frozen=True)
class Samples:
    """Place of the samples of a track in the file, bytes, and their start and duration, s. All (N,)."""

    offset: np.ndarray
    size: np.ndarray
    begin_s: np.ndarray
    length_s: np.ndarray


def tracks(file: BinaryIO) -> list[Track]:
    """The tracks in the header of an MP4 file, in its order; none for another file."""
    headers = boxes(file, b"moov", 0, file.seek(0, 2))
    spans = [span for header in headers for span in boxes(file, b"trak", *header)]
    return [
        Track(
            span,
            kind=_bytes(file, span, (b"mdia", b"hdlr"), 8, 4),
            format=_bytes(file, span, (*_TABLES, b"stsd"), 12, 4),
            shown=_bytes(file, span, (b"tkhd",), -8, 8),  # 8.3.2
        )
        for span in spans
    ]


_TABLES, _EDITS = (b"mdia", b"minf", b"stbl"), (b"edts", b"elst")


def _bytes(file: BinaryIO, span: tuple[int, int], path: Sequence[bytes], at: int, count: int) -> bytes:
    """Some bytes at a place of a box, from its end if that is negative; none if the box is shorter."""
    found = _inside(file, span, path)
    if found is None or found[1] - found[0] < max(at, 0) + count:
        return b""
    file.seek(found[at < 0] + at)
    return file.read(count)


def contents(file: BinaryIO, span: tuple[int, int], path: Sequence[bytes], most: int) -> bytes:
    """The first bytes of the box at the end of a path of boxes; none without it."""
    found = _inside(file, span, path)
    if found is None:
        return b""
    file.seek(found[0])
    return file.read(min(most, found[1] - found[0]))


def _inside(file: BinaryIO, span: tuple[int, int], path: Sequence[bytes]) -> tuple[int, int] | None:
    """The box at the end of a path of boxes, each the first of its kind."""
    found: tuple[int, int] | None = span
    for kind in path:
        found = next(boxes(file, kind, *found), None) if found else None
    return found


def samples(file: BinaryIO, track: Track) -> Samples:
    """Places and times of a track's samples. Raises BrokenTrack."""
    sizes = _sizes(file, track)
    offset = _offsets(file, track, sizes)
    scale = _scale(file, track.span, (b"mdia", b"mdhd"))
    steps = _table(file, track, b"stts", 8, ">u4", columns=2)  # 8.6.1.2: how many, how long
    counts = np.minimum(steps[:, 0], len(sizes)).astype(np.int64)
    length = np.repeat(steps[:, 1], _at_most(counts, len(sizes))).astype(float) / scale
    if len(length) < len(sizes):
        raise BrokenTrack(f"its table stts has times of {len(length)} samples of {len(sizes)}")
    delay_s, skipped_s = edits(file, track)
    return Samples(offset, sizes, begin_s=np.cumsum(length) - length + delay_s - skipped_s, length_s=length)


def edits(file: BinaryIO, track: Track) -> tuple[float, float]:
    """By its edit list (8.6.6) how long a track shows nothing at first, and how much of its samples is then cut
    off, s. Raises BrokenTrack."""
    whole = 0, file.seek(0, 2)
    if None in (_inside(file, track.span, _EDITS), _inside(file, whole, (b"moov", b"mvhd"))):
        return 0.0, 0.0
    data = contents(file, track.span, _EDITS, _MOST_SAMPLES)
    wide = data[:1] == b"\1"
    row = np.dtype([("length", ">u8" if wide else ">u4"), ("media", ">i8" if wide else ">i4"), ("rate", ">u4")])
    rows = np.frombuffer(data[8 : 8 + (len(data) - 8) // row.itemsize * row.itemsize], row)
    first = next(iter(np.flatnonzero(rows["media"] >= 0)), len(rows))
    delay_s = float(rows["length"][:first].sum()) / _scale(file, whole, (b"moov", b"mvhd")) if first else 0.0
    cut = float(rows["media"][first]) / _scale(file, track.span, (b"mdia", b"mdhd")) if first < len(rows) else 0.0
    return delay_s, cut


def _at_most(counts: np.ndarray, total: int) -> np.ndarray:
    """Counts (N,) cut off where their sum exceeds a total."""
    before = np.minimum(np.cumsum(counts) - counts, total)
    return np.minimum(counts, total - before)


def _scale(file: BinaryIO, span: tuple[int, int], path: Sequence[bytes]) -> int:
    """Units a second of the times of a track or a movie (8.2.2, 8.4.2)."""
    data = contents(file, span, path, 24)
    wide = data[:1] == b"\1"
    scale = int.from_bytes(data[20:24] if wide else data[12:16], "big")
    if not scale:
        raise BrokenTrack("its header has no time scale")
    return scale


def _sizes(file: BinaryIO, track: Track) -> np.ndarray:
    """(N,) bytes of each sample (8.7.3.2): one size for all, or a table."""
    data = contents(file, track.span, (*_TABLES, b"stsz"), 12)
    if len(data) < 12:
        raise BrokenTrack("it has no table stsz")
    size, count = (int(v) for v in np.frombuffer(data[4:], ">u4"))
    if count > _MOST_SAMPLES:
        raise BrokenTrack(f"its table stsz has {count} samples, more than the {_MOST_SAMPLES} that are read")
    if size:
        return np.full(count, size, np.int64)
    return _table(file, track, b"stsz", 12, ">u4")[:, 0].astype(np.int64)


def _offsets(file: BinaryIO, track: Track, sizes: np.ndarray) -> np.ndarray:
    """(N,) first byte of each sample: samples stand in chunks, one behind the other (8.7.4, 8.7.5)."""
    wide = _inside(file, track.span, (*_TABLES, b"co64")) is not None
    chunks = _table(file, track, b"co64" if wide else b"stco", 8, ">u8" if wide else ">u4")[:, 0]
    runs = _table(file, track, b"stsc", 8, ">u4", columns=3).astype(np.int64)  # first chunk from 1, samples in each
    if not len(sizes):
        return np.zeros(0, np.int64)
    firsts = np.append(runs[:, 0] - 1, len(chunks))
    if not len(runs) or firsts[0] or np.any(np.diff(firsts) < 0):
        raise BrokenTrack("its tables stsc and stco contradict each other")
    counts = np.minimum(np.repeat(runs[:, 1], np.diff(firsts)), len(sizes))
    chunk = np.repeat(np.arange(len(chunks)), _at_most(counts, len(sizes)))
    if len(chunk) < len(sizes):
        raise BrokenTrack(f"its tables stsc and stco have {len(chunk)} samples, stsz has {len(sizes)}")
    before = np.cumsum(sizes) - sizes
    new = np.diff(chunk, prepend=-1) != 0
    inside = before - before[np.flatnonzero(new)][np.cumsum(new) - 1]
    return chunks[chunk].astype(np.int64) + inside


def _table(file: BinaryIO, track: Track, kind: bytes, head: int, dtype: str, columns: int = 1) -> np.ndarray:
    """(N, columns) rows of a table box; their number is in the last four bytes of its head."""
    found = _inside(file, track.span, (*_TABLES, kind))
    name = kind.decode()
    if found is None or found[1] - found[0] < head:
        raise BrokenTrack(f"it has no table {name}")
    file.seek(found[0] + head - 4)
    count = int.from_bytes(file.read(4), "big")
    row = columns * np.dtype(dtype).itemsize
    there = (found[1] - found[0] - head) // row
    if count > there:
        raise BrokenTrack(f"its table {name} announces {count} rows and has room for {there}")
    if count > _MOST_SAMPLES:
        raise BrokenTrack(f"its table {name} has {count} rows, more than the {_MOST_SAMPLES} that are read")
    data = file.read(count * row)
    if len(data) < count * row:
        raise BrokenTrack(f"its table {name} is cut off")
    return np.frombuffer(data, dtype).reshape(-1, columns)


class OneVideoTrack(io.BufferedIOBase):
    """An MP4 file with only one of its video tracks: the boxes of the others are named free space."""

    def __init__(self, path: Path, number: int) -> None:
        """``number``: among the video tracks, from 0. Raises OSError."""
        self._file = regular(path, None).open("rb")
        videos = [t for t in tracks(self._file) if t.kind == VIDEO]
        self._hidden = []
        for track in videos[:number] + videos[number + 1 :]:  # the kind stands before the contents, or a long size
            self._file.seek(track.span[0] - 4)
            self._hidden.append(track.span[0] - (4 if self._file.read(4) == b"trak" else 12))
        self._file.seek(0)

    def read(self, size: int | None = -1, /) -> bytes:
        """As of a file; nothing if it can no longer be read, because the caller is not Python."""
        begin = self._file.tell()
        try:
            data = self._file.read(-1 if size is None else size)
        except OSError:
            return b""
        for at in self._hidden:
            first, last = max(at, begin), min(at + 4, begin + len(data))
            if first < last:
                data = data[: first - begin] + b"free"[first - at : last - at] + data[last - begin :]
        return data

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """As of a file."""
        return self._file.seek(offset, whence)

    def close(self) -> None:
        """As of a file."""
        self._file.close()
        super().close()


def boxes(file: BinaryIO, kind: bytes, begin: int, end: int) -> Iterator[tuple[int, int]]:
    """First and last byte of the contents of each box of a kind, among the boxes between two places of a file; of a
    box that is cut off, as far as it goes."""
    for _ in range(10_000):  # a file of more is damaged
        if end - begin < 8:
            return
        file.seek(begin)
        data = file.read(16)
        size, head = int.from_bytes(data[:4], "big"), 8
        if size == 1:  # the size is too large for 4 bytes
            size, head = int.from_bytes(data[8:16], "big"), 16
        elif size == 0:  # to the end
            size = end - begin
        if size < head:
            return
        if data[4:8] == kind:
            yield begin + head, min(begin + size, end)
        begin += size
