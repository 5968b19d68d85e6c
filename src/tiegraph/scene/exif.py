"""Metadata that a camera wrote into its file: focal length, position, time, orientation."""

import re
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tiegraph.geometry.geodesy import crs_transformer
from tiegraph.scene.cells import seconds_of
from tiegraph.scene.gnss.fixes import SIGMA_RANGE_M
from tiegraph.scene.xmp import NAN, Place, RigTags, ratio, read_place, read_rig_tags, xmp_text, xmp_value

# Tags of the EXIF 2.32 standard (CIPA DC-008).
EXIF_IFD, GPS_IFD = 0x8769, 0x8825
_MAKE, _MODEL, _ORIENTATION, _DATE_TIME = 0x010F, 0x0110, 0x0112, 0x0132
TIME_ORIGINAL, SUBSEC_ORIGINAL, OFFSET_ORIGINAL = 0x9003, 0x9291, 0x9011
_TIME_DIGITIZED, _SUBSEC_DIGITIZED, _OFFSET_DIGITIZED, _SUBSEC, _OFFSET = 0x9004, 0x9292, 0x9012, 0x9290, 0x9010
_EXPOSURE_S, _F_NUMBER, _ISO = 0x829A, 0x829D, 0x8827
_FOCAL_MM, _FOCAL_35MM, _LENS, _ZOOM = 0x920A, 0xA405, 0xA434, 0xA404
_PLANE_X, _PLANE_UNIT, _EXIF_WIDTH, _EXIF_HEIGHT = 0xA20E, 0xA210, 0xA002, 0xA003
_DIAGONAL_35MM = 43.27  # mm; CIPA DC-008 compares the diagonals of the fields of view
# Tags by which Adobe's programs write the same: tag, namespace and name in XMP.
_BASE_IN_XMP = ((_MAKE, "tiff", "Make"), (_MODEL, "tiff", "Model"))
_DETAIL_IN_XMP = ((TIME_ORIGINAL, "exif", "DateTimeOriginal"), (_FOCAL_MM, "exif", "FocalLength"),
                  (_FOCAL_35MM, "exif", "FocalLengthIn35mmFilm"), (_LENS, "aux", "Lens"))  # fmt: skip
_WHEN = re.compile(r"(\d{4})[:/-](\d\d)[:/-](\d\d)[T ](\d\d):(\d\d):(\d\d)(\.\d+)?(Z|[+-]\d\d:?\d\d)?")
_ZONE = re.compile(r"Z|([+-])(\d\d):?(\d\d)")
_LIKE_WGS84 = re.compile(r"(WGS|ITRF|JGD|ETRS|GDA|NAD83|CGCS).*|")  # datums within some metres of it
_TOKYO, _TOKYO_SIGMA_M = "EPSG:4301", 9.0  # the accuracy that EPSG states of its parameters (operation 1230)
_CLOCK_OFF_S = 120.0  # of a camera whose receiver tells its zone: half of the least difference of zones is 450 s


@dataclass(frozen=True)
class Exif:
    """EXIF facts in SI units; NaN or "" = not written or not plausible."""

    orientation: int = 1  # 1..8
    focal_px: float = NAN  # pixels of the image as stored
    lat_deg: float = NAN
    lon_deg: float = NAN
    height_m: float = NAN
    position_sigma_m: float = NAN
    height_sigma_m: float = NAN
    time_s: float = NAN  # seconds since 1970; in the camera's own clock and zone unless time_utc
    time_utc: bool = False
    zone_s: float = NAN  # offset of that clock from UTC by the receiver's time, in whole quarters of an hour
    make: str = ""
    model: str = ""
    lens: str = ""
    focal_mm: float = NAN
    zoom: float = 1.0  # digital: the middle of the sensor's picture, enlarged
    exposure: float = NAN  # time in s x ISO / (f-number squared); a fixed aperture or ISO may be missing
    rig: RigTags = RigTags()
    doubt: str = ""  # doubt about the position as written; it is used nevertheless if lat_deg is finite


def orientation_of(path: Path) -> int:
    """EXIF orientation of an image file, 1 to 8; 1 if it has none."""
    try:
        with Image.open(path) as image:
            return orientation_in(image)
    except Exception:  # see read_exif
        return 1


