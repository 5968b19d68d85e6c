"""GNSS positions from a CSV file: a row a moment, or a row an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import far_from_rest
from tiegraph.geometry.transforms import interpolate, rigid
from tiegraph.scene.table import Table, out_of_order, read_table
from tiegraph.scene.tuning import GnssTuning

IMAGE = ("image", "name", "file", "filename", "file_name", "image_name", "photo", "label")
TIME = ("time", "time_s", "t", "timestamp", "time_stamp", "gps_time", "gpstime", "gpst", "utc", "utc_time", "datetime",
        "seconds", "sec", "epoch", "unix", "unix_time")  # fmt: skip
_DATE = ("date", "utc_date", "day")
_LAT = ("lat", "latitude", "lat_deg", "latitude_deg", "phi")
_LON = ("lon", "long", "lng", "longitude", "lon_deg", "longitude_deg", "long_deg", "lambda")
_HEIGHT = ("ellipsoidal_height", "ellh", "height", "alt", "altitude", "elevation", "h", "height_m", "alt_m",
           "altitude_m", "elev", "z")  # fmt: skip
_SIGMA = ("sigma", "sigma_m", "std", "stdev", "accuracy", "sd", "error")
_SIGMA_H = ("sigma_h", "sigma_h_m", "std_h", "hacc", "h_acc", "sdh", "horizontal_accuracy", "sigma_horizontal")
_SIGMA_V = (
    "sigma_v",
    "sigma_v_m",
    "std_v",
    "vacc",
    "v_acc",
    "sdv",
    "vertical_accuracy",
    "sigma_vertical",
    "sdu",
    "sigma_u",
)
_SIGMA_E = ("sde", "sigma_e", "std_e")
_SIGMA_N = ("sdn", "sigma_n", "std_n")
_HEADING = ("heading", "heading_deg", "yaw", "yaw_deg", "azimuth")
# What a row cannot mean:
HEIGHT_RANGE_M = (-12000.0, 100000.0)  # from the deepest sea to where space begins
SIGMA_RANGE_M = (1e-4, 1000.0)  # below, no receiver; above, a receiver that has no position
_NO_FIX = "position 0, 0"
_EMPTY = ("", "nan", "none", "null")
_NOT_METRES = ("ft", "feet", "foot", "us-ft", "ftus", "cm", "mm", "km")


@dataclass(frozen=True)
class Gnss:
    """G positions, in time order if they have times. Not interpolated."""

    names: tuple[str, ...]  # image names, or empty
    time_s: np.ndarray  # (G,) f8; NaN if the rows are by image
    lat_lon_height: np.ndarray  # (G, 3) degrees, degrees, metres above the ellipsoid
    sigma_m: np.ndarray  # (G, 3) east, north, up; NaN = not given
    heading_deg: np.ndarray  # (G,) of the body's forward axis, clockwise from north; NaN = not given
    notes: tuple[str, ...] = ()
    line: tuple[int, ...] = ()  # (G,) line of the file each row stands in

    def only(self, keep: np.ndarray, notes: Sequence[str]) -> Gnss:
        """Some rows (K,), with other notes."""
        names, line = (tuple(c[k] for k in keep) if c else () for c in (self.names, self.line))
        place, sigma = self.lat_lon_height[keep], self.sigma_m[keep]
        return Gnss(
            names=names,
            time_s=self.time_s[keep],
            lat_lon_height=place,
            sigma_m=sigma,
            heading_deg=self.heading_deg[keep],
            notes=tuple(notes),
            line=line,
        )


def read_gnss(path: Path, tuning: GnssTuning) -> Gnss:
    """Read a GNSS CSV: time (or image), lat, lon, height, and if there: sigma or sigma_h and sigma_v, heading.

    Times are seconds of any epoch, ISO 8601 or hh:mm:ss. Rows without a usable position are left out and noted with
    their lines: empty, out of range, without any accuracy, or so far from the rest that nothing moves so fast.
    Raises InputError naming the columns found if one is missing, for units that are none of ours, positions in radians,
    an image at two places, one time for all rows, or if no row is usable.
    """
    table = read_table(path, "GNSS file")
    lat, lon, height = table.find(_LAT), table.find(_LON), table.find(_HEIGHT)
    image, time = table.find(IMAGE), table.find(TIME)
    missing = [n for n, c in (("lat", lat), ("lon", lon), ("height", height)) if c is None]
    if image is None and time is None:
        missing.insert(0, "time (or image)")
    if missing:
        raise InputError(
            f"{path}: no column {', '.join(missing)}; found: {', '.join(table.columns)}. "
            "Expected: time or image, lat, lon, height, and optionally sigma or sigma_h and sigma_v (metres), heading"
        )
    _check_units(table, (lat, lon), height)
    notes = [*table.notes, *_say_choice(table, _HEIGHT, height)]
    llh = np.stack([table.numbers(c) for c in (lat, lon, height)], axis=1)
    times = table.times(time, table.find(_DATE)) if image is None else np.full(len(llh), np.nan)
    faults = _faults(llh, (lat, lon, height))
    sigma = _sigma(table, notes, faults, tuning.vertical)
    if image is None:
        faults.append(("time", np.isnan(times), time))
    good = ~np.any([bad for _, bad, _ in faults], axis=0)
    if not good.any():
        raise InputError(
            f"{path}: none of {len(llh)} rows has a time and a position in range: {_first(table, faults)}{_hint(llh)}"
        )
    _refuse_radians(table, llh[good], np.flatnonzero(good))
    if not good.all():
        lines = table.some_lines(np.flatnonzero(~good))
        notes.append(
            f"{table.path.name}: {(~good).sum()} of {len(good)} rows left out, empty or out of range ({lines}): "
            f"{_first(table, faults)}"
        )
    names = tuple(table.cell(k, image) for k in range(len(llh)) if good[k]) if image is not None else ()
    heading = _heading(table, notes)
    line = tuple(table.line(k) for k in np.flatnonzero(good).tolist())
    raw = Gnss(
        names=names,
        time_s=times[good],
        lat_lon_height=llh[good],
        sigma_m=sigma[good],
        heading_deg=heading[good],
        notes=tuple(notes),
        line=line,
    )
    if image is None:
        made = _without_leaps(_in_time_order(raw, path), path, tuning.max_speed_m_s)
    else:
        made = _one_place_an_image(raw, path)
    stuck = stuck_note(made.lat_lon_height, table.path.name, tuning.stuck)
    return replace(made, notes=(*made.notes, stuck)) if stuck else made


# What can make a row useless: a name, (R,) whether it does, and the column it shows in.
_Faults = list[tuple[str, np.ndarray, int | None]]


# --- single cells ---------------------------------------------------------------------------------------------------


def _check_units(table: Table, angles: tuple[int | None, ...], height: int | None) -> None:
    for column in angles:
        if table.unit(column).startswith("rad"):
            raise InputError(f"{table.path}: column {_named(table, column)} is in radians: write degrees")
    for column in (height, *(table.find(a) for a in (_SIGMA, _SIGMA_H, _SIGMA_V, _SIGMA_E, _SIGMA_N))):
        if table.unit(column) in _NOT_METRES:
            raise InputError(f"{table.path}: column {_named(table, column)} is in {table.unit(column)}: write metres")


def _named(table: Table, column: int | None) -> str:
    return "" if column is None else repr(table.columns[column])


def _say_choice(table: Table, aliases: tuple[str, ...], chosen: int | None) -> list[str]:
    """A note if a table has several columns that could be meant."""
    others = [a for a in aliases if a in table.columns and table.columns.index(a) != chosen]
    if not others:
        return []
    return [
        f"{table.path.name}: the column {_named(table, chosen)} is taken for the height, not {', '.join(others)}; "
        "rename it if another is meant"
    ]


def _faults(llh: np.ndarray, columns: tuple[int | None, ...]) -> _Faults:
    """What can be wrong with positions (R, 3) alone."""
    lat, lon, height = columns
    return [
        ("latitude", ~(np.abs(llh[:, 0]) <= 90), lat),
        ("longitude", ~(np.abs(llh[:, 1]) <= 360), lon),
        ("height", ~((llh[:, 2] >= HEIGHT_RANGE_M[0]) & (llh[:, 2] <= HEIGHT_RANGE_M[1])), height),
        (_NO_FIX, np.all(llh[:, :2] == 0, axis=1), lat),
    ]


def _first(table: Table, faults: _Faults) -> str:
    """The first cell at fault that is not empty, in words; else the first empty one."""
    found = [(k, what, column) for what, bad, column in faults for k in np.flatnonzero(bad).tolist()]
    filled = [f for f in found if table.cell(f[0], f[2]).lower() not in _EMPTY and f[1] != _NO_FIX]
    row, what, column = min(filled or found, key=lambda f: f[0])
    shown = "" if what == _NO_FIX else f" {table.cell(row, column)!r}"
    remedy = "; correct the file, or leave such rows out" if filled else ""
    return f"line {table.line(row)}, {what}{shown}{remedy}"


def _hint(llh: np.ndarray) -> str:
    """What latitudes out of range look like."""
    lat, lon = (np.nanmax(np.abs(v), initial=0) for v in llh[:, :2].T)
    if 90 < lat <= 360 and lon <= 90:
        return "; lat and lon look exchanged"
    if 90 < lat <= 9000 and lon <= 18000:
        return "; lat looks like ddmm.mmmm (NMEA): write degrees"
    return "; lat looks like 1e-7 degrees: write degrees" if 1e5 < lat <= 9e8 else ""


def _refuse_radians(table: Table, llh: np.ndarray, rows: np.ndarray) -> None:
    # No land lies within this range of degrees about 0, 0 (Gulf of Guinea).
    if len(llh) > 1 and np.all(np.abs(llh[:, 0]) <= np.pi / 2) and np.all(np.abs(llh[:, 1]) <= np.pi):
        raise InputError(
            f"{table.path}, line {table.line(rows[0])}: lat {llh[0, 0]:g}, lon {llh[0, 1]:g}: all positions lie in the "
            "open sea about 0, 0, as radians do: write degrees"
        )


def _sigma(table: Table, notes: list[str], faults: _Faults, vertical: float) -> np.ndarray:
    """(R, 3) sigmas in metres, NaN = not given; sigmas of a receiver that has no position are added to the faults."""

    def column(aliases: tuple[str, ...]) -> np.ndarray:
        found = table.find(aliases)
        values = table.numbers(found)
        if found is not None:
            faults.append(("accuracy", values > SIGMA_RANGE_M[1], found))
        remedy = "no standard deviation in metres: taken as not given"
        return _believed(table, found, values, values >= SIGMA_RANGE_M[0], notes, remedy)

    both, flat, up = column(_SIGMA), column(_SIGMA_H), column(_SIGMA_V)
    flat = np.where(np.isnan(flat), both, flat)
    up = np.where(np.isnan(up), vertical * flat, up)
    east, north = column(_SIGMA_E), column(_SIGMA_N)
    return np.stack([np.where(np.isnan(s), flat, s) for s in (east, north)] + [up], axis=1)


def _heading(table: Table, notes: list[str]) -> np.ndarray:
    found = table.find(_HEADING)
    values = table.numbers(found)
    return _believed(table, found, values, np.abs(values) <= 360, notes, "no angle in degrees: not used")


def _believed(
    table: Table, column: int | None, values: np.ndarray, good: np.ndarray, notes: list[str], remedy: str
) -> np.ndarray:
    """(R,) values that are good, NaN for the others; those that are neither good nor empty are said."""
    if column is None:
        return values
    odd = [k for k in np.flatnonzero(~good).tolist() if table.cell(k, column).lower() not in _EMPTY]
    if odd:
        notes.append(
            f"{table.path.name}, line {table.line(odd[0])}: {_named(table, column)} {table.cell(odd[0], column)!r} is "
            f"{remedy}, as in {len(odd)} of {len(values)} rows"
        )
    return np.where(good, values, np.nan)


# --- rows among each other ------------------------------------------------------------------------------------------


def _in_time_order(gnss: Gnss, path: Path) -> Gnss:
    notes, name = list(gnss.notes), Path(path).name
    order = np.argsort(gnss.time_s, kind="stable")
    odd = out_of_order(gnss.time_s)
    if len(odd):
        k = int(odd[0])
        beside, where = (k - 1, "after") if k else (1, "before")
        notes.append(
            f"{name}, line {gnss.line[k]}: rows are not in time order and were sorted "
            f"({gnss.time_s[k]:.2f} s {where} {gnss.time_s[beside]:.2f} s)"
        )
    twin = np.concatenate([[False], np.diff(gnss.time_s[order]) <= 1e-9])
    keep = order[~twin]
    if len(keep) < len(order):
        again = int(order[np.flatnonzero(twin)[0]])
        if len(keep) == 1:
            raise InputError(
                f"{path}, line {gnss.line[again]}: all {len(order)} rows have the time {gnss.time_s[again]:.2f} s: "
                "give the time of each row, or a table with a column image"
            )
        notes.append(
            f"{name}: {twin.sum()} rows with the time of another row left out, such as line {gnss.line[again]} "
            f"({gnss.time_s[again]:.2f} s)"
        )
    return gnss.only(keep, notes)


def _without_leaps(gnss: Gnss, path: Path, max_speed_m_s: float) -> Gnss:
    """Without stretches of rows far from the rest that nothing could reach in the time between."""
    far, away = far_from_rest(gnss.lat_lon_height)
    if not far.any():
        return gnss
    edge = np.flatnonzero(np.diff(far.astype(int)) != 0)  # between rows edge and edge + 1
    fast = np.abs(np.diff(away)) > max_speed_m_s * np.diff(gnss.time_s)
    for first, last in zip([0, *(edge + 1)], [*edge, len(far) - 1]):
        reached = (first > 0 and not fast[first - 1]) or (last < len(far) - 1 and not fast[last])
        far[first : last + 1] &= not reached
    if not far.any():
        return gnss
    row = int(np.flatnonzero(far)[0])
    note = _say_far(f"{Path(path).name}, line {gnss.line[row]}", gnss.lat_lon_height[row], away[row])
    note += f", and nothing moves so fast: {far.sum()} of {len(far)} rows "
    if 2 * far.sum() >= len(far):
        return replace(gnss, notes=(*gnss.notes, note + "do so, and which are right nothing tells: correct the file"))
    return gnss.only(np.flatnonzero(~far), [*gnss.notes, note + "are left out; correct the file, or remove them"])


def _say_far(where: str, place: np.ndarray, away_m: float) -> str:
    return f"{where}: lat {place[0]:.6f}, lon {place[1]:.6f} lies {away_m / 1000:.0f} km from most of the others"


def far_rows(lat_lon_height: np.ndarray, where: Sequence[str], most: float) -> tuple[np.ndarray, str]:
    """(N,) which of some positions (N, 3) without times not to use, as they are far from the rest, and what to say.

    ``where`` names each position. They are used, though said, if they are more than a share of ``most`` (of two, one):
    which are right is then not clear.
    """
    far, away = far_from_rest(lat_lon_height)
    if not far.any():
        return far, ""
    row = int(np.flatnonzero(far)[0])
    note = _say_far(where[row], lat_lon_height[row], away[row])
    if far.sum() > max(1, most * len(far)) or len(far) < 3:
        note += f", as {far.sum()} of {len(far)} positions do: are these two surveys? Split them, or mend the positions"
        return np.zeros(len(far), bool), note
    return far, note + f": {far.sum()} of {len(far)} positions are not used; mend or remove them"


def _one_place_an_image(gnss: Gnss, path: Path) -> Gnss:
    """A file by image without rows that say the same again. Raises InputError for an image at two places."""
    first: dict[str, int] = {}
    again = []
    for k, name in enumerate(gnss.names):
        other = first.setdefault(name, k)
        if other == k:
            continue
        if not np.allclose(gnss.lat_lon_height[k], gnss.lat_lon_height[other], rtol=0, atol=(1e-8, 1e-8, 1e-3)):
            raise InputError(
                f"{path}, line {gnss.line[k]}: image {name!r} has another place than in line {gnss.line[other]}: leave "
                "the right one"
            )
        again.append(k)
    if not again:
        return gnss
    image = f"{Path(path).name}, line {gnss.line[again[0]]}: image {gnss.names[again[0]]!r}"
    note = f"{image} stands there twice, at one place; {len(again)} rows left out"
    return gnss.only(np.setdiff1d(np.arange(len(gnss.names)), again), [*gnss.notes, note])


def without_far(gnss: Gnss, path: Path, most: float) -> Gnss:
    """A file by image without positions that stand far apart from the others, as ``far_rows`` says."""
    far, note = far_rows(gnss.lat_lon_height, [f"{Path(path).name}, line {n}" for n in gnss.line], most)
    return gnss.only(np.flatnonzero(~far), [*gnss.notes, note]) if note else gnss


def stuck_note(lat_lon_height: np.ndarray, where: str, least: int) -> str:
    """What to say if some positions (N, 3), the ``least`` number of them, are one and the same; else ""."""
    if len(lat_lon_height) < least or np.ptp(lat_lon_height, axis=0).max() > 0:
        return ""
    lat, lon, height = lat_lon_height[0]
    return (
        f"{where}: all {len(lat_lon_height)} positions are lat {lat:.6f}, lon {lon:.6f}, height {height:g} m, and tell "
        "neither scale nor direction: was there a fix?"
    )


def at_times(gnss: Gnss, world_m: np.ndarray, time_s: np.ndarray, max_gap_s: float) -> tuple[np.ndarray, ...]:
    """Positions (F, 3), sigmas (F, 3) and headings (F,) at times (F,); NaN outside and across gaps over ``max_gap_s``.

    ``world_m`` (G, 3) are the rows in the world. Sigmas are the larger of the two neighbours'.
    """
    heading = np.radians(np.where(np.isnan(gnss.heading_deg), 0.0, gnss.heading_deg))
    cos, sin, zero, one = np.cos(heading), np.sin(heading), np.zeros_like(heading), np.ones_like(heading)
    turn = np.stack([np.stack(r, -1) for r in ((cos, -sin, zero), (sin, cos, zero), (zero, zero, one))], axis=1)
    moved = interpolate(gnss.time_s, rigid(turn, world_m), time_s, max_gap_s)
    there = np.isfinite(moved[:, 0, 3])
    right = np.clip(
        np.searchsorted(gnss.time_s, np.where(there, time_s, gnss.time_s[0]) - 1e-6), 0, len(gnss.time_s) - 1
    )
    exact = np.abs(gnss.time_s[right] - time_s) < 1e-6
    left = np.where(exact, right, np.maximum(right - 1, 0))
    sigma = np.fmax(gnss.sigma_m[left], gnss.sigma_m[right])
    known = np.isfinite(gnss.heading_deg[left]) & np.isfinite(gnss.heading_deg[right]) & there
    bearing = np.where(known, np.degrees(np.arctan2(moved[:, 1, 0], moved[:, 0, 0])) % 360, np.nan)
    return moved[:, :3, 3], np.where(there[:, None], sigma, np.nan), bearing
