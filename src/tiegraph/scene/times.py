"""Times: GPS time and UTC as seconds since 1970, which are the times of this program; and the times of a table.

GPS time has no leap seconds. GPS - UTC has changed on the dates below (IERS Bulletin C; IS-GPS-200). During a leap
second UTC counts the second after it twice, as POSIX does.

A number in a table does not show its scale: 1.4e9 is a day of 2014 in seconds since 1970 and one of 2024 in seconds
since 1980. So the name of the column decides, and if that allows both, the user is asked.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.cells import UNIT_S, in_seconds, parse_time
from tiegraph.scene.table import Table

GPS_EPOCH_S = 315964800.0  # 6 January 1980, 0 h UTC, in seconds since 1970
WEEK_S = 604800.0
DAY_S = 86400.0
DATED_S = 1e8  # 1973: times above this are dates
ROLLOVER_WEEKS = 1024  # receivers that count weeks in ten bits begin again at 0, first on 22 August 1999
_SEAM_S = 60.0  # largest step between rows on both sides of midnight
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
    """Times (R,) that count within a day or a week, NaN = unknown, continued at its end; a step back by more than
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
        seam = back + period_s  # time between the rows on both sides of the end
        inside = np.all((known >= 0) & (known <= period_s))
        if inside and np.any((back < -period_s / 2) & (seam >= 0) & (seam <= _SEAM_S)):
            return period_s
    return 0.0


def laid_on(time_s: np.ndarray, period_s: float, frames_s: np.ndarray) -> tuple[np.ndarray, str]:
    """Times (R,) on the clock of frames (F,), and notes.

    Times that count within a day or a GPS week (``period_s``, else 0) become those of the day or week nearest to the
    frames; where these have no dates only if both then overlap. Dates 1024 weeks back are brought forward.
    """
    rows, frames = time_s[np.isfinite(time_s)], frames_s[np.isfinite(frames_s)]
    if not len(rows) or not len(frames):
        return time_s, ""
    middle, own = float(np.median(frames)), float(np.median(rows))
    dated, weekly = middle >= DATED_S, period_s > DAY_S
    turn = period_s or (ROLLOVER_WEEKS * WEEK_S)
    anchor = float(gps_from_utc(np.array(middle))) if dated and weekly else middle
    turns = round((anchor - own) / turn)
    moved = time_s + turns * turn
    if dated and period_s:
        return (utc_from_gps(moved) if weekly else moved), ""
    margin = 0.0 if period_s else DAY_S  # for another zone
    overlap = np.nanmin(moved) <= frames.max() + margin and np.nanmax(moved) >= frames.min() - margin
    if period_s:
        return (moved if overlap else time_s), ""
    if turns < 1 or own < DATED_S or not overlap:
        return time_s, ""
    weeks = f"{turns * ROLLOVER_WEEKS} weeks"
    note = f"its dates lie {weeks} before the frames', where a receiver's count of weeks began again: {weeks} added"
    return moved, note


def leap_seconds(time_s: np.ndarray) -> np.ndarray:
    """GPS - UTC in seconds at seconds since 1970, UTC."""
    return np.searchsorted(_CHANGES, np.asarray(time_s, float), side="right")


def check_week(week: float, where: str) -> None:
    """Raise InputError, naming the place, for a number that is no whole GPS week counted since 1980."""
    if not (week == int(week) and ROLLOVER_WEEKS <= week < 5 * ROLLOVER_WEEKS):
        raise InputError(
            f"{where}: GPS week {week:g} is none since 1999: write the full count of weeks since 6 January 1980, not "
            "the one modulo 1024"
        )


def in_time_order(time_s: np.ndarray, line: Sequence[int], path: Path) -> tuple[np.ndarray, list[str]]:
    """Rows of a file with times (R,) in their order, the first of each time, and notes; ``line`` of each.
    Raises InputError for one time for all."""
    notes, order = [], np.argsort(time_s, kind="stable")
    for k in (np.flatnonzero(np.diff(time_s) < 0) + 1)[:1].tolist():
        notes.append(
            f"{path.name}, line {line[k]}: rows are not in time order and were sorted "
            f"({time_s[k]:.2f} s after {time_s[k - 1]:.2f} s)"
        )
    twin = np.diff(time_s[order], prepend=-np.inf) <= 1e-9
    if twin.any():
        first = int(order[twin][0])
        if twin.sum() == len(order) - 1:
            raise InputError(
                f"{path}, line {line[first]}: all {len(order)} rows have the time {time_s[first]:.2f} s: give the time "
                "of each row, or a table with a column image"
            )
        notes.append(
            f"{path.name}, line {line[first]}: {twin.sum()} rows have the time of another row and are left out, as at "
            f"{time_s[first]:.2f} s"
        )
    return order[~twin], notes


TIME_LIMIT_S = 1e11  # the year 5138: larger numbers are no time in seconds
_OVER_S = 3600.0  # programs continue past the end of a week rather than jump


@dataclass(frozen=True)
class Times:
    """Times of a table: (R,) seconds, NaN where there is none, and their columns by role."""

    seconds: np.ndarray
    used: dict[str, int | None]
    period_s: float = 0.0  # of a day or a GPS week that no column names; 0 = from an epoch
    notes: tuple[str, ...] = ()

    @property
    def column(self) -> int:
        """The column named in errors."""
        return next(k for k in self.used.values() if k is not None)


