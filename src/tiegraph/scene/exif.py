"""What a camera wrote into its file: focal length, position, time, orientation."""

import re
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tiegraph.scene import exif as tags
from tiegraph.scene.gnss import HEIGHT_RANGE_M, SIGMA_RANGE_M
from tiegraph.scene.xmp import RigTags, read_rig_tags, read_rtk_position

NAN = float("nan")
# Tags of the EXIF 2.32 standard (CIPA DC-008).
EXIF_IFD, GPS_IFD = 0x8769, 0x8825
_MAKE, _MODEL, _ORIENTATION, _DATE_TIME = 0x010F, 0x0110, 0x0112, 0x0132
TIME_ORIGINAL, SUBSEC_ORIGINAL, OFFSET_ORIGINAL = 0x9003, 0x9291, 0x9011
_EXPOSURE_S, _F_NUMBER, _ISO = 0x829A, 0x829D, 0x8827
_FOCAL_MM, _FOCAL_35MM, _LENS = 0x920A, 0xA405, 0xA434
_PLANE_X, _PLANE_UNIT, _EXIF_WIDTH, _EXIF_HEIGHT = 0xA20E, 0xA210, 0xA002, 0xA003
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
_DIAGONAL_35MM = 43.27  # mm; CIPA DC-008 compares the diagonals of the fields of view


@dataclass(frozen=True)
class Exif:
    """EXIF facts in SI units; NaN or "" = not written or not believable."""

    orientation: int = 1  # 1..8
    focal_px: float = NAN  # pixels of the image as stored
    lat_deg: float = NAN
    lon_deg: float = NAN
    height_m: float = NAN
    position_sigma_m: float = NAN
    time_s: float = NAN  # seconds since 1970; in the camera's own clock and zone unless time_utc
    time_utc: bool = False
    make: str = ""
    model: str = ""
    lens: str = ""
    focal_mm: float = NAN
    exposure: float = NAN  # time in s x ISO / (f-number squared); a fixed aperture or ISO may be left away
    rig: RigTags = RigTags()
    doubt: str = ""  # what is wrong with the position as written; it is used where lat_deg is finite all the same


def orientation_of(path: Path) -> int:
    """EXIF orientation of an image file, 1 to 8; 1 where nothing says it."""
    try:
        with Image.open(path) as image:
            return orientation_in(image)
    except Exception:  # see read_exif
        return 1


def orientation_in(image: Any) -> int:
    """EXIF orientation of an opened PIL image, 1 to 8; 1 where nothing says it."""
    try:
        return _orientation(image.getexif())
    except Exception:  # see read_exif
        return 1


def read_exif(image: Any, size: tuple[int, int], focal_range: tuple[float, float]) -> Exif:
    """EXIF of an opened PIL image, whose pixels are ``size`` (width, height); damaged entries count as not written, as
    do focal lengths out of a range (in longer image sides)."""
    try:
        base = image.getexif()
        detail, gps = base.get_ifd(EXIF_IFD), base.get_ifd(GPS_IFD)
    except Exception:  # a damaged EXIF block makes PIL raise anything from struct.error to SyntaxError
        return Exif()
    place, doubt = _place(gps)
    rtk = read_rtk_position(image)  # EXIF rounds to millimetres at best, and has no accuracy
    if _is_place(rtk):
        place, doubt = rtk, ""
    time_s, utc = _time(base, detail)
    return Exif(
        orientation=_orientation(base),
        focal_px=_focal(detail, size, focal_range),
        lat_deg=place[0],
        lon_deg=place[1],
        height_m=place[2],
        position_sigma_m=place[3],
        time_s=time_s,
        time_utc=utc,
        make=_text(base.get(_MAKE)),
        model=_text(base.get(_MODEL)),
        lens=_text(detail.get(_LENS)),
        focal_mm=_positive(detail.get(_FOCAL_MM)),
        exposure=_exposure(detail),
        rig=read_rig_tags(image),
        doubt=doubt,
    )


def _place(gps: dict) -> tuple[tuple[float, ...], str]:
    """Latitude, longitude, height and sigma, NaN where not written or not believable, and what is not believable."""
    if 2 not in gps and 4 not in gps:
        return (NAN, NAN, NAN, NAN), ""
    lat, lon, height, sigma = _angle(gps, 2, 1, "S"), _angle(gps, 4, 3, "W"), _height(gps), _positive(gps.get(31))
    if not (abs(lat) <= 90 and abs(lon) <= 180):
        return (NAN, NAN, NAN, NAN), f"latitude {lat:g}, longitude {lon:g} is no place on the Earth"
    if lat == 0 and lon == 0:
        return (NAN, NAN, NAN, NAN), "latitude 0, longitude 0 is what a receiver without a fix writes"
    if sigma > SIGMA_RANGE_M[1]:
        return (NAN, NAN, NAN, NAN), f"an accuracy of {sigma:g} m is none"
    if 6 in gps and not HEIGHT_RANGE_M[0] <= height <= HEIGHT_RANGE_M[1]:
        return (lat, lon, NAN, sigma), f"height {height:g} m is none (the position is taken without it)"
    if not (_text(gps.get(1)) and _text(gps.get(3))):
        return (lat, lon, height, sigma), "nothing says whether it is north or south, east or west (N and E assumed)"
    return (lat, lon, height, sigma if sigma >= SIGMA_RANGE_M[0] else NAN), ""


def _is_place(given: tuple[float, ...]) -> bool:
    """Whether latitude, longitude, height and sigma are those of a receiver with a position."""
    lat, lon, height, sigma = given
    low, high = HEIGHT_RANGE_M
    sure = SIGMA_RANGE_M[0] <= sigma <= SIGMA_RANGE_M[1]
    return abs(lat) <= 90 and abs(lon) <= 180 and (lat, lon) != (0, 0) and low <= height <= high and sure


