"""What columns of tables are called, by what they hold: one list for all tables.

Words are in lower case without accents, units and signs, as ``table.plain_word`` makes them. The first that a table has
counts.
"""

import re

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


UNIT_M = {
    "m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048,
    "feet": 0.3048, "foot": 0.3048, "ftus": 1200 / 3937, "us-ft": 1200 / 3937, "us ft": 1200 / 3937,
    "us survey feet": 1200 / 3937,
}  # fmt: skip
UNIT_S = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_SUFFIX = re.compile(rf"(.+?)(?:_in)?_({'|'.join([*UNIT_M, *UNIT_S, 'deg', 'degrees'])})")


def without_unit(column: str) -> tuple[str, str]:
    """A column's name without the unit at its end, and that unit: height_ft, time_ns, hohe_in_m."""
    found = _SUFFIX.fullmatch(column)
    return (found[1], found[2]) if found else (column, "")