def orientation_in(image: Any) -> int:
    """EXIF orientation of an opened PIL image, 1 to 8; 1 if it has none."""
    try:
        return _orientation(image.getexif())
    except Exception:  # see read_exif
        return 1


def read_exif(image: Any, size: tuple[int, int], focal_range: tuple[float, float]) -> Exif:
    """EXIF of an opened PIL image, whose pixels are ``size`` (width, height); damaged entries count as not written, as
    do focal lengths outside a range (in longer image sides)."""
    try:
        base = image.getexif()
        detail, gps = base.get_ifd(EXIF_IFD), base.get_ifd(GPS_IFD)
    except Exception:  # a damaged EXIF block makes PIL raise anything from struct.error to SyntaxError
        return Exif()
    xmp = xmp_text(image)
    base, detail = _with_xmp(dict(base), xmp, _BASE_IN_XMP), _with_xmp(detail, xmp, _DETAIL_IN_XMP)
    place, doubt = _place(gps, *read_place(xmp))
    time_s, utc = _time(base, detail)
    iso = detail.get(_ISO, 1)
    sensitivity = _positive(iso[0] if isinstance(iso, tuple) and iso else iso)
    return Exif(
        orientation=_orientation(base),
        focal_px=_focal(detail, size, focal_range),
        lat_deg=place.lat_deg,
        lon_deg=place.lon_deg,
        height_m=place.height_m,
        position_sigma_m=place.sigma_m,
        height_sigma_m=place.sigma_up_m,
        time_s=time_s,
        time_utc=utc,
        zone_s=NAN if utc else _zone(gps, time_s),
        make=_text(base.get(_MAKE)),
        model=_text(base.get(_MODEL)),
        lens=_text(detail.get(_LENS)),
        focal_mm=_positive(detail.get(_FOCAL_MM)),
        zoom=_zoom(detail),
        exposure=_positive(detail.get(_EXPOSURE_S)) * sensitivity / _positive(detail.get(_F_NUMBER, 1)) ** 2,
        rig=read_rig_tags(xmp),
        doubt=doubt,
    )


def _with_xmp(table: dict, xmp: str, names: tuple[tuple[int, str, str], ...]) -> dict:
    """The tags of EXIF, and those of XMP that it lacks."""
    found = {tag: xmp_value(xmp, name, space) for tag, space, name in names if tag not in table} if xmp else {}
    return {**{tag: value for tag, value in found.items() if value}, **table}


def _place(gps: dict, xmp: Place, rtk: bool) -> tuple[Place, str]:
    """Position of an image by EXIF and XMP, NaN if not written or not plausible, and doubts about it."""
    if rtk and np.isfinite(xmp.height_m) and SIGMA_RANGE_M[0] <= xmp.sigma_m <= SIGMA_RANGE_M[1]:
        if abs(xmp.lat_deg) <= 90 and abs(xmp.lon_deg) <= 180 and (xmp.lat_deg, xmp.lon_deg) != (0, 0):
            return xmp, ""
    # 2 and 3 (EXIF 3.0): above and below sea level, no ellipsoid; some programs write a digit
    below = gps.get(5) in (1, 3, b"\x01", b"\x03", b"1", "1")
    height = _number(gps.get(6), NAN) * (-1 if below else 1)
    lat, lon = _angle(gps, 2, 1, "S"), _angle(gps, 4, 3, "W")
    known, given = bool(_text(gps.get(1)) and _text(gps.get(3))), 2 in gps or 4 in gps
    empty = np.isnan([lat, lon]).all() or (lat, lon) == (0, 0)
    if empty or (_rounds(lat, xmp.lat_deg) and _rounds(lon, xmp.lon_deg)):
        if np.isfinite([xmp.lat_deg, xmp.lon_deg]).all():
            lat, lon, known, given = xmp.lat_deg, xmp.lon_deg, True, True
    if not height > 0 and not height < 0 and np.isfinite(xmp.height_m):
        height = xmp.height_m
    sigmas = (_positive(gps.get(31)), NAN) if rtk or 31 in gps else (xmp.sigma_m, xmp.sigma_up_m)
    if not given:
        return Place(), ""
    if np.isnan([lat, lon]).all():
        return Place(), "its fields for latitude and longitude are empty"
    if not (abs(lat) <= 90 and abs(lon) <= 180):
        return Place(), f"latitude {lat:g}, longitude {lon:g} is no place on the Earth"
    if lat == 0 and lon == 0:
        return Place(), "latitude 0, longitude 0 is what a receiver without a fix writes"
    if sigmas[0] > SIGMA_RANGE_M[1]:
        return Place(), f"an accuracy of {sigmas[0]:g} m is none"
    flat, up = (s if s >= SIGMA_RANGE_M[0] else NAN for s in sigmas)
    place = Place(lat_deg=lat, lon_deg=lon, height_m=height, sigma_m=flat, sigma_up_m=up)
    place, doubt = _in_wgs84(place, _text(gps.get(18)))
    if _text(gps.get(9)).upper() == "V":
        return place, "the receiver had no fix when it was taken (GPSStatus V), so the position may be an old one"
    if not known:
        return place, "north or south, east or west are not given (N and E assumed)"
    return place, doubt


