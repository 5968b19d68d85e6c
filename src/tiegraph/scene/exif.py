"""Metadata that a camera wrote into its file, as EXIF 2.32 (CIPA DC-008) and as XMP.

The rig's tags in XMP are those of Pix4D's namespace Camera (http://pix4d.com/camera/1.0), written by Parrot, MicaSense
and Sentera, as attributes, as elements or as lists: RigCameraIndex, BandName, RigRelatives and
RigRelativesReferenceRigCameraIndex; and GPSXYAccuracy, GPSZAccuracy, in metres. DJI's are in its namespace drone-dji
(DJI, photo file description): GpsLatitude, GpsLongitude (in old firmware GpsLongtitude), AbsoluteAltitude, RtkFlag (0
none, 16 single, 34 float, 50 fixed) and the standard deviations RtkStdLat, RtkStdLon, RtkStdHgt in metres. Adobe's
programs omit EXIF in some formats and write its tags as exif:GPSLatitude="35,41.37N" (XMP part 2).
"""

import re
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from scipy.spatial.transform import Rotation

from tiegraph.geometry.geodesy import crs_transformer
from tiegraph.scene.cells import number, seconds_of
from tiegraph.scene.gnss.fixes import SIGMA_RANGE_M

_DJI = "drone-dji"  # its namespace in XMP
NAN = float("nan")
_FOCAL_RANGE = (0.2, 20.0)  # plausible, in longer image sides: 136 degrees of view ... a 700 mm lens
_DIAGONAL_35MM = 43.27  # mm; CIPA DC-008 compares the diagonals of the fields of view
# Tags by which Adobe's programs write the same: tag, namespace and name in XMP.
_BASE_IN_XMP = ((Base.Make, "tiff", "Make"), (Base.Model, "tiff", "Model"))
_DETAIL_IN_XMP = (
    *((tag, "exif", tag.name) for tag in (Base.DateTimeOriginal, Base.FocalLength, Base.FocalLengthIn35mmFilm)),
    (Base.LensModel, "aux", "Lens"),
)
_WHEN = re.compile(r"(\d{4})[:/-](\d\d)[:/-](\d\d)[T ](\d\d):(\d\d):(\d\d)(\.\d+)?(Z|[+-]\d\d:?\d\d)?")
_ZONE = re.compile(r"Z|([+-])(\d\d):?(\d\d)")
_LIKE_WGS84 = re.compile(r"(WGS|ITRF|JGD|ETRS|GDA|NAD83|CGCS).*|")  # datums within some metres of it
_TOKYO, _TOKYO_SIGMA_M = "EPSG:4301", 9.0  # the accuracy that EPSG states of its parameters (operation 1230)
_CLOCK_OFF_S = 120.0  # of a camera whose receiver tells its zone: half of the least difference of zones is 450 s


@dataclass(frozen=True)
class RigTags:
    """The rig of one image; index -1, "" and () = not written."""

    index: int = -1  # of the camera in its rig
    band: str = ""
    relatives_deg: tuple[float, ...] = ()  # omega, phi, kappa of this camera in the reference camera
    reference: int = -1  # index of the reference camera


@dataclass(frozen=True)
class Taken:
    """Where and when a picture was taken; NaN = not known."""

    lat_deg: float = NAN
    lon_deg: float = NAN
    height_m: float = NAN
    sigma_m: float = NAN  # horizontal
    sigma_up_m: float = NAN
    time_s: float = NAN  # seconds since 1970; in the camera's own clock and zone unless utc
    utc: bool = False


@dataclass(frozen=True)
class Exif(Taken):
    """EXIF facts in SI units; NaN or "" = not written or not plausible."""

    orientation: int = 1  # 1..8
    focal_px: float = NAN  # pixels of the image as stored
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
        number = _number(image.getexif().get(Base.Orientation, 1))
    except Exception:  # see read_exif
        return 1
    return int(number) if number in range(1, 9) else 1


def read_exif(image: Any, size: tuple[int, int]) -> Exif:
    """EXIF of an opened PIL image of ``size`` (width, height). Damaged entries and implausible focal lengths count as
    not written."""
    try:
        base = image.getexif()
        detail, gps = base.get_ifd(IFD.Exif), base.get_ifd(IFD.GPSInfo)
    except Exception:  # a damaged EXIF block makes PIL raise anything from struct.error to SyntaxError
        return Exif()
    xmp = xmp_text(image)
    base, detail = _with_xmp(dict(base), xmp, _BASE_IN_XMP), _with_xmp(detail, xmp, _DETAIL_IN_XMP)
    place, doubt = _place(gps, *read_place(xmp))
    time_s, utc = _time(base, detail)
    iso = detail.get(Base.ISOSpeedRatings, 1)
    sensitivity = _positive(iso[0] if isinstance(iso, tuple) and iso else iso)
    return Exif(
        **vars(replace(place, time_s=time_s, utc=utc)),
        orientation=orientation_in(image),
        focal_px=_focal(detail, size),
        zone_s=NAN if utc else _zone(gps, time_s),
        make=_text(base.get(Base.Make)),
        model=_text(base.get(Base.Model)),
        lens=_text(detail.get(Base.LensModel)),
        focal_mm=_positive(detail.get(Base.FocalLength)),
        zoom=_zoom(detail),
        exposure=_positive(detail.get(Base.ExposureTime)) * sensitivity / _positive(detail.get(Base.FNumber, 1)) ** 2,
        rig=read_rig_tags(xmp),
        doubt=doubt,
    )


