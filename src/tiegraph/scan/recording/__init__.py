"""Data that a camera wrote into its files beside the pictures: tracks, GNSS fixes, the factory's calibration.

A ``Recording`` names one film: a file, a track of one, or a topic of a bag.
``tracks`` reads the tables of an MP4 file, and shows OpenCV one video track of several: its FFmpeg reads only the
first (``CAP_PROP_VIDEO_STREAM`` is refused), but reads from a Python stream, in which the other tracks are
named free space. GoPro's telemetry is a track of key, length, value (``gpmf``), Insta360's a trailer behind
the last box (``insta360``). Both give ``Fixes``, positions by the stamps of the video. The factory's calibration of
the lenses of an Insta360 is a string of numbers (``insta360``).

Of the libraries, telemetry-parser 0.3.0 (MIT or Apache) leaves GPS9 as bytes, does not read the index of a trailer and
has no wheel for Python 3.13. The needed part of both formats is a table, so it is read here, each size checked before
it is used.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tiegraph.scan.tuning import PicturesTuning
from tiegraph.scene.bags import shown
from tiegraph.scene.exif import Taken
from tiegraph.scene.names import clean
from tiegraph.scene.sorting import Columns


@dataclass(frozen=True)
class Recording:
    """One video for the rest of scan: a file, one of the video tracks of a file, from 0, or an image topic of a
    bag."""

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
    """Positions of the receiver at stamps of the video, increasing; height NaN = not known."""

    stamp_s: np.ndarray  # (R,)
    lat_lon_height: np.ndarray  # (R, 3) degrees, m
    max_gap_s: float

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
        return Taken(lat_deg=at[0], lon_deg=(at[1] + 180) % 360 - 180, height_m=at[2])


def believed(readings: Readings, tuning: PicturesTuning) -> tuple[Readings, str]:
    """Readings with a fix and a small enough DOP, in order of their stamps; and how many were left out, why."""
    lat, lon, height = readings.lat_lon_height.T
    no_fix = (readings.fix < 2) | ((lat == 0) & (lon == 0))
    on_earth = (np.abs(lat) <= 90) & (np.abs(lon) <= 180) & ~(np.abs(height) > _MOST_HEIGHT_M)
    nowhere = ~no_fix & ~on_earth
    poor = ~no_fix & on_earth & (readings.dop > tuning.most_dop)
    reasons = {
        "without a fix": no_fix,
        f"with a DOP above {tuning.most_dop:g}": poor,
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