def _focal(detail: dict, size: tuple[int, int], range_: tuple[float, float]) -> float:
    """Focal length in pixels of the file, told by its 35 mm equivalent or by the size of a pixel. Both are of the
    photograph as it was taken, which may have been made smaller, turned, or cut in one direction since."""
    (width, height), longer = size, max(size)
    wide, high = _positive(detail.get(_EXIF_WIDTH)), _positive(detail.get(_EXIF_HEIGHT))
    if not wide * high > 0:
        wide, high = size
    smaller = min(max(width / wide, height / high), max(width / high, height / wide))
    equivalent = _positive(detail.get(_FOCAL_35MM))
    focal = equivalent / _DIAGONAL_35MM * (wide**2 + high**2) ** 0.5 * smaller
    if _believable(focal, longer, range_):
        return focal
    mm, density = _positive(detail.get(_FOCAL_MM)), _positive(detail.get(_PLANE_X))
    unit_mm = _UNIT_MM.get(int(_number(detail.get(_PLANE_UNIT, 2), 2)), 25.4)
    focal = mm * density / unit_mm * smaller
    return focal if _believable(focal, longer, range_) else NAN


def _exposure(detail: dict) -> float:
    iso = detail.get(_ISO, 1)
    sensitivity = _positive(iso[0] if isinstance(iso, tuple) and iso else iso)
    return _positive(detail.get(_EXPOSURE_S)) * sensitivity / _positive(detail.get(_F_NUMBER, 1)) ** 2


def _orientation(base: Any) -> int:
    number = _number(base.get(_ORIENTATION, 1))
    return int(number) if number in range(1, 9) else 1


def _believable(focal_px: float, longer_px: int, range_: tuple[float, float]) -> bool:
    return range_[0] * longer_px <= focal_px <= range_[1] * longer_px


def _angle(gps: dict, key: int, reference_key: int, negative: str) -> float:
    try:
        degrees, minutes, seconds = (float(v) for v in gps[key])
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return NAN
    sign = -1.0 if _text(gps.get(reference_key)).upper().startswith(negative) else 1.0
    return sign * (degrees + minutes / 60 + seconds / 3600)


def _height(gps: dict) -> float:
    height = _number(gps.get(6), NAN)
    reference = gps.get(5)
    below = reference in (1, 3, b"\x01", b"\x03")  # 2 and 3 (EXIF 3.0): above and below sea level, no ellipsoid
    return -height if below else height


def _time(base: Any, detail: dict) -> tuple[float, bool]:
    text = _text(detail.get(TIME_ORIGINAL)) or _text(base.get(_DATE_TIME))
    try:
        stamp = datetime.strptime(text[:19], "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return NAN, False
    fraction = _text(detail.get(SUBSEC_ORIGINAL))
    seconds = float(f"0.{fraction}") if fraction.isdigit() else 0.0
    offset = re.fullmatch(r"([+-])(\d\d):(\d\d)", _text(detail.get(OFFSET_ORIGINAL)))
    shift = timedelta()
    if offset:
        shift = timedelta(hours=int(offset[2]), minutes=int(offset[3])) * (1 if offset[1] == "+" else -1)
    try:
        utc = (stamp - shift).replace(tzinfo=timezone.utc)
    except OverflowError:  # the first day of the year 1
        return NAN, False
    return utc.timestamp() + seconds, offset is not None


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    return value.strip("\0 ") if isinstance(value, str) else ""


def _number(value: Any, otherwise: float = NAN) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return otherwise


def _positive(value: Any) -> float:
    number = _number(value)
    return number if 0 < number < float("inf") else NAN


@dataclass(frozen=True)
class Taken:
    """When (seconds since 1970) and where a picture was taken; NaN = unknown."""

    time_s: float = tags.NAN
    utc: bool = False  # else in the camera's own clock
    lat_deg: float = tags.NAN
    lon_deg: float = tags.NAN
    height_m: float = tags.NAN
    sigma_m: float = tags.NAN


def exif_of(taken: Taken) -> Image.Exif:
    """EXIF 2.32 block: time to the microsecond, position to 0.1 mm."""
    block = Image.Exif()
    if np.isfinite(taken.time_s):
        when = datetime(1970, 1, 1) + timedelta(microseconds=round(taken.time_s * 1e6))
        detail = block.get_ifd(tags.EXIF_IFD)
        detail[tags.TIME_ORIGINAL] = f"{when:%Y:%m:%d %H:%M:%S}"
        detail[tags.SUBSEC_ORIGINAL] = f"{when.microsecond:06d}"
        if taken.utc:
            detail[tags.OFFSET_ORIGINAL] = "+00:00"
    if np.isfinite(taken.lat_deg) and np.isfinite(taken.lon_deg):
        _write_place(block.get_ifd(tags.GPS_IFD), taken)
    return block


def _write_place(gps: dict[int, Any], taken: Taken) -> None:
    for key, value, words in ((1, taken.lat_deg, "NS"), (3, taken.lon_deg, "EW")):
        gps[key] = words[value < 0]
        gps[key + 1] = _sexagesimal(abs(value))
    if np.isfinite(taken.height_m):
        gps[5], gps[6] = b"\x01" if taken.height_m < 0 else b"\x00", abs(taken.height_m)
    if np.isfinite(taken.sigma_m):
        gps[31] = taken.sigma_m


def _sexagesimal(degrees: float) -> tuple[float, float, float]:
    minutes, seconds = divmod(round(degrees * 3600, 6), 60)
    return float(minutes // 60), float(minutes % 60), round(seconds, 6)
