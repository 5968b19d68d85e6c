"""Positions from a CSV file: a row a moment, or a row an image."""

from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.gnss.fixes import EMPTY, SIGMA_RANGE_M, Fixes
from tiegraph.scene.table import Table, read_table
from tiegraph.scene.timecolumns import times_of

IMAGE = ("image", "name", "file", "filename", "file_name", "image_name", "photo", "label", "sourcefile")
_LAT = ("lat", "latitude", "lat_deg", "latitude_deg", "gpslatitude", "gps_latitude", "phi")
_LON = ("lon", "long", "lng", "longitude", "lon_deg", "longitude_deg", "long_deg", "gpslongitude", "gps_longitude",
        "lambda")  # fmt: skip
_HEIGHT = ("ellipsoidal_height", "ellh", "height", "alt", "altitude", "elevation", "h", "height_m", "alt_m",
           "altitude_m", "elev", "gpsaltitude", "gps_altitude", "z")  # fmt: skip
_HALVES = ("{}_ref", "{}ref", "{}_hemisphere", "{}_hemi", "{}_dir", "{}_direction")  # of the column of an angle
_NORTH_SOUTH, _EAST_WEST = ("n_s", "ns", "north_south"), ("e_w", "ew", "east_west")
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
_CLOCK = ("time", "date", "week", "sow", "tow", "utc", "leap")  # a word of columns that a time may be made of
_TILT = ("pitch", "roll", "omega", "phi")  # any column with such a word
_LEVEL_DEG = 20.0  # a body tilted by more has no heading that a table of yaw, pitch and roll gives by its yaw alone
_SIGMAS = (_SIGMA, _SIGMA_H, _SIGMA_V, _SIGMA_E, _SIGMA_N)


def read_columns(path: Path) -> Fixes:
    """Rows of a table with the columns time (or image), lat, lon, height, and if there: sigma or sigma_h and sigma_v,
    heading.

    Times are as ``scene.timecolumns`` reads them, lengths in the unit of their header. Raises InputError naming the
    columns found if one is missing, and for angles in radians.
    """
    table = read_table(path, "GNSS file")
    lat, lon, height = table.find(_LAT), table.find(_LON), table.find(_HEIGHT)
    _refuse_radians(table, (lat, lon))
    halves = [_half(table, column, also) for column, also in ((lat, _NORTH_SOUTH), (lon, _EAST_WEST))]
    angles = [table.angles(c, half, letters) for c, half, letters in zip((lat, lon), halves, ("NS", "EW"))]
    llh = np.stack([*angles, _metres(table, height)], axis=1)
    image = table.find(IMAGE)
    times = times_of(table) if image is None else None
    missing = [n for n, c in (("lat", lat), ("lon", lon), ("height", height)) if c is None]
    if image is None and times is None:
        missing.insert(0, "time (or image)")
    if missing:
        raise InputError(
            f"{path}: no column {', '.join(missing)}; found: {', '.join(table.columns)}. Expected: time or image, lat, "
            "lon, height, and optionally sigma or sigma_h and sigma_v (metres), heading; a table of times may have "
            "gps_week and gps_sow, gps_seconds, or time_ns instead of time"
        )
    notes = [*table.notes, *_say_choice(table, _HEIGHT, height)]
    columns = {"latitude": lat, "longitude": lon, "height": height, "time": times.column if times else None}

    def text(row: int, what: str) -> str:
        return table.cell(row, _worst(table, row) if what == "accuracy" else columns[what])

    sigma = _sigma(table, notes)
    heading = _heading(table, notes)
    _say_passed_over(table, {image, times.column if times else None, *columns.values(), *halves}, notes)
    return Fixes(
        path=table.path,
        line=[line for line, _ in table.rows],
        lat_lon_height=llh,
        time_s=np.full(len(table.rows), np.nan) if times is None else times.seconds,
        names=[table.cell(k, image) for k in range(len(table.rows))] if image is not None else (),
        sigma_m=sigma,
        heading_deg=heading,
        notes=[*notes, *(times.notes if times else ())],
        period_s=times.period_s if times else 0.0,
        text=text,
    )


