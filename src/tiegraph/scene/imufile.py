"""Files of an inertial unit: a table with a header that names time, angular rates and accelerations, as EuRoC's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.table import Table, read_table

FORM = "time,gx,gy,gz,ax,ay,az (s, rad/s, m/s2)"
_TIME = ("time", "timestamp", "t", "time_s", "time_ns", "timestamp_ns", "stamp")
_RATE = ("g{}", "gyro_{}", "w{}", "w_rs_s_{}", "rate_{}", "angular_velocity_{}")
_FORCE = ("a{}", "accel_{}", "acc_{}", "a_rs_s_{}", "linear_acceleration_{}")
_FASTEST = 40.0  # rad/s that no such unit measures: most end at 35 (2000 deg/s)
_GRAVITY = (7.5, 12.5)  # m/s2 within which the median of the accelerations' lengths is, for every unit feels gravity
_LEAST = 10  # rows


@dataclass(frozen=True)
class ImuFile:
    """Measurements in the order of their times: time_s (N,), rate (N, 3) rad/s and force (N, 3) m/s2 (specific: at rest
    it points up), along the axes of the unit."""

    time_s: np.ndarray
    rate: np.ndarray
    force: np.ndarray


def read_imu(path: Path) -> ImuFile:
    """Read a table of an inertial unit.

    Raises InputError with the line for a column that is missing, values that are none, times that do not increase,
    rates in degrees, and accelerations in g or without gravity.
    """
    table = read_table(path, "inertial measurements")
    time_s = table.times(_column(table, _TIME, "time"))
    rate, force = (
        np.column_stack([table.numbers(_column(table, tuple(n.format(a) for n in names), what + a)) for a in "xyz"])
        for names, what in ((_RATE, "g"), (_FORCE, "a"))
    )
    bad = np.flatnonzero(~np.isfinite(np.column_stack([time_s, rate, force])).all(axis=1))
    if len(bad):
        raise InputError(f"{path}, {table.some_lines(bad)}: a value is missing or no number; the form is {FORM}")
    if len(time_s) < _LEAST:
        raise InputError(f"{path}: {len(time_s)} rows; inertial measurements have some tens or hundreds a second")
    back = np.flatnonzero(np.diff(time_s) <= 0)
    if len(back):
        raise InputError(
            f"{path}, line {table.line(int(back[0]) + 1)}: time {time_s[back[0] + 1]:.6f} s comes after "
            f"{time_s[back[0]]:.6f} s: times must increase; sort the rows and leave those out that stand twice"
        )
    _check_units(path, table, rate, force)
    return ImuFile(time_s, rate, force)


def _column(table: Table, names: tuple[str, ...], what: str) -> int:
    found = table.find(names)
    if found is None:
        raise InputError(
            f"{table.path}: no column {what!r} (or {', '.join(names[1:4])}) in its header "
            f"({', '.join(table.columns)}); the form is {FORM}"
        )
    return found


def _check_units(path: Path, table: Table, rate: np.ndarray, force: np.ndarray) -> None:
    fast = np.flatnonzero(np.abs(rate).max(axis=1) > _FASTEST)
    if len(fast):
        raise InputError(
            f"{path}, line {table.line(int(fast[0]))}: a rate of {np.abs(rate[fast[0]]).max():.4g} rad/s: are these "
            "degrees? Give rad/s"
        )
    length = float(np.median(np.linalg.norm(force, axis=1)))
    if not _GRAVITY[0] < length < _GRAVITY[1]:
        raise InputError(
            f"{path}: the accelerations have a median length of {length:.3g}, and a unit at rest measures 9.81 m/s2: "
            "give m/s2 (not g), gravity not taken away"
        )
