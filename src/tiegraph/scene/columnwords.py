"""What columns of tables are: by what they are called, one list for all tables, or, without a header, by their cells.

Words are in lower case without accents, units and signs, as ``textfile.plain_word`` makes them. The first that a table
has counts. What cells say is () where they may be two things.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tiegraph.geometry.geodesy import within_area
from tiegraph.scene.cells import UNIT_M, UNIT_S, number, parse_time

if TYPE_CHECKING:
    import pyproj


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
               "elevation_msl", "altitude_msl", "height_msl", "msl_altitude", "orthometric_height", "hohe_uber_nn",
               "hohe_nhn"),
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
# What a name speaks of that changes what the other columns mean.
_SPEAKS = {
    "an angle": {"yaw", "pitch", "roll", "heading", "omega", "phi", "kappa", "azimuth", "tilt", "course", "bearing"},
    "a hemisphere": {"hemi", "hemisphere", "ref", "ns", "ew"},
    "a unit": {"unit", "units", "einheit"},
    "a fix": {"fix", "fixtype", "quality", "q", "status", "solution", "mode"},
    "a sigma": {"sigma", "std", "stdev", "sd", "sde", "sdn", "sdu", "rms", "hrms", "vrms", "acc", "accuracy", "error",
                "hacc", "vacc"},
    "a height": {"height", "alt", "altitude", "elevation", "elev", "z", "hae", "msl", "ellh", "h"},
    "a datum": {"datum", "crs", "cs", "epsg", "geoid", "undulation", "frame", "zone"},
}  # fmt: skip


def known_words(columns: tuple[str, ...]) -> int:
    """How many columns have a name that some table knows, their units left away."""
    return sum(c in _KNOWN or without_unit(c)[0] in _KNOWN for c in columns)


def speaks_of(column: str) -> str:
    """What a column's name says that may change what others mean, such as "a fix"; "" if nothing."""
    words = set(column.split("_"))
    return next((what for what, own in _SPEAKS.items() if words & own), "")


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
    """Image or time, latitude and longitude in either order where one is above 90, height, perhaps three angles of the
    camera, perhaps two accuracies, as Pix4D writes them."""
    first = "image" if is_file(rows[0][0]) else "time" if np.isfinite(parse_time(rows[0][0])) else ""
    values = _numbers(rows)
    width = values.shape[1] + 1
    if width not in (4, 6, 7, 9) or not first or np.isnan(values).any():
        return ()
    return (first, *_degrees(values), *_behind(values)) if _degrees(values) else ()


def geotxt(rows: Cells) -> tuple[str, ...]:
    """The columns of ODM's geo.txt. Accuracies stand behind three angles."""
    width = max(len(cells) for cells in rows)
    sigmas = ("sigma_h", "sigma_v") if width > 8 else ()
    names = ("image", "x", "y", "z", "angle_1", "angle_2", "angle_3", *sigmas)
    return (*names, *(f"more_{k}" for k in range(width)))[: max(width, 4)]


def points(rows: Cells, crs: pyproj.CRS | None) -> tuple[str, ...]:
    """Marks (image and point in either order, two pixels); or a point, its place in degrees, or in a grid where only
    one order lies in its area of use (PNEZD, PENZD), height, perhaps two accuracies, perhaps a code."""
    values = _numbers(rows)
    width = values.shape[1] + 1
    if width == 4 and np.isnan(values[:, 0]).all() and np.isfinite(values[:, 1:]).all():
        files = is_file(rows[0][0]), is_file(rows[0][1])
        return {(True, False): ("image", "name", "px", "py"), (False, True): ("name", "image", "px", "py")}.get(
            files, ()
        )
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
    """(R, C - 1) of the cells behind the first, NaN for what is none."""
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
