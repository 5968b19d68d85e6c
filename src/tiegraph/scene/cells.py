"""Contents of a table cell: a number, a length, an angle, a time; and the roles of the columns: by their names, one
list for all tables, or, without a header, by their cells.

Words are in lower case without accents, units and signs, as ``textfile.plain_word`` makes them. The first that a table
has counts. Ambiguous cells give ().
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timezone
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import within_area

if TYPE_CHECKING:
    import pyproj

UNIT_M = {
    "m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048,
    "feet": 0.3048, "foot": 0.3048, "ftus": 1200 / 3937, "us-ft": 1200 / 3937, "us ft": 1200 / 3937,
    "us survey feet": 1200 / 3937,
}  # fmt: skip
UNIT_S = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}

# A half of the Earth, degrees, minutes, seconds, a half: "N35.5", "35 deg 41' 22.2\" N", "35°41'22.2\"".
_ANGLE = re.compile(
    r"\s*([NSEW])?\s*([+-]?\d+(?:\.\d*)?)\s*(?:°|DEG|D)?\s*(?:(\d+(?:\.\d*)?)\s*['′M])?\s*(?:(\d+(?:\.\d*)?)\s*(?:\"|″|''|S(?=\s)))?"
    r"\s*([NSEW])?\s*"
)
_LENGTH = re.compile(r"([+-]?\d+(?:\.\d*)?)\s*([a-z]+)\.?(?: (above|below) .*)?")  # exiftool: 40.2 m Above Sea Level
# Of numbers with group separators: 494 399,21 or 494.399,21, and 494,399.21 or 494'399.21.
_COMMA_MARKS = re.compile(r"[+-]?(?:\d{1,3}(?:[. \u00a0\u202f'’]\d{3})+|\d*),\d+(?:[eE][+-]?\d+)?")
_COMMA_GROUPS = re.compile(r"[+-]?\d{1,3}(?:[, \u00a0\u202f'’]\d{3})+(?:\.\d*)?")
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
_GROUPS = re.compile(r"[ \u00a0\u202f'’]")


def number(text: str) -> float:
    """The number in a cell, NaN if it is none."""
    try:
        return float("nan") if "_" in text else float(text)
    except ValueError:
        return float("nan")


def length_m(text: str, unit_m: float) -> float:
    """Metres of a cell with a number of units, or of its own unit; NaN if it is none."""
    value = number(text)
    if value == value or not (found := _LENGTH.fullmatch(text.lower())):
        return value * unit_m
    return float(found[1]) * UNIT_M.get(found[2], float("nan")) * (-1 if found[3] == "below" else 1)


def degrees(text: str) -> tuple[float, str]:
    """Degrees of a cell, perhaps with minutes and seconds, NaN if it is none, and the letter of its half or ""."""
    value = number(text)
    if value == value or not (found := _ANGLE.fullmatch(text.upper().replace(",", "."))):
        return value, ""
    whole, minutes, seconds = (float(found[n] or 0) for n in (2, 3, 4))
    size = abs(whole) + minutes / 60 + seconds / 3600
    return -size if found[2].startswith("-") else size, found[1] or found[5] or ""


def says_value(text: str) -> bool:
    """Whether a cell is a number, an angle or a time, and no name."""
    values = (degrees(text)[0], parse_time(text))
    return bool(_COMMA_MARKS.fullmatch(text)) or any(v == v for v in values)


def comma_marks(cells: Sequence[str]) -> bool | None:
    """Whether the numbers among cells have decimal commas; None if that is undecided: 1,234 can be either."""
    marks, groups, either = (sum(bool(p.fullmatch(c)) for c in cells) for p in (_COMMA_MARKS, _COMMA_GROUPS, _EITHER))
    if either and (marks > either) == (groups > either):
        return None
    return marks > either


def plain(cell: str, comma: bool | None, where: str) -> str:
    """A number as Python writes it; other text unchanged. Raises InputError, with ``where``, for an ambiguous one."""
    mark = "." if comma else ","
    if comma is not False and mark in cell and _EITHER.fullmatch(cell.replace(mark, ",")):
        raise InputError(
            f"{where}: {cell!r} can be {cell.replace(mark, '.')} or {cell.replace(mark, '')}: write numbers with a "
            "point and without separators of thousands"
        )
    if comma and (_COMMA_MARKS.fullmatch(cell) or _COMMA_GROUPS.fullmatch(cell.replace(".", ","))):
        return _GROUPS.sub("", cell).replace(".", "").replace(",", ".")
    return _GROUPS.sub("", cell).replace(",", "") if _COMMA_GROUPS.fullmatch(cell) else cell


def parse_time(text: str) -> float:
    """Seconds of a number, an ISO 8601 time (without zone: taken as UTC) or hh:mm:ss; NaN if it is none of them."""
    seconds = number(text)
    if seconds == seconds:
        return seconds
    text = text.strip().replace(",", ".")
    clock = re.fullmatch(r"(\d{1,2}):([0-5]\d):([0-5]\d(?:\.\d+)?)Z?", text)
    if clock:
        return int(clock[1]) * 3600 + int(clock[2]) * 60 + float(clock[3])
    text = re.sub(r"^(\d{4})[:/](\d\d)[:/](\d\d)", r"\1-\2-\3", text)  # as EXIF and RTKLIB write dates
    text = re.sub(r"^(\d\d)\.(\d\d)\.(\d{4})", r"\3-\2-\1", text)  # as they are written in German and Russian
    whole, _, fraction = text.replace("/", "-").replace("Z", "+00:00").partition(".")
    digits = re.match(r"\d+", fraction)
    try:
        stamp = datetime.fromisoformat(re.sub(r"\s+", " ", whole) + (fraction[digits.end() :] if digits else ""))
    except ValueError:
        return float("nan")
    stamp = stamp if stamp.tzinfo else stamp.replace(tzinfo=timezone.utc)
    return stamp.timestamp() + (float(f"0.{digits[0]}") if digits else 0.0)


@lru_cache(maxsize=64)
def seconds_of(text: str, form: str) -> float:
    """Seconds since 1970 of a date, UTC, in a form of ``strptime``; NaN if it is none."""
    try:
        return datetime.strptime(text, form).replace(tzinfo=timezone.utc).timestamp()
    except ValueError:
        return float("nan")


def date_text(time_s: float) -> str:
    """A time (seconds since 1970, UTC) for people."""
    return f"{datetime.fromtimestamp(time_s, timezone.utc):%Y-%m-%d %H:%M:%S}"


def in_seconds(times: np.ndarray) -> np.ndarray:
    """Times since 1970 in milli-, micro- or nanoseconds as seconds; other times unchanged."""
    known = times[np.isfinite(times)]
    size = float(np.median(np.abs(known))) if len(known) else 0.0
    factors = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
    return next((times * factor for limit, factor in factors if size > limit), times)


ROLES: dict[str, tuple[str, ...]] = {
    "image": ("image", "file", "filename", "file_name", "image_name", "imagename", "photo", "photo_name", "sourcefile",
              "bild", "bildname", "foto", "imagen", "imagem", "immagine", "画像", "画像名", "照片"),
    "name": ("name", "point", "gcp", "gcp_name", "label", "id", "point_name", "point_id", "gcp_id", "marker", "target",
             "point_number", "pt", "punkt", "punktnummer", "punktnr", "nom", "nome", "nombre", "punto", "点名", "点号",
             "nr", "no"),
    "latitude": ("lat", "latitude", "y_latitude", "latitude_y", "gpslatitude", "gps_latitude", "phi", "breite",
                 "breitengrad", "latitud", "latitudine", "szerokosc", "широта", "緯度", "纬度", "위도"),
    "longitude": ("lon", "long", "lng", "longitude", "x_longitude", "longitude_x", "gpslongitude", "gps_longitude",
                  "lambda", "lange", "laenge", "langengrad", "longitud", "longitudine", "długosc", "долгота", "経度",
                  "经度", "경도"),
    "ellipsoidal height": ("ellipsoidal_height", "ellipsoid_height", "height_above_ellipsoid", "ellh", "h_ell", "hae",
                           "ellipsoidische_hohe", "altura_elipsoidal", "hauteur_ellipsoidale", "quota_ellissoidica",
                           "楕円体高", "大地高"),
    "height": ("height", "alt", "altitude", "elevation", "h", "elev", "gpsaltitude", "gps_altitude", "z_altitude",
               "height_z", "z", "geo_z", "hohe", "hoehe", "altura", "altitud", "hauteur", "altitudine", "quota", "cota",
               "elevacion", "wysokosc", "высота", "標高", "高さ", "高程", "高度", "고도",
               "elevation_msl", "altitude_msl", "alt_msl", "alt_amsl", "height_msl", "msl_altitude", "abs_alt",
               "absolute_altitude", "orthometric_height", "hohe_uber_nn", "hohe_nhn"),
    "easting": ("x", "east", "easting", "e", "geo_x", "x_easting", "x_east", "ost", "ostwert", "rechtswert", "este",
                "est", "東距"),
    "northing": ("y", "north", "northing", "n", "geo_y", "y_northing", "y_north", "nordwert", "hochwert", "norte",
                 "nord", "北距"),
    "sigma": ("sigma", "std", "stdev", "accuracy", "sd", "rms", "genauigkeit", "precision", "precisione", "exactitud",
              "dokładnosc", "точность", "精度"),
    "horizontal sigma": ("sigma_h", "sigma_xy", "std_h", "hacc", "h_acc", "sdh", "horizontal_accuracy", "accuracy_horz",
                         "accuracy_horizontal", "sigma_horizontal", "accuracy_x_y", "accuracy_xy", "lateral_rms",
                         "h_rms", "hrms", "horizontal_rms"),
    "vertical sigma": ("sigma_v", "sigma_z", "std_v", "vacc", "v_acc", "sdv", "vertical_accuracy", "accuracy_vert",
                       "accuracy_vertical", "sigma_vertical", "accuracy_z", "sdu", "sigma_u", "sdheight", "sd_height",
                       "elevation_rms", "v_rms", "vrms", "vertical_rms"),
    "sigma to the east": ("sde", "sigma_e", "std_e", "sdeast", "sd_east", "easting_rms", "sigma_x", "accuracy_x"),
    "sigma to the north": ("sdn", "sigma_n", "std_n", "sdnorth", "sd_north", "northing_rms", "sigma_y", "accuracy_y"),
    "heading": ("heading", "yaw", "azimuth"),
    "role": ("role", "type", "kind"),
    "crs": ("cs_name", "crs", "epsg", "coordinate_system"),
    "pixel x": ("px", "im_x", "pixel_x", "x_px", "image_x", "u", "col", "column"),
    "pixel y": ("py", "im_y", "pixel_y", "y_px", "image_y", "v", "row"),
    "frame": ("frame", "frame_id", "frame_name", "shot"),
    "pass": ("pass", "track", "run", "strip"),
    "from": ("from", "first", "target_1", "target1", "point_1", "point1"),
    "to": ("to", "second", "target_2", "target2", "point_2", "point2"),
    "length": ("length", "distance"),
    "scan": ("scan", "name", "file", "frame"),
    "start of the scan": ("time_start", "start", "stamp"),
    "time": ("time", "t", "timestamp", "time_stamp", "utc", "utc_time", "datetime", "date_time", "date_time_utc",
             "seconds", "sec", "epoch", "unix", "unix_time", "zeit", "uhrzeit", "hora", "heure", "ora", "時刻", "时间"),
    "GPS time": ("gps_time", "gpstime", "gpst"),
    "seconds since 1980": ("gps_seconds", "gps_s", "gps_epoch"),
    "GPS week": ("gps_week", "gpsweek", "week", "wn", "week_number"),
    "seconds of the week": ("gps_sow", "sow", "gps_tow", "tow", "seconds_of_week", "gps_seconds_of_week",
                            "time_of_week", "gps_week_s"),
    "date": ("date", "utc_date", "day", "datum", "fecha", "data", "日付", "日期"),
}  # fmt: skip
SIGMAS = ("horizontal sigma", "sigma", "sigma to the east", "sigma to the north", "vertical sigma")
_KNOWN = {word for role, words in ROLES.items() for word in words if role != "crs"} | {"ts"}


def known_words(columns: tuple[str, ...]) -> int:
    """How many columns have a name that some table knows, without their units."""
    return sum(c in _KNOWN or without_unit(c)[0] in _KNOWN for c in columns)


_SUFFIX = re.compile(rf"(.+?)(?:_in)?_({'|'.join([*UNIT_M, *UNIT_S, 'deg', 'degrees'])})")


def without_unit(column: str) -> tuple[str, str]:
    """A column's name without the unit at its end, and that unit: height_ft, time_ns, hohe_in_m."""
    found = _SUFFIX.fullmatch(column)
    return (found[1], found[2]) if found else (column, "")