def _rounds(coarse_deg: float, fine_deg: float) -> bool:
    """Whether an angle was rounded to whole seconds, or tenths of them, in place of another."""
    coarse, fine = coarse_deg * 3600, fine_deg * 3600
    digits = next((k for k in range(5) if abs(coarse * 10**k - round(coarse * 10**k)) < 1e-3), 5)
    return abs(coarse - fine) <= 10.0**-digits


def _in_wgs84(place: Place, datum: str) -> tuple[Place, str]:
    """A position in the datum of EXIF, converted to WGS 84, and doubts about it."""
    plain = re.sub(r"[^A-Z0-9]", "", datum.upper())
    if plain == "TOKYO":
        lon, lat, _ = crs_transformer(_TOKYO).transform(place.lon_deg, place.lat_deg, 0.0, "INVERSE")
        return place._replace(lat_deg=lat, lon_deg=lon, sigma_m=max(_TOKYO_SIGMA_M, np.nan_to_num(place.sigma_m))), ""
    doubt = f"its datum is {datum}, which may lie hundreds of metres from WGS 84"
    return place, "" if _LIKE_WGS84.fullmatch(plain) else doubt


def _focal(detail: dict, size: tuple[int, int], range_: tuple[float, float]) -> float:
    """Focal length in pixels of the file, by its 35 mm equivalent or by the size of a pixel."""
    (width, height), longer = size, max(size)
    wide, high = _positive(detail.get(_EXIF_WIDTH)), _positive(detail.get(_EXIF_HEIGHT))
    if not wide * high > 0:
        wide, high = size
    smaller = min(max(width / wide, height / high), max(width / high, height / wide))
    equivalent = _positive(detail.get(_FOCAL_35MM))
    focal = equivalent / _DIAGONAL_35MM * (wide**2 + high**2) ** 0.5 * smaller
    mm, density = _positive(detail.get(_FOCAL_MM)), _positive(detail.get(_PLANE_X))
    unit_mm = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}.get(int(_number(detail.get(_PLANE_UNIT, 2), 2)), 25.4)
    by_pixels, zoom = mm * density / unit_mm * smaller, _zoom(detail)
    if focal < by_pixels * zoom**0.5:  # some cameras leave a digital zoom out of the equivalent
        focal *= zoom
    return next((f for f in (focal, by_pixels * zoom) if range_[0] * longer <= f <= range_[1] * longer), NAN)


def _zoom(detail: dict) -> float:
    zoom = _positive(detail.get(_ZOOM))
    return zoom if zoom > 1 else 1.0


def _orientation(base: Any) -> int:
    number = _number(base.get(_ORIENTATION, 1))
    return int(number) if number in range(1, 9) else 1


def _angle(gps: dict, key: int, reference_key: int, negative: str) -> float:
    """Degrees of up to three numbers, of which the last may be empty (0/0); some cameras write a sign beside the
    letter."""
    given = gps.get(key)
    parts = [_number(v) for v in (given if isinstance(given, tuple) else (given,))][:3]
    if not parts or np.isnan(parts[0]):
        return NAN
    size = sum(abs(part) / 60**k for k, part in enumerate(parts) if np.isfinite(part))
    return -size if parts[0] < 0 or _text(gps.get(reference_key)).upper().startswith(negative) else size