def _with_xmp(table: dict, xmp: str, names: tuple[tuple[int, str, str], ...]) -> dict:
    """The tags of EXIF, and those of XMP that it lacks."""
    found = {tag: xmp_value(xmp, name, space) for tag, space, name in names if tag not in table} if xmp else {}
    return {**{tag: value for tag, value in found.items() if value}, **table}


def _place(gps: dict, xmp: Taken, rtk: bool) -> tuple[Taken, str]:
    """Position of an image by EXIF and XMP, NaN if not written or not plausible, and doubts about it."""
    if rtk and np.isfinite(xmp.height_m) and SIGMA_RANGE_M[0] <= xmp.sigma_m <= SIGMA_RANGE_M[1]:
        if abs(xmp.lat_deg) <= 90 and abs(xmp.lon_deg) <= 180 and (xmp.lat_deg, xmp.lon_deg) != (0, 0):
            return xmp, ""
    # 2 and 3 (EXIF 3.0): above and below sea level, no ellipsoid; some programs write a digit
    below = gps.get(GPS.GPSAltitudeRef) in (1, 3, b"\x01", b"\x03", b"1", "1")
    height = _number(gps.get(GPS.GPSAltitude), NAN) * (-1 if below else 1)
    lat, lon = _angle(gps, GPS.GPSLatitude, "S"), _angle(gps, GPS.GPSLongitude, "W")
    known = bool(_text(gps.get(GPS.GPSLatitudeRef)) and _text(gps.get(GPS.GPSLongitudeRef)))
    given = GPS.GPSLatitude in gps or GPS.GPSLongitude in gps
    empty = np.isnan([lat, lon]).all() or (lat, lon) == (0, 0)
    coarser = empty or (_rounds(lat, xmp.lat_deg) and _rounds(lon, xmp.lon_deg))
    if coarser and np.isfinite([xmp.lat_deg, xmp.lon_deg]).all():
        lat, lon, known, given = xmp.lat_deg, xmp.lon_deg, True, True
    if not height > 0 and not height < 0 and np.isfinite(xmp.height_m):
        height = xmp.height_m
    sigmas = xmp.sigma_m, xmp.sigma_up_m
    if rtk or GPS.GPSHPositioningError in gps:
        sigmas = _positive(gps.get(GPS.GPSHPositioningError)), NAN
    if not given:
        return Taken(), ""
    if np.isnan([lat, lon]).all():
        return Taken(), "its fields for latitude and longitude are empty"
    if not (abs(lat) <= 90 and abs(lon) <= 180):
        return Taken(), f"latitude {lat:g}, longitude {lon:g} is no place on the Earth"
    if lat == 0 and lon == 0:
        return Taken(), "latitude 0, longitude 0 is what a receiver without a fix writes"
    if sigmas[0] > SIGMA_RANGE_M[1]:
        return Taken(), f"an accuracy of {sigmas[0]:g} m is none"
    flat, up = (s if s >= SIGMA_RANGE_M[0] else NAN for s in sigmas)
    place = Taken(lat_deg=lat, lon_deg=lon, height_m=height, sigma_m=flat, sigma_up_m=up)
    place, doubt = _in_wgs84(place, _text(gps.get(GPS.GPSMapDatum)))
    if _text(gps.get(GPS.GPSStatus)).upper() == "V":
        return place, "the receiver had no fix when it was taken (GPSStatus V), so the position may be an old one"
    if not known:
        return place, "north or south, east or west are not given (N and E assumed)"
    return place, doubt


def _rounds(coarse_deg: float, fine_deg: float) -> bool:
    """Whether an angle was rounded to whole seconds, or tenths of them, in place of another."""
    coarse, fine = coarse_deg * 3600, fine_deg * 3600
    digits = next((k for k in range(5) if abs(coarse * 10**k - round(coarse * 10**k)) < 1e-3), 5)
    return abs(coarse - fine) <= 10.0**-digits


