"""The times of a table, by what its columns are called: of any epoch, or GPS time, which becomes UTC.

A number says nothing of its scale: 1.4e9 is a day of 2014 in seconds since 1970 and one of 2024 in seconds since 1980.
So the name of the column decides, and where that says both, the user is asked.
"""

from dataclasses import dataclass

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.gpstime import DAY_S, GPS_EPOCH_S, WEEK_S, check_week, going_on, leap_seconds, utc_from_gps
from tiegraph.scene.table import Table

_ANY = ("time", "time_s", "t", "timestamp", "time_stamp", "utc", "utc_time", "datetime", "seconds", "sec", "epoch",
        "unix", "unix_time")  # fmt: skip
_GPS = ("gps_time", "gpstime", "gpst")
_SINCE_1980 = ("gps_seconds", "gps_s", "gps_epoch")
_WEEK = ("gps_week", "gpsweek", "week", "wn", "week_number")
_IN_WEEK = ("gps_sow", "sow", "gps_tow", "tow", "seconds_of_week", "gps_seconds_of_week", "time_of_week", "gps_week_s")
_UNITS = ("ns", "us", "ms")
_DATE = ("date", "utc_date", "day")
_OVER_S = 3600.0  # programs count on past the end of a week rather than jump


@dataclass(frozen=True)
class Times:
    """Times of a table: the column that they stand in (that an error names), (R,) seconds, NaN where there is none."""

    column: int
    seconds: np.ndarray
    period_s: float = 0.0  # seconds of a GPS week that no column names; 0 = from an epoch
    notes: tuple[str, ...] = ()


def times_of(table: Table) -> Times | None:
    """The times of a table; None if it has no column of times.

    Numbers of a column time, t, utc ... count from any epoch, texts are dates or times of day. A column gps_week with
    seconds of the week, gps_seconds (since 6 January 1980) and dates in a column gps_time are GPS time and become
    seconds since 1970, UTC. Raises InputError for a column gps_time of numbers that may be either, and for a week or
    seconds of it that are none.
    """
    week = table.find(_WEEK)
    column = _find(table, _ANY)
    if column is not None and (week is None or not _within_a_week(table, column)):
        seconds = table.times(column, table.find(_DATE))
        clock = ":" in table.cell(0, column) and np.nanmax(seconds, initial=0.0) < DAY_S
        return Times(column, going_on(seconds, DAY_S) if clock else seconds)
    column = _find(table, _IN_WEEK) if column is None else column
    if column is not None:
        return _of_week(table, week, column)
    column = _find(table, _SINCE_1980)
    if column is not None:
        return _gps(table, column, table.times(column))
    column = _find(table, _GPS)
    return None if column is None else _named_gps(table, week, column)


def _find(table: Table, names: tuple[str, ...]) -> int | None:
    found = table.find(names)
    return table.find(tuple(f"{n}_{u}" for n in names for u in _UNITS)) if found is None else found


def _within_a_week(table: Table, column: int) -> bool:
    """Whether a column holds numbers that may be seconds of a week."""
    numbers = table.numbers(column)
    known = numbers[np.isfinite(numbers)]
    return bool(len(known)) and bool(np.all((known >= 0) & (known <= WEEK_S + _OVER_S)))


def _named_gps(table: Table, week: int | None, column: int) -> Times:
    seconds = table.times(column, table.find(_DATE))
    numbers = table.numbers(column)
    if np.isnan(numbers).all():  # dates; times of day alone are of any clock
        dated = np.nanmax(seconds, initial=0.0) >= GPS_EPOCH_S
        return _gps(table, column, seconds - GPS_EPOCH_S) if dated else Times(column, seconds)
    if np.nanmax(np.abs(seconds), initial=0.0) <= WEEK_S + _OVER_S:
        return _of_week(table, week, column)
    row = int(np.flatnonzero(np.abs(seconds) > WEEK_S + _OVER_S)[0])
    raise InputError(
        f"{table.path}, line {table.line(row)}: {table.columns[column]} {table.cell(row, column)} may count from 1980 "
        "(GPS) or from 1970 (Unix, UTC): name the column gps_seconds, or unix_time"
    )


def _of_week(table: Table, week: int | None, column: int) -> Times:
    seconds = table.times(column)
    bad = np.flatnonzero((seconds < 0) | (seconds > WEEK_S + _OVER_S))
    if len(bad):
        raise InputError(
            f"{table.path}, line {table.line(bad[0])}: {table.columns[column]} {table.cell(bad[0], column)} is no "
            f"second of a week of {WEEK_S:.0f} s: give its unit, as in {table.columns[column]} (ms), or call a time of "
            "another kind time"
        )
    if week is None:
        return Times(column, going_on(seconds, WEEK_S), period_s=WEEK_S)
    weeks = table.numbers(week)
    for k in np.flatnonzero(np.isfinite(weeks)).tolist():
        check_week(weeks[k], f"{table.path}, line {table.line(k)}")
    return _gps(table, column, weeks * WEEK_S + seconds)


def _gps(table: Table, column: int, gps_s: np.ndarray) -> Times:
    seconds = np.where(np.isfinite(gps_s), utc_from_gps(np.nan_to_num(gps_s)), np.nan)
    return Times(column, seconds, notes=(gps_note(table.path.name, seconds),))


def gps_note(name: str, time_s: np.ndarray) -> str:
    """What to say of a file in GPS time whose times (R,) are UTC now."""
    leaps = leap_seconds(np.nanmedian(time_s)) if np.isfinite(time_s).any() else 0
    return f"{name}: GPS time, made UTC by taking off {leaps} leap seconds"