def _time(base: dict, detail: dict) -> tuple[float, bool]:
    """Seconds since 1970, and whether they are UTC: by the first valid one of EXIF's three times."""
    offset = detail.get(_OFFSET)
    for text, fraction, zone in (
        (detail.get(TIME_ORIGINAL), detail.get(SUBSEC_ORIGINAL), detail.get(OFFSET_ORIGINAL, offset)),
        (detail.get(_TIME_DIGITIZED), detail.get(_SUBSEC_DIGITIZED), detail.get(_OFFSET_DIGITIZED, offset)),
        (base.get(_DATE_TIME), detail.get(_SUBSEC), offset),
    ):
        found = _WHEN.fullmatch(_text(text))
        if found is None:
            continue
        ahead = _ZONE.fullmatch(_text(zone)) or _ZONE.fullmatch(found[8] or "")
        hours, minutes = (int(f"{ahead[1]}{ahead[k]}") for k in (2, 3)) if ahead and ahead[1] else (0, 0)
        seconds = seconds_of("".join(found.groups()[:6]), "%Y%m%d%H%M%S") - 3600 * hours - 60 * minutes
        if np.isnan(seconds):  # the 31st of a short month
            continue
        part = found[7] or (f".{_text(fraction)}" if _text(fraction).isdigit() else ".0")
        return seconds + float(part), ahead is not None
    return NAN, False


def _zone(gps: dict, time_s: float) -> float:
    """Offset of a camera's clock from UTC, by the receiver's date and time."""
    day, clock = re.fullmatch(r"(\d{4})\D(\d\d)\D(\d\d)", _text(gps.get(29))), gps.get(7)
    if day is None or not isinstance(clock, tuple) or len(clock) != 3:
        return NAN
    ahead = (
        time_s
        - seconds_of("".join(day.groups()), "%Y%m%d")
        - sum(_number(v) * 60 ** (2 - k) for k, v in enumerate(clock))
    )
    zone = round(ahead / 900) * 900.0 if abs(ahead) < 15 * 3600 else NAN
    return zone if abs(ahead - zone) <= _CLOCK_OFF_S else NAN


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    return value.strip("\0 ") if isinstance(value, str) else ""


def _number(value: Any, otherwise: float = NAN) -> float:
    try:
        return ratio(value) if isinstance(value, str) else float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return otherwise


def _positive(value: Any) -> float:
    number = _number(value)
    return number if 0 < number < float("inf") else NAN


@dataclass(frozen=True)
class Taken:
    """When (seconds since 1970) and where a picture was taken; NaN = unknown."""

    time_s: float = NAN
    utc: bool = False  # else in the camera's own clock
    lat_deg: float = NAN
    lon_deg: float = NAN
    height_m: float = NAN
    sigma_m: float = NAN


def exif_of(taken: Taken) -> Image.Exif:
    """EXIF 2.32 block: time to the microsecond, position to 0.1 mm."""
    block = Image.Exif()
    if np.isfinite(taken.time_s):
        when = datetime(1970, 1, 1) + timedelta(microseconds=round(taken.time_s * 1e6))
        detail = block.get_ifd(EXIF_IFD)
        detail[TIME_ORIGINAL] = f"{when:%Y:%m:%d %H:%M:%S}"
        detail[SUBSEC_ORIGINAL] = f"{when.microsecond:06d}"
        if taken.utc:
            detail[OFFSET_ORIGINAL] = "+00:00"
    if np.isfinite(taken.lat_deg) and np.isfinite(taken.lon_deg):
        _write_place(block.get_ifd(GPS_IFD), taken)
    return block


def _write_place(gps: dict[int, Any], taken: Taken) -> None:
    for key, value, words in ((1, taken.lat_deg, "NS"), (3, taken.lon_deg, "EW")):
        gps[key] = words[value < 0]
        minutes, seconds = divmod(round(abs(value) * 3600, 6), 60)
        gps[key + 1] = float(minutes // 60), float(minutes % 60), round(seconds, 6)
    if np.isfinite(taken.height_m):
        gps[5], gps[6] = b"\x01" if taken.height_m < 0 else b"\x00", abs(taken.height_m)
    if np.isfinite(taken.sigma_m):
        gps[31] = taken.sigma_m
