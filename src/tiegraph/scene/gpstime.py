"""GPS time, which knows no leap seconds, and UTC as seconds since 1970, which are the times of this program.

GPS - UTC has changed on the dates below (IERS Bulletin C; IS-GPS-200). During a leap second UTC counts the second after
it twice, as POSIX does.
"""

from datetime import datetime, timezone

import numpy as np

from tiegraph.errors import InputError

GPS_EPOCH_S = 315964800.0  # 6 January 1980, 0 h UTC, in seconds since 1970
WEEK_S = 604800.0
DAY_S = 86400.0
_FIRST_FULL_WEEK = 1024  # 22 August 1999; receivers that count weeks in ten bits begin again at 0 there
_LEAP_DAYS = (
    "1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01",
    "1993-07-01", "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01",
    "2015-07-01", "2017-01-01",
)  # fmt: skip
_CHANGES = np.array([datetime.fromisoformat(d).replace(tzinfo=timezone.utc).timestamp() for d in _LEAP_DAYS])
_CHANGES_GPS = _CHANGES - GPS_EPOCH_S + np.arange(1, len(_CHANGES) + 1)


def utc_from_gps(gps_s: np.ndarray) -> np.ndarray:
    """Seconds since 1970, UTC, of seconds since the GPS epoch."""
    gps_s = np.asarray(gps_s, float)
    return GPS_EPOCH_S + gps_s - np.searchsorted(_CHANGES_GPS, gps_s, side="right")


def gps_from_utc(time_s: np.ndarray) -> np.ndarray:
    """Seconds since the GPS epoch of seconds since 1970, UTC."""
    time_s = np.asarray(time_s, float)
    return time_s - GPS_EPOCH_S + leap_seconds(time_s)


def going_on(seconds: np.ndarray, period_s: float) -> np.ndarray:
    """Times (R,) that count within a day or a week, NaN = unknown, going on where one ends: a step back by more than
    half of it is its end."""
    known = np.isfinite(seconds)
    out = np.array(seconds, float)
    steps = np.diff(out[known], prepend=out[known][:1])
    out[known] += period_s * np.cumsum(-np.round(steps / period_s))
    return out


def leap_seconds(time_s: np.ndarray) -> np.ndarray:
    """GPS - UTC in seconds at seconds since 1970, UTC."""
    return np.searchsorted(_CHANGES, np.asarray(time_s, float), side="right")


def check_week(week: float, where: str) -> None:
    """Raise InputError, naming where it stands, for a week that is no whole GPS week counted since 1980."""
    if not (week == int(week) and _FIRST_FULL_WEEK <= week < 5 * _FIRST_FULL_WEEK):
        raise InputError(
            f"{where}: GPS week {week:g} is none since 1999: write the full count of weeks since 6 January 1980, not "
            "the one modulo 1024"
        )