Cells = Sequence[tuple[str, ...]]


def is_file(cell: str) -> bool:
    """Whether a cell is the name of a file."""
    return bool(re.fullmatch(r".*\.[A-Za-z]\w{1,4}", cell))


def positions(rows: Cells) -> tuple[str, ...]:
    """Image or time, latitude and longitude in either order if one is above 90, height, perhaps three angles of the
    camera, perhaps two accuracies, as Pix4D writes them."""
    first = "image" if is_file(rows[0][0]) else "time" if np.isfinite(parse_time(rows[0][0])) else ""
    values = _numbers(rows)
    width = values.shape[1] + 1
    if width not in (4, 6, 7, 9) or not first or np.isnan(values).any():
        return ()
    return (first, *_degrees(values), *_behind(values)) if _degrees(values) else ()


def geotxt(rows: Cells) -> tuple[str, ...]:
    """The columns of ODM's geo.txt. Accuracies follow three angles."""
    width = max(len(cells) for cells in rows)
    sigmas = ("sigma_h", "sigma_v") if width > 8 else ()
    names = ("image", "x", "y", "z", "angle_1", "angle_2", "angle_3", *sigmas)
    return (*names, *(f"more_{k}" for k in range(width)))[: max(width, 4)]


def points(rows: Cells, crs: pyproj.CRS | None) -> tuple[str, ...]:
    """Marks (image and point in either order, two pixels); or a point, its place in degrees, or in a grid if only
    one order lies in its area of use (PNEZD, PENZD), height, perhaps two accuracies, perhaps a code."""
    values = _numbers(rows)
    width = values.shape[1] + 1
    if width == 4 and np.isnan(values[:, 0]).all() and np.isfinite(values[:, 1:]).all():
        first, second = (is_file(cell) for cell in rows[0][:2])
        names = ("image", "name") if first else ("name", "image")
        return (*names, "px", "py") if first != second else ()
    if width < 4 or np.isnan(values[:, :3]).any():
        return ()
    codes = tuple(f"code_{k}" for k in range(1, width - 3))
    behind = _behind(values) if width == 6 and np.isfinite(values).all() else ("height", *codes)
    order: tuple[str, ...] = _degrees(values) if crs is None or crs.is_geographic else ()
    if crs is not None and crs.is_projected:
        fits = [bool(within_area(crs.srs, values[:, k]).all()) for k in ([0, 1], [1, 0])]
        if fits[0] != fits[1]:
            order = ("easting", "northing") if fits[0] else ("northing", "easting")
    return ("name", *order, *behind) if order else ()


