"""The subtitles that DJI drones write beside their videos (``DJI_0001.SRT``): time and position of every frame.

Two forms. Newer drones: a date with fractions of a second and ``[latitude: 41.42] [longitude: 2.23] [rel_alt: 1.3
abs_alt: 132.9]`` (or ``[altitude: 117.0]``; the Mavic 2 writes ``longtitude``). Older ones, once a second:
``GPS(149.0251,-20.2532,16)`` with longitude, latitude and the number of satellites, or ``GPS(36.6146,-6.1120,0.0M)``
with latitude, longitude and a height. Dates are those of the controller, in its zone.
"""

import re
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from tiegraph.scene.exif import Taken
from tiegraph.scene.regular import regular

_SPAN = re.compile(r"(\d+):(\d\d):(\d\d)[,.](\d{1,3})\s*-->")
_DATE = re.compile(r"(\d{4})[-./](\d\d)[-./](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:[.,](\d{3})(?:[.,]?(\d{3}))?)?")
_NUMBER = r"\s*:?\s*([-+]?\d+(?:\.(\d+))?)"
_LAT, _LON = re.compile(r"\blatitude" + _NUMBER), re.compile(r"\blongt?itude" + _NUMBER)
_HEIGHT = re.compile(r"\b(?:abs_alt|altitude)" + _NUMBER)
_OLD = re.compile(r"\bGPS\s*\(\s*([-+]?\d+(?:\.(\d+))?)\s*,\s*([-+]?\d+(?:\.\d+)?)\s*,\s*([-+]?\d+(?:\.\d+)?)(M?)\s*\)")
_DEGREE_M = 111_320.0  # of latitude
_MOST_BYTES = 500_000_000  # bound of memory: ten hours at 30 frames a second


@dataclass(frozen=True)
class Subtitles:
    """Rows of a subtitle file by their stamps: positions (R, 3) latitude, longitude, height, NaN = none."""

    stamp_s: np.ndarray  # (R,)
    lat_lon_height: np.ndarray
    start_s: float  # of the video, seconds since 1970 in the drone's zone; NaN = no dates
    sigma_m: float  # NaN = finer than what a receiver is taken for

    def place(self, stamp_s: float) -> Taken:
        """Where the frame with a stamp was taken: by the last row that began before it."""
        row = int(np.searchsorted(self.stamp_s, stamp_s + 1e-3, side="right")) - 1
        lat, lon, height = (float(v) for v in self.lat_lon_height[max(row, 0)])
        return Taken(lat_deg=lat, lon_deg=lon, height_m=height, sigma_m=self.sigma_m)

    def notes(self, name: str) -> list[str]:
        """What a person should know of the file of a name."""
        placed = int(np.isfinite(self.lat_lon_height[:, 0]).sum())
        rows = f"{name}: {placed} of {len(self.stamp_s)} rows have a position"
        if np.isnan(self.start_s):
            return [f"{rows}, none a date"]
        when = datetime.fromtimestamp(self.start_s, timezone.utc).strftime("%Y-%m-%d %H:%M:%S")
        return [f"{rows}; the video begins at {when} in the drone's own clock and zone"]


def subtitles_of(video: Path) -> Path | None:
    """The file of the same name that ends in .SRT, if there is one."""
    return next((f for s in (".SRT", ".srt", ".Srt") if (f := video.with_suffix(s)).exists()), None)


def read_subtitles(file: Path, receiver_sigma_m: float) -> Subtitles | None:
    """Rows of a drone's subtitles; None if it is a file of other subtitles, or cannot be read."""
    try:
        text = regular(file, _MOST_BYTES).read_text("utf-8", errors="replace")
    except OSError:
        return None
    marks = list(_SPAN.finditer(text))
    ends = [m.start() for m in marks[1:]] + [len(text)]
    stamps, dates, places, digits = [], [], [], 15
    for mark, end in zip(marks, ends):
        row = text[mark.end() : end]
        hours, minutes, seconds, fraction = mark.groups()
        stamps.append(3600.0 * int(hours) + 60 * int(minutes) + int(seconds) + float(f"0.{fraction}"))
        dates.append(_date(row))
        place, exact = _place(row)
        places.append(place)
        digits = min(digits, exact)
    at, when, where = np.array(stamps), np.array(dates), np.array(places).reshape(-1, 3)
    if not (np.isfinite(when).any() or np.isfinite(where[:, 0]).any()):
        return None
    order = np.argsort(at, kind="stable")
    dated = np.isfinite(when)
    rounded_m = _DEGREE_M / 10**digits
    return Subtitles(
        stamp_s=at[order],
        lat_lon_height=where[order],
        start_s=float(np.median(when[dated] - at[dated])) if dated.any() else float("nan"),
        sigma_m=float(np.hypot(receiver_sigma_m, rounded_m)) if rounded_m > receiver_sigma_m else float("nan"),
    )


def _date(row: str) -> float:
    found = _DATE.search(row)
    if found is None:
        return float("nan")
    try:
        stamp = datetime(*(int(v) for v in found.groups()[:6]), tzinfo=timezone.utc)  # type: ignore[arg-type,misc]
    except ValueError:
        return float("nan")
    return stamp.timestamp() + float(f"0.{found[7] or ''}{found[8] or ''}0")


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
