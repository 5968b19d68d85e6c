"""GNSS positions from a CSV file: a row a moment, or a row an image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import interpolate, rigid
from tiegraph.scene.table import Table, read_table

IMAGE = ("image", "name", "file", "filename", "file_name", "image_name", "photo", "label")
TIME = ("time", "time_s", "t", "timestamp", "time_stamp", "gps_time", "gpstime", "gpst", "utc", "utc_time", "datetime",
        "seconds", "sec", "epoch", "unix", "unix_time")  # fmt: skip
_DATE = ("date", "utc_date", "day")
_LAT = ("lat", "latitude", "lat_deg", "latitude_deg", "phi")
_LON = ("lon", "long", "lng", "longitude", "lon_deg", "longitude_deg", "long_deg", "lambda")
_HEIGHT = ("height", "alt", "altitude", "elevation", "ellipsoidal_height", "ellh", "h", "height_m", "alt_m",
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
# Satellites fix the height about half as well as the position: all of them are above.
VERTICAL_FACTOR = 2.0
_SHOWN_LINES = 5


@dataclass(frozen=True)
class Gnss:
    """G positions, in time order if they have times. Not interpolated."""

    names: tuple[str, ...]  # image names, or empty
    time_s: np.ndarray  # (G,) f8; NaN if the rows are by image
    lat_lon_height: np.ndarray  # (G, 3) degrees, degrees, metres above the ellipsoid
    sigma_m: np.ndarray  # (G, 3) east, north, up; NaN = not given
    heading_deg: np.ndarray  # (G,) of the body's forward axis, clockwise from north; NaN = not given
    notes: tuple[str, ...] = ()


def read_gnss(path: Path) -> Gnss:
    """Read a GNSS CSV: time (or image), lat, lon, height, and if there: sigma or sigma_h and sigma_v, heading.

    Times are seconds of any epoch, ISO 8601 or hh:mm:ss. Rows without a usable position are left out and noted.
    Raises InputError naming the columns found if one is missing, or if no row is usable.
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
    llh = np.stack([table.numbers(c) for c in (lat, lon, height)], axis=1)
    times = table.times(time, table.find(_DATE)) if image is None else np.full(len(llh), np.nan)
    good = (
        (np.abs(llh[:, 0]) <= 90)
        & (np.abs(llh[:, 1]) <= 360)
        & np.isfinite(llh[:, 2])
        & np.any(llh[:, :2] != 0, axis=1)
    )
    good &= np.isfinite(times) | (image is not None)
    notes = _skipped(table, good)
    if not good.any():
        swapped = np.nanmax(np.abs(llh[:, 0]), initial=0) > 90 and np.nanmax(np.abs(llh[:, 1]), initial=0) <= 90
        hint = "; lat and lon look exchanged" if swapped else ""
        raise InputError(f"{path}: none of {len(llh)} rows has a time and a position in range{hint}")
    names = tuple(table.cell(k, image) for k in range(len(llh)) if good[k]) if image is not None else ()
    sigma, heading = _sigma(table), table.numbers(table.find(_HEADING))
    raw = Gnss(names, times[good], llh[good], sigma[good], heading[good], tuple(notes))
    return raw if image is not None else _in_time_order(raw, path)


def _skipped(table: Table, good: np.ndarray) -> list[str]:
    bad = [str(table.rows[k][0]) for k in np.flatnonzero(~good)]
    if not bad:
        return []
    lines = ", ".join(bad[:_SHOWN_LINES]) + (" ..." if len(bad) > _SHOWN_LINES else "")
    return [f"{table.path.name}: {len(bad)} of {len(good)} rows left out, empty or out of range (line {lines})"]


def _sigma(table: Table) -> np.ndarray:
    def column(aliases: tuple[str, ...]) -> np.ndarray:
        values = table.numbers(table.find(aliases))
        return np.where(values > 0, values, np.nan)

    both, flat, up = column(_SIGMA), column(_SIGMA_H), column(_SIGMA_V)
    flat = np.where(np.isnan(flat), both, flat)
    up = np.where(np.isnan(up), VERTICAL_FACTOR * flat, up)
    east, north = column(_SIGMA_E), column(_SIGMA_N)
    return np.stack([np.where(np.isnan(s), flat, s) for s in (east, north)] + [up], axis=1)


def _in_time_order(gnss: Gnss, path: Path) -> Gnss:
    notes = list(gnss.notes)
    order = np.argsort(gnss.time_s, kind="stable")
    if np.any(np.diff(gnss.time_s) < 0):
        notes.append(f"{Path(path).name}: rows are not in time order and were sorted")
    keep = order[np.concatenate([[True], np.diff(gnss.time_s[order]) > 1e-9])]
    if len(keep) < len(order):
        notes.append(f"{Path(path).name}: {len(order) - len(keep)} rows with the time of another row left out")
    return Gnss(
        (), gnss.time_s[keep], gnss.lat_lon_height[keep], gnss.sigma_m[keep], gnss.heading_deg[keep], tuple(notes)
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