def _in_wgs84(place: Taken, datum: str) -> tuple[Taken, str]:
    """A position in the datum of EXIF, converted to WGS 84, and doubts about it."""
    plain = re.sub(r"[^A-Z0-9]", "", datum.upper())
    if plain == "TOKYO":
        lon, lat, _ = crs_transformer(_TOKYO).transform(place.lon_deg, place.lat_deg, 0.0, "INVERSE")
        return replace(place, lat_deg=lat, lon_deg=lon, sigma_m=max(_TOKYO_SIGMA_M, np.nan_to_num(place.sigma_m))), ""
    doubt = f"its datum is {datum}, which may lie hundreds of metres from WGS 84"
    return place, "" if _LIKE_WGS84.fullmatch(plain) else doubt


def _focal(detail: dict, size: tuple[int, int]) -> float:
    """Focal length in pixels of the file, by its 35 mm equivalent or by the size of a pixel."""
    (width, height), longer = size, max(size)
    wide, high = _positive(detail.get(Base.ExifImageWidth)), _positive(detail.get(Base.ExifImageHeight))
    if not wide * high > 0:
        wide, high = size
    smaller = min(max(width / wide, height / high), max(width / high, height / wide))
    equivalent = _positive(detail.get(Base.FocalLengthIn35mmFilm))
    focal = equivalent / _DIAGONAL_35MM * (wide**2 + high**2) ** 0.5 * smaller
    mm, density = _positive(detail.get(Base.FocalLength)), _positive(detail.get(Base.FocalPlaneXResolution))
    unit = int(_number(detail.get(Base.FocalPlaneResolutionUnit), 2))
    unit_mm = {3: 10.0, 4: 1.0, 5: 0.001}.get(unit, 25.4)
    by_pixels, zoom = mm * density / unit_mm * smaller, _zoom(detail)
    if focal < by_pixels * zoom**0.5:  # some cameras leave a digital zoom out of the equivalent
        focal *= zoom
    low, high = (longer * share for share in _FOCAL_RANGE)
    return next((f for f in (focal, by_pixels * zoom) if low <= f <= high), NAN)


def _zoom(detail: dict) -> float:
    return max(1.0, _positive(detail.get(Base.DigitalZoomRatio)))  # 1 of NaN


def _angle(gps: dict, key: int, negative: str) -> float:
    """Degrees of up to three numbers, the last perhaps empty (0/0); some cameras write a sign beside the letter."""
    given = gps.get(key)
    parts = [_number(v) for v in (given if isinstance(given, tuple) else (given,))][:3]
    if not parts or np.isnan(parts[0]):
        return NAN
    size = sum(abs(part) / 60**k for k, part in enumerate(parts) if np.isfinite(part))
    return -size if parts[0] < 0 or _text(gps.get(key - 1)).upper().startswith(negative) else size


def _time(base: dict, detail: dict) -> tuple[float, bool]:
    """Seconds since 1970, and whether they are UTC: by the first valid one of EXIF's three times."""
    for kind, table in (("Original", detail), ("Digitized", detail), ("", base)):
        text, fraction = table.get(Base[f"DateTime{kind}"]), detail.get(Base[f"SubsecTime{kind}"])
        zone = detail.get(Base[f"OffsetTime{kind}"], detail.get(Base.OffsetTime))
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
    day, clock = re.fullmatch(r"(\d{4})\D(\d\d)\D(\d\d)", _text(gps.get(GPS.GPSDateStamp))), gps.get(GPS.GPSTimeStamp)
    if day is None or not isinstance(clock, tuple) or len(clock) != 3:
        return NAN
    second = sum(_number(v) * 60 ** (2 - k) for k, v in enumerate(clock))
    ahead = time_s - seconds_of("".join(day.groups()), "%Y%m%d") - second
    zone = round(ahead / 900) * 900.0 if abs(ahead) < 15 * 3600 else NAN
    return zone if abs(ahead - zone) <= _CLOCK_OFF_S else NAN


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    return value.strip("\0 ") if isinstance(value, str) else ""


def _number(value: Any, otherwise: float = NAN) -> float:
    try:
        return float(Fraction(value) if isinstance(value, str) else value)  # of XMP: "88/10", "8.8"
    except (TypeError, ValueError, ZeroDivisionError):
        return otherwise


def _positive(value: Any) -> float:
    number = _number(value)
    return number if 0 < number < float("inf") else NAN


