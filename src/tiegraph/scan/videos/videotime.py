"""Time and place of a video: by the subtitles of a DJI drone beside it, by the fixes of the camera's own
receiver in the file, by its container, or from its own start."""

import re
import struct
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from tiegraph.scan.recording import RECORDED_RANGE_S, BrokenTrack, Fixes, Readings, believed, contents
from tiegraph.scan.settings import ScanSettings, VideoOffsets, video_offsets
from tiegraph.scan.telemetry import Telemetry, read_gpmf, read_trailer
from tiegraph.scene.atomic import regular
from tiegraph.scene.cells import date_text, seconds_of
from tiegraph.scene.exif import Taken
from tiegraph.scene.names import clean
from tiegraph.scene.times import DAY_S

_MP4_EPOCH_S = datetime(1904, 1, 1, tzinfo=timezone.utc).timestamp()  # ISO/IEC 14496-12, 8.2.2
CREATION_APART_S = 2.0  # creation times of two videos of a rig, in whole seconds, against their offset
_QUARTER_S = 900.0  # time zones are whole quarters of an hour ...
_ZONES_S = (-12 * 3600.0, 14 * 3600.0)  # ... in this range


@dataclass(frozen=True)
class VideoClock:
    """From the stamps of a video to times: ``start_s`` + stamp, seconds since 1970; not known: since the start."""

    start_s: float = 0.0
    known: bool = False
    utc: bool = False
    shared: bool = False  # with others: the stamps of messages, of which the start is one
    places: Fixes | None = None
    note: str = ""

    def taken(self, stamp_s: float) -> Taken:
        """Time and place of the frame with a stamp."""
        place = self.places.place(stamp_s) if self.places is not None else Taken()
        return replace(place, time_s=self.start_s + stamp_s, utc=self.utc)


def video_clock(video: Path, settings: ScanSettings) -> VideoClock:
    """The clock of a video, with ``scan.video_offset`` of all videos applied; never raises for a broken file."""
    name, told = clean(video.name), video_offsets(settings.video_offset)
    file = next((f for s in (".SRT", ".srt", ".Srt") if (f := video.with_suffix(s)).exists()), None)
    subtitles = None if file is None else by_subtitles(file, settings)
    if subtitles is not None and subtitles.known:
        return replace(subtitles, start_s=subtitles.start_s + told.all_s)
    notes = [] if subtitles is None else [subtitles.note]
    if file is not None and subtitles is None:
        notes.append(f"{clean(file.name)}: subtitles, but no times or positions of a DJI drone in them: not used")
    clock, length_s = _container(video, told)
    telemetry = None if subtitles is not None else read_gpmf(video, settings.max_gap_s)
    if telemetry is not None:
        clock = _by_telemetry(telemetry, clock, told.all_s)
    elif subtitles is None:
        clock = _by_trailer(video, clock, length_s, settings.max_gap_s)
    notes.append(f"{name}: {clock.note}")
    return replace(clock, places=subtitles.places if subtitles else clock.places, note="; ".join(notes))


def _by_telemetry(telemetry: Telemetry, clock: VideoClock, all_s: float) -> VideoClock:
    """The clock of a video whose fixes are on its own clock; ``clock``: of its container, ``all_s`` later."""
    if np.isnan(telemetry.start_s):
        return replace(clock, places=telemetry.fixes, note=f"{clock.note}; {telemetry.note}")
    note, apart = telemetry.note, abs(clock.start_s - all_s - telemetry.start_s) / DAY_S
    if clock.utc and apart > 1.1:  # farther than any time zone
        note += f"; its creation time is {apart:.0f} days from that and not used: set the camera's clock"
    return VideoClock(telemetry.start_s + all_s, known=True, utc=True, places=telemetry.fixes, note=note)


