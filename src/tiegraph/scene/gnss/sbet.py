"""Smoothed best estimate of trajectory (Applanix POSPac, also written by other INS software): 17 doubles a record.

Time (s of the GPS week), latitude and longitude (rad), altitude (m above the ellipsoid), velocities x, y, z, roll,
pitch, platform heading, wander angle, accelerations x, y, z, angular rates x, y, z; little-endian, without a header.
"""

from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.gnss.fixes import Fixes
from tiegraph.scene.gpstime import WEEK_S

_FIELDS = 17
_RECORD = 8 * _FIELDS
_ENOUGH_S = 0.05  # between rows: what carries a camera leaves a straight line by millimetres in that time
_STEP_S = 10.0  # between two records, at most; they are written some 200 times a second


def is_sbet(text: str, raw: bytes) -> bool:
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
        and np.any(np.abs(records[:, 1:3]) > 1e-6)  # numbers, not the tiny ones that other bytes look like
    )


def _records(raw: bytes) -> np.ndarray:
    whole = len(raw) // _RECORD
    return np.frombuffer(raw[: whole * _RECORD], "<f8").reshape(whole, _FIELDS)


def read_sbet(path: Path, raw: bytes) -> Fixes:
    """Records of an SBET file; the week is that of the frames. Raises InputError for one that is cut off."""
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
        f"{path.name}: an SBET file has seconds of the GPS week and no week: that of the frames' times (UTC) is taken; "
        f"its angles are not used{thinned}"
    ]
    return Fixes(path=path, line=line, lat_lon_height=llh, time_s=records[:, 0], notes=notes, period_s=WEEK_S)