def exif_of(taken: Taken) -> Image.Exif:
    """EXIF 2.32 block: time to the microsecond, position to 0.1 mm."""
    block = Image.Exif()
    if np.isfinite(taken.time_s):
        when = datetime(1970, 1, 1) + timedelta(microseconds=round(taken.time_s * 1e6))
        detail = block.get_ifd(IFD.Exif)
        detail[Base.DateTimeOriginal] = f"{when:%Y:%m:%d %H:%M:%S}"
        detail[Base.SubsecTimeOriginal] = f"{when.microsecond:06d}"
        if taken.utc:
            detail[Base.OffsetTimeOriginal] = "+00:00"
    if np.isfinite(taken.lat_deg) and np.isfinite(taken.lon_deg):
        gps = block.get_ifd(IFD.GPSInfo)
        for key, value, words in ((GPS.GPSLatitude, taken.lat_deg, "NS"), (GPS.GPSLongitude, taken.lon_deg, "EW")):
            gps[key - 1] = words[value < 0]
            minutes, seconds = divmod(round(abs(value) * 3600, 6), 60)
            gps[key] = float(minutes // 60), float(minutes % 60), round(seconds, 6)
        if np.isfinite(taken.height_m):
            gps[GPS.GPSAltitudeRef] = b"\x01" if taken.height_m < 0 else b"\x00"
            gps[GPS.GPSAltitude] = abs(taken.height_m)
        if np.isfinite(taken.sigma_m):
            gps[GPS.GPSHPositioningError] = taken.sigma_m
    return block


def read_rig_tags(text: str) -> RigTags:
    """Rig tags of the XMP of an image; damaged ones count as not written."""
    if "RigCameraIndex" not in text and "BandName" not in text:
        return RigTags()
    angles = [number(v) for v in re.split(r"[,\s]+", xmp_value(text, "RigRelatives")) if v]
    good = len(angles) == 3 and bool(np.all(np.abs(angles) <= 360.0))
    numbers = (xmp_value(text, tag) for tag in ("RigCameraIndex", "RigRelativesReferenceRigCameraIndex"))
    index, reference = (int(n) if re.fullmatch(r"\d{1,3}", n) else -1 for n in numbers)
    band, relatives = xmp_value(text, "BandName")[:40], tuple(angles) if good else ()
    return RigTags(index=index, band=band, relatives_deg=relatives, reference=reference)


def read_place(text: str) -> tuple[Taken, bool]:
    """The position in the XMP of an image, and whether a receiver with an RTK fix wrote it."""
    rtk = number(xmp_value(text, "RtkFlag", _DJI)) > 0
    lat, *lons = (number(xmp_value(text, f"Gps{t}", _DJI)) for t in ("Latitude", "Longitude", "Longtitude"))
    lon = lons[1] if np.isnan(lons[0]) else lons[0]
    height = number(xmp_value(text, "AbsoluteAltitude", _DJI))
    if np.isnan(lat):
        lat, lon = (_degrees(xmp_value(text, t, "exif")) for t in ("GPSLatitude", "GPSLongitude"))
    if np.isnan(height):
        below = xmp_value(text, "GPSAltitudeRef", "exif") == "1"
        height = _number(xmp_value(text, "GPSAltitude", "exif")) * (-1 if below else 1)
    flat, up = (number(xmp_value(text, f"GPS{axes}Accuracy")) for axes in ("XY", "Z"))
    if rtk:
        flat = max(number(xmp_value(text, tag, _DJI)) for tag in ("RtkStdLat", "RtkStdLon"))
        up = number(xmp_value(text, "RtkStdHgt", _DJI))
    return Taken(lat_deg=lat, lon_deg=lon, height_m=height, sigma_m=flat, sigma_up_m=up), rtk


def _degrees(text: str) -> float:
    """Degrees of "35,41.37N" or "35,41,22N"."""
    found = re.fullmatch(r"(\d+),(\d+(?:\.\d+)?)(?:,(\d+(?:\.\d+)?))?([NSEW])", text)
    if found is None:
        return NAN
    size = int(found[1]) + float(found[2]) / 60 + float(found[3] or 0) / 3600
    return -size if found[4] in "SW" else size


def relative_rotation(relatives_deg: tuple[float, ...]) -> np.ndarray:
    """(3, 3) reference_from_camera of RigRelatives: Rx(omega) Ry(phi) Rz(kappa), both frames x right, y down, z forward
    (as MicaSense's own library lays its bands on each other)."""
    return Rotation.from_euler("XYZ", relatives_deg, degrees=True).as_matrix()


def xmp_text(image: Any) -> str:
    """The XMP of an opened PIL image, "" without any."""
    found = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or b""
    try:
        found = found or getattr(image, "tag_v2", {}).get(Base.XMLPacket, b"")
    except Exception:  # a damaged directory
        return ""
    return found.decode("utf-8", errors="replace") if isinstance(found, bytes) else str(found)


def xmp_value(text: str, tag: str, space: str = "Camera") -> str:
    """Text of a tag written as an attribute, as an element or as a list, its items separated by blanks."""
    attribute = re.search(rf'\b{space}:{tag}\s*=\s*["\']([^"\']*)["\']', text)
    if attribute:
        return attribute[1].strip()
    element = re.search(rf"<{space}:{tag}(?:\s[^>]*)?>(.*?)</{space}:{tag}>", text, re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", " ", element[1]).split()) if element else ""
