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
DATED_S = 1e8  # 1973: times above this are dates
ROLLOVER_WEEKS = 1024  # receivers that count weeks in ten bits begin again at 0, first on 22 August 1999
ROLLOVER_S = ROLLOVER_WEEKS * WEEK_S
_SEAM_S = 60.0  # rows on both sides of midnight lie no farther apart
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


def period_of(seconds: np.ndarray) -> float:
    """The day or week within which times (R,) without dates count, if they start again at its end; else 0."""
    known = seconds[np.isfinite(seconds)]
    back = np.diff(known)
    for period_s in (DAY_S, WEEK_S):
        seam = back + period_s  # what lies between the rows on both sides of the end
        inside = np.all((known >= 0) & (known <= period_s))
        if inside and np.any((back < -period_s / 2) & (seam >= 0) & (seam <= _SEAM_S)):
            return period_s
    return 0.0


def laid_on(time_s: np.ndarray, period_s: float, frames_s: np.ndarray) -> tuple[np.ndarray, str]:
    """Times (R,) on the clock of frames (F,), and what to say of it.

    Times that count within a day or a GPS week (``period_s``, else 0) become those of the day or week nearest to the
    frames; where these have no dates only if both then overlap. Dates 1024 weeks back are brought forward.
    """
    rows, frames = time_s[np.isfinite(time_s)], frames_s[np.isfinite(frames_s)]
    if not len(rows) or not len(frames):
        return time_s, ""
    middle, own = float(np.median(frames)), float(np.median(rows))
    dated, weekly = middle >= DATED_S, period_s > DAY_S
    turn = period_s or ROLLOVER_S
    anchor = float(gps_from_utc(np.array(middle))) if dated and weekly else middle
    turns = round((anchor - own) / turn)
    moved = time_s + turns * turn
    if dated and weekly:
        return utc_from_gps(moved), ""
    if dated and period_s:
        return moved, ""
    margin = 0.0 if period_s else DAY_S  # for another zone
    overlap = np.nanmin(moved) <= frames.max() + margin and np.nanmax(moved) >= frames.min() - margin
    if period_s:
        return (moved if overlap else time_s), ""
    if turns < 1 or own < DATED_S or not overlap:
        return time_s, ""
    weeks = f"{turns * ROLLOVER_WEEKS} weeks"
    return (
        moved,
        f"its dates lie {weeks} before the frames', where a receiver's count of weeks began again: {weeks} added",
    )


def leap_seconds(time_s: np.ndarray) -> np.ndarray:
    """GPS - UTC in seconds at seconds since 1970, UTC."""
    return np.searchsorted(_CHANGES, np.asarray(time_s, float), side="right")


def check_week(week: float, where: str) -> None:
    """Raise InputError, naming where it stands, for a week that is no whole GPS week counted since 1980."""
    if not (week == int(week) and ROLLOVER_WEEKS <= week < 5 * ROLLOVER_WEEKS):
        raise InputError(
            f"{where}: GPS week {week:g} is none since 1999: write the full count of weeks since 6 January 1980, not "
            "the one modulo 1024"
        )