def _by_trailer(video: Path, clock: VideoClock, length_s: float, max_gap_s: float) -> VideoClock:
    """The clock of a video whose fixes, if any, have times in UTC and no stamps."""
    try:
        readings = read_trailer(video)
    except (BrokenTrack, OSError) as error:
        said = f"its Insta360 trailer cannot be read ({error}): no positions from it"
        return replace(clock, note=f"{clock.note}; {said}")
    if readings is None:
        return clock
    kept, words = believed(readings)
    kept = kept.where(np.argsort(kept.time_s, kind="stable")[: int(np.isfinite(kept.time_s).sum())])
    said = f"positions from its Insta360 trailer: {words}"
    zone_s = _zone(kept, clock, length_s)
    if not len(kept) or zone_s is None:
        why = "" if not len(kept) else ", but their times are not those of the recording (--scan.video-offset SECONDS)"
        return replace(clock, note=f"{clock.note}; {said}{why}: none used")
    if zone_s:
        said += f"; its creation time is local, {-zone_s / 3600:+g} h from UTC by these fixes: times are UTC"
    start = clock.start_s + zone_s
    fixes = Fixes(kept.time_s - start, kept.lat_lon_height, max_gap_s)
    return VideoClock(start, known=True, utc=True, places=fixes, note=f"{clock.note}; {said}")


def _zone(fixes: Readings, clock: VideoClock, length_s: float) -> float | None:
    """Seconds to add to the start of a recording to get UTC, by its fixes; None if no time zone makes them
    those of the recording."""
    if not len(fixes) or not clock.known:
        return None
    stamp_s = fixes.time_s - clock.start_s
    if np.mean((stamp_s >= 0) & (stamp_s <= length_s)) >= 0.9:
        return 0.0
    apart = float(stamp_s[0] + stamp_s[-1] - length_s) / 2
    zone = _QUARTER_S * round(apart / _QUARTER_S)
    # A receiver may find its first fix late
    fits = _ZONES_S[0] <= -zone <= _ZONES_S[1] and abs(apart - zone) <= 60.0
    return zone if fits else None


def _container(video: Path, told: VideoOffsets) -> tuple[VideoClock, float]:
    """The clock in the header of a file, and the length of the recording (s)."""
    time_s, length_s = _created(video) or (0.0, 0.0)
    if not RECORDED_RANGE_S[0] <= time_s <= RECORDED_RANGE_S[1]:
        remedy = "--scan.video-offset gives its start (seconds since 1970)"
        said = f"it has no recording time: its times count from its start; {remedy}"
        return VideoClock(told.all_s, known=told.all_s != 0, note=said), length_s
    start = time_s - (length_s if told.from_end else 0.0)
    doubt = "which has whole seconds and may be local or that of its end (--scan.video-offset SECONDS, or end)"
    said = f"begins at {date_text(start)} UTC by the creation time in it, {doubt}"
    return VideoClock(start + told.all_s, known=True, utc=True, note=said), length_s


def _created(video: Path) -> tuple[float, float] | None:
    """Creation time (seconds since 1970) and length (s) in the movie header of an MP4 or QuickTime file."""
    try:
        with regular(video, None).open("rb") as file:
            data = contents(file, (0, file.seek(0, 2)), (b"moov", b"mvhd"), 32)
            created, _, scale, length = struct.unpack_from(">QQIQ" if data[0] == 1 else ">IIII", data, 4)
    except (OSError, struct.error, IndexError):
        return None
    return created + _MP4_EPOCH_S, length / scale if scale else 0.0


# The subtitles that DJI drones write beside their videos (``DJI_0001.SRT``): time and position of every frame.
#
# Two forms. Newer drones: a date with fractions of a second and ``[latitude: 41.42] [longitude: 2.23] [rel_alt: 1.3
# abs_alt: 132.9]`` (or ``[altitude: 117.0]``; the Mavic 2 writes ``longtitude``). Older ones, once a second:
# ``GPS(149.0251,-20.2532,16)`` with longitude, latitude and the number of satellites, or ``GPS(36.6146,-6.1120,0.0M)``
# with latitude, longitude and a height. Dates are those of the controller, in its zone.