def _half(table: Table, angle: int | None, also: tuple[str, ...]) -> int | None:
    """The column that says on which half of the Earth an angle is, if there is one."""
    if angle is None:
        return None
    return table.find((*(half.format(table.columns[angle]) for half in _HALVES), *also))


def _say_passed_over(table: Table, used: set[int | None], notes: list[str]) -> None:
    """Which columns tell nothing here: the kind of a receiver's fix or another height may be among them."""
    read = used | {table.find(a) for a in (*_SIGMAS, _HEADING)}
    over = [c for k, c in enumerate(table.columns) if c and k not in read and not set(c.split("_")) & set(_CLOCK)]
    if over:
        named = ", ".join(table.columns[k] for k in sorted(k for k in read if k is not None))
        notes.append(f"{table.path.name}: the columns {named} are read; passed over: {', '.join(over)}")


def _refuse_radians(table: Table, angles: tuple[int | None, ...]) -> None:
    for column in angles:
        if table.unit(column).startswith("rad"):
            raise InputError(f"{table.path}: column {_named(table, column)} is in radians: write degrees")


def _metres(table: Table, column: int | None) -> np.ndarray:
    """(R,) lengths of a column."""
    return table.numbers(column) * (table.unit_m(column) or 1.0)


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


def _worst(table: Table, row: int) -> int | None:
    """The column whose accuracy says that a row has no position."""
    found = [c for c in (table.find(a) for a in _SIGMAS) if c is not None]
    return next((c for c in found if _metres(table, c)[row] > SIGMA_RANGE_M[1]), None)


def _sigma(table: Table, notes: list[str]) -> np.ndarray:
    """(R, 3) sigmas in metres, NaN = not given; one that is too large stays, and tells that there is no position."""

    def column(aliases: tuple[str, ...]) -> np.ndarray:
        found = table.find(aliases)
        values = _metres(table, found)
        remedy = "no standard deviation in metres: taken as not given"
        return _believed(table, found, values, values >= SIGMA_RANGE_M[0], notes, remedy)

    both, flat, up, east, north = (column(a) for a in _SIGMAS)
    flat = np.where(np.isnan(flat), both, flat)
    return np.stack([np.where(np.isnan(s), flat, s) for s in (east, north)] + [up], axis=1)


def _heading(table: Table, notes: list[str]) -> np.ndarray:
    found = table.find(_HEADING)
    values = table.numbers(found)
    lat = table.find(_LAT)  # may be called phi
    tilted = [k for k, c in enumerate(table.columns) if k != lat and set(c.split("_")) & set(_TILT)]
    if found is not None and tilted:
        most = max(float(np.nanmax(np.abs((table.numbers(k) + 180) % 360 - 180), initial=0)) for k in tilted)
        if most > _LEVEL_DEG:
            notes.append(
                f"{table.path.name}: {', '.join(table.columns[k] for k in (found, *tilted))}: cameras tilted by up to "
                f"{most:.0f} degrees: these angles are passed over, the images tell the attitudes"
            )
            return np.full(len(values), np.nan)
    return _believed(table, found, values, np.abs(values) <= 360, notes, "no angle in degrees: not used")


def _believed(
    table: Table, column: int | None, values: np.ndarray, good: np.ndarray, notes: list[str], remedy: str
) -> np.ndarray:
    """(R,) values that are good, NaN for the others; those that are neither good nor empty are said."""
    if column is None:
        return values
    odd = [k for k in np.flatnonzero(~good).tolist() if table.cell(k, column).lower() not in EMPTY]
    if odd:
        notes.append(
            f"{table.path.name}, line {table.line(odd[0])}: {_named(table, column)} {table.cell(odd[0], column)!r} is "
            f"{remedy}, as in {len(odd)} of {len(values)} rows"
        )
    return np.where(good, values, np.nan)
