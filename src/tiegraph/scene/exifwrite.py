"""When and where a picture was taken, as EXIF that ``exif.read_exif`` and other programs read."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from PIL import Image

from tiegraph.scene import exif as tags


@dataclass(frozen=True)
class Taken:
    """When (seconds since 1970) and where a picture was taken; NaN = unknown."""

    time_s: float = tags.NAN
    utc: bool = False  # else in the camera's own clock
    lat_deg: float = tags.NAN
    lon_deg: float = tags.NAN
    height_m: float = tags.NAN
    sigma_m: float = tags.NAN


def exif_of(taken: Taken) -> Image.Exif:
    """EXIF 2.32 block: time to the microsecond, position to 0.1 mm."""
    block = Image.Exif()
    if np.isfinite(taken.time_s):
        when = datetime(1970, 1, 1) + timedelta(microseconds=round(taken.time_s * 1e6))
        detail = block.get_ifd(tags.EXIF_IFD)
        detail[tags.TIME_ORIGINAL] = f"{when:%Y:%m:%d %H:%M:%S}"
        detail[tags.SUBSEC_ORIGINAL] = f"{when.microsecond:06d}"
        if taken.utc:
            detail[tags.OFFSET_ORIGINAL] = "+00:00"
    if np.isfinite(taken.lat_deg) and np.isfinite(taken.lon_deg):
        _write_place(block.get_ifd(tags.GPS_IFD), taken)
    return block


def _write_place(gps: dict[int, Any], taken: Taken) -> None:
    for key, value, words in ((1, taken.lat_deg, "NS"), (3, taken.lon_deg, "EW")):
        gps[key] = words[value < 0]
        gps[key + 1] = _sexagesimal(abs(value))
    if np.isfinite(taken.height_m):
        gps[5], gps[6] = b"\x01" if taken.height_m < 0 else b"\x00", abs(taken.height_m)
    if np.isfinite(taken.sigma_m):
        gps[31] = taken.sigma_m


def _sexagesimal(degrees: float) -> tuple[float, float, float]:
    minutes, seconds = divmod(round(degrees * 3600, 6), 60)
    return float(minutes // 60), float(minutes % 60), round(seconds, 6)