_STAMP = r"(\d+):(\d\d):(\d\d)[,.](\d{1,3})"
_SPAN = re.compile(_STAMP + r"\s*-->\s*" + _STAMP)
_DATE = re.compile(r"(\d{4})[-./](\d\d)[-./](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:[.,](\d{3})(?:[.,]?(\d{3}))?)?")
_NUMBER = r"\s*:?\s*([-+]?\d+(?:\.(\d+))?)"
_LAT, _LON = re.compile(r"\blatitude" + _NUMBER), re.compile(r"\blongt?itude" + _NUMBER)
_HEIGHT = re.compile(r"\b(?:abs_alt|altitude)" + _NUMBER)
_OLD = re.compile(r"\bGPS\s*\(\s*([-+]?\d+(?:\.(\d+))?)\s*,\s*([-+]?\d+(?:\.\d+)?)\s*,\s*([-+]?\d+(?:\.\d+)?)(M?)\s*\)")
_DEGREE_M = 111_320.0  # of latitude
_MOST_BYTES = 500_000_000  # bound of memory: ten hours at 30 frames a second


def by_subtitles(file: Path, settings: ScanSettings) -> VideoClock | None:
    """The clock of a video, in the drone's zone, and positions at the begin of each row of its subtitles, the last one
    until it ends; not known without dates. None if it has other subtitles, or they cannot be read."""
    try:
        text = regular(file, _MOST_BYTES).read_text("utf-8", errors="replace")
    except OSError:
        return None
    marks = list(_SPAN.finditer(text))
    stamps, dates, places, digits = [], [], [], 15
    for mark, following in zip(marks, [*marks[1:], None]):
        row = text[mark.end() : following.start() if following else len(text)]
        stamps.append([_stamp(*mark.groups()[:4]), _stamp(*mark.groups()[4:])])
        dates.append(_date(row))
        place, exact = _place(row)
        places.append(place)
        digits = min(digits, exact)
    spans, when, where = np.array(stamps).reshape(-1, 2), np.array(dates), np.array(places).reshape(-1, 3)
    dated, placed = np.isfinite(when), np.isfinite(where[:, 0])
    if not (dated.any() or placed.any()):
        return None
    order = np.argsort(spans[:, 0], kind="stable")
    rounded_m, receiver_m = _DEGREE_M / 10**digits, settings.gnss_sigma_m
    fixes = Fixes(
        stamp_s=np.append(spans[order, 0], spans[order[-1], 1]),
        lat_lon_height=where[[*order, order[-1]]],
        max_gap_s=settings.max_gap_s,
        sigma_m=float(np.hypot(receiver_m, rounded_m)) if rounded_m > receiver_m else float("nan"),
    )
    note = f"{clean(file.name)}: {placed.sum()} of {len(placed)} rows have a position"
    if not dated.any():
        return VideoClock(places=fixes, note=f"{note}, none has a date")
    start = float(np.median(when[dated] - spans[dated, 0]))
    note += f"; the video begins at {date_text(start)} in the drone's own clock and zone"
    return VideoClock(start, known=True, places=fixes, note=note)


def _stamp(hours: str, minutes: str, seconds: str, fraction: str) -> float:
    return 3600.0 * int(hours) + 60 * int(minutes) + int(seconds) + float(f"0.{fraction}")


def _date(row: str) -> float:
    found = _DATE.search(row)
    if found is None:
        return float("nan")
    return seconds_of("".join(found.groups()[:6]), "%Y%m%d%H%M%S") + float(f"0.{found[7] or ''}{found[8] or ''}0")


def _place(row: str) -> tuple[tuple[float, float, float], int]:
    """Latitude, longitude, height and the decimals of the degrees; NaN without a fix, which is written as 0, 0."""
    lat, lon, height = _LAT.search(row), _LON.search(row), _HEIGHT.search(row)
    old = _OLD.search(row)
    if lat and lon:
        place = float(lat[1]), float(lon[1]), float(height[1]) if height else float("nan")
        digits = len(lat[2] or "")
    elif old:
        one, other, third = float(old[1]), float(old[3]), float(old[4])
        place = (one, other, third if third else float("nan")) if old[5] else (other, one, float("nan"))
        digits = len(old[2] or "")
    else:
        return (float("nan"),) * 3, 15
    return (place, digits) if place[:2] != (0.0, 0.0) else ((float("nan"),) * 3, 15)