def times_of(table: Table) -> Times | None:
    """The times of a table; None if it has no column of times.

    Numbers of a column time, t, utc ... count from any epoch, texts are dates or times of day. A column gps_week with
    seconds of the week, gps_seconds (since 6 January 1980) and dates in a column gps_time are GPS time and become
    seconds since 1970, UTC. Raises InputError for a column gps_time of ambiguous numbers, and for an invalid week or
    seconds of it.
    """
    week, column = table.find("GPS week"), table.find("time")
    if column is not None:
        known = np.zeros(0) if week is None else table.numbers(column)
        known = known[np.isfinite(known)]
        if not len(known) or not np.all((known >= 0) & (known <= WEEK_S + _OVER_S)):
            return times_in(table, column)
    column = table.find("seconds of the week") if column is None else column
    if column is not None:
        return _of_week(table, week, column)
    column = table.find("seconds since 1980")
    if column is not None:
        return _gps(table, {"seconds since 1980": column}, _seconds(table, column))
    column = table.find("GPS time")
    if column is not None:
        return _named_gps(table, week, column)
    column = _date(table)
    return None if column is None else Times(_seconds(table, column), {"date": column})


def times_in(table: Table, column: int) -> Times:
    """The times of a column of numbers from any epoch, of dates, or of times of day, perhaps with a column of dates."""
    date = _date(table)
    seconds = _seconds(table, column, date)
    clock = ":" in table.cell(0, column) and np.nanmax(seconds, initial=0.0) < DAY_S
    period = DAY_S if clock else period_of(seconds)
    return Times(going_on(seconds, period) if period else seconds, {"time": column, "date": date}, period)


def _date(table: Table) -> int | None:
    """The column of dates, if it has some: in English a datum is none."""
    column = table.find("date")
    first = next((c for k in range(len(table.rows)) if (c := table.cell(k, column))), "")
    return column if parse_time(first) == parse_time(first) else None


def _seconds(table: Table, column: int, date: int | None = None) -> np.ndarray:
    """(R,) seconds of a time column: numbers, ISO 8601, or hh:mm:ss with a date column; NaN where there is none."""
    cells = [table.plain(k, column) for k in range(len(table.rows))]
    if date is not None:
        cells = [f"{table.cell(k, date)} {c}" for k, c in enumerate(cells)]
    seconds = np.array([parse_time(c) for c in cells], float)
    unit = UNIT_S.get(table.unit(column))
    seconds = in_seconds(seconds) if unit in (None, 1.0) else seconds * unit
    return np.where(np.abs(seconds) <= TIME_LIMIT_S, seconds, np.nan)


def _named_gps(table: Table, week: int | None, column: int) -> Times:
    seconds = _seconds(table, column, _date(table))
    used = {"GPS time": column, "date": _date(table)}
    if np.isnan(table.numbers(column)).all():  # dates; times of day alone are of any clock
        dated = np.nanmax(seconds, initial=0.0) >= GPS_EPOCH_S
        return _gps(table, used, seconds - GPS_EPOCH_S) if dated else Times(seconds, used)
    most = np.nanmax(np.abs(seconds), initial=0.0)
    if most <= WEEK_S + _OVER_S or week is not None:
        return _of_week(table, week, column, 1.0 if most <= WEEK_S + _OVER_S else 1e-3)  # ArduPilot: milliseconds
    row = int(np.flatnonzero(np.abs(seconds) > WEEK_S + _OVER_S)[0])
    raise InputError(
        f"{table.where(row)}: {table.columns[column]} {table.cell(row, column)} can count from 1980 (GPS) or from 1970 "
        "(Unix, UTC): name the column gps_seconds, or unix_time"
    )


def _of_week(table: Table, week: int | None, column: int, unit_s: float = 1.0) -> Times:
    seconds = _seconds(table, column) * unit_s
    bad = np.flatnonzero((seconds < 0) | (seconds > WEEK_S + _OVER_S))
    if len(bad):
        raise InputError(
            f"{table.where(bad[0])}: {table.columns[column]} {table.cell(bad[0], column)} is no second of a week of "
            f"{WEEK_S:.0f} s: give its unit, as in {table.columns[column]} (ms), or call a time of another kind time"
        )
    used = {"seconds of the week": column, "GPS week": week}
    if week is None:
        return Times(going_on(seconds, WEEK_S), used, WEEK_S)
    weeks = table.numbers(week)
    for k in np.flatnonzero(np.isfinite(weeks)).tolist():
        check_week(weeks[k], table.where(k))
    return _gps(table, used, weeks * WEEK_S + seconds)


def _gps(table: Table, used: dict[str, int | None], gps_s: np.ndarray) -> Times:
    seconds = np.where(np.isfinite(gps_s), utc_from_gps(np.nan_to_num(gps_s)), np.nan)
    return Times(seconds, used, notes=(gps_note(table.path.name, seconds),))


def gps_note(name: str, time_s: np.ndarray) -> str:
    """A note on a file in GPS time whose times (R,) are UTC now."""
    leaps = leap_seconds(np.nanmedian(time_s)) if np.isfinite(time_s).any() else 0
    return f"{name}: GPS time, made UTC by taking off {leaps} leap seconds"