def times(rows: Cells) -> tuple[str, ...]:
    """An image and a time in either order, or a time; a date and a time may be two cells."""
    kinds = ["image" if is_file(c) else "time" if np.isfinite(parse_time(c)) else "" for c in rows[0]]
    if kinds[-2:] == ["time", "time"]:
        kinds[-2] = "date"
    known = sorted(kinds) in (["time"], ["image", "time"], ["date", "time"], ["date", "image", "time"])
    return tuple(kinds) if known else ()


def _numbers(rows: Cells) -> np.ndarray:
    """(R, C - 1) of the cells after the first, NaN for cells without a number."""
    width = max(len(cells) for cells in rows)
    return np.array([[number(c) for c in (*cells, *("",) * width)[1:width]] for cells in rows]).reshape(len(rows), -1)


def _degrees(values: np.ndarray) -> tuple[str, ...]:
    a, b = np.abs(values[:, :2]).max(axis=0)
    if max(a, b) > 180 or (a <= 90) == (b <= 90):
        return ()
    return ("lat", "lon") if a <= 90 else ("lon", "lat")


def _behind(values: np.ndarray) -> tuple[str, ...]:
    """Names of the columns from the height on."""
    width = values.shape[1] + 1
    turns = ("angle_1", "angle_2", "angle_3") if width in (7, 9) else ()
    return ("height", *turns, *(("accuracy_horz", "accuracy_vert") if width in (6, 9) else ()))
