"""XMP metadata of cameras and programs: the rig of a multispectral camera, positions, and EXIF's own tags.

The rig's tags are those of Pix4D's namespace Camera (http://pix4d.com/camera/1.0), written by Parrot, MicaSense and
Sentera, as attributes, as elements or as lists: RigCameraIndex, BandName, RigRelatives and
RigRelativesReferenceRigCameraIndex; and GPSXYAccuracy, GPSZAccuracy, in metres. DJI's are in its namespace drone-dji
(DJI, photo file description): GpsLatitude, GpsLongitude (in old firmware GpsLongtitude), AbsoluteAltitude, RtkFlag (0
none, 16 single, 34 float, 50 fixed) and the standard deviations RtkStdLat, RtkStdLon, RtkStdHgt in metres. Adobe's
programs omit EXIF in some formats and write its tags as exif:GPSLatitude="35,41.37N" (XMP part 2).
"""

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.scene.cells import number

XMP_TAG = 700  # of TIFF
_DJI = "drone-dji"
NAN = float("nan")


@dataclass(frozen=True)
class RigTags:
    """The rig of one image; index -1, "" and () = not written."""

    index: int = -1  # of the camera in its rig
    band: str = ""
    relatives_deg: tuple[float, ...] = ()  # omega, phi, kappa of this camera in the reference camera
    reference: int = -1  # index of the reference camera


class Place(NamedTuple):
    """Position of an image, and its sigmas (horizontal, up); NaN = not written."""

    lat_deg: float = NAN
    lon_deg: float = NAN
    height_m: float = NAN
    sigma_m: float = NAN
    sigma_up_m: float = NAN


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


def read_place(text: str) -> tuple[Place, bool]:
    """The position in the XMP of an image, and whether a receiver with an RTK fix wrote it."""
    rtk = number(xmp_value(text, "RtkFlag", _DJI)) > 0
    dji = {t: number(xmp_value(text, t, _DJI)) for t in ("GpsLatitude", "GpsLongitude", "GpsLongtitude")}
    lat, lon = dji["GpsLatitude"], dji["GpsLongitude"]
    lon = dji["GpsLongtitude"] if np.isnan(lon) else lon
    height = number(xmp_value(text, "AbsoluteAltitude", _DJI))
    if np.isnan(lat):
        lat, lon = (_degrees(xmp_value(text, t, "exif")) for t in ("GPSLatitude", "GPSLongitude"))
    if np.isnan(height):
        below = xmp_value(text, "GPSAltitudeRef", "exif") == "1"
        height = ratio(xmp_value(text, "GPSAltitude", "exif")) * (-1 if below else 1)
    flat, up = (number(xmp_value(text, f"GPS{axes}Accuracy")) for axes in ("XY", "Z"))
    if rtk:
        flat = max(number(xmp_value(text, tag, _DJI)) for tag in ("RtkStdLat", "RtkStdLon"))
        up = number(xmp_value(text, "RtkStdHgt", _DJI))
    return Place(lat_deg=lat, lon_deg=lon, height_m=height, sigma_m=flat, sigma_up_m=up), rtk


def _degrees(text: str) -> float:
    """Degrees of "35,41.37N" or "35,41,22N"."""
    found = re.fullmatch(r"(\d+),(\d+(?:\.\d+)?)(?:,(\d+(?:\.\d+)?))?([NSEW])", text)
    if found is None:
        return NAN
    size = int(found[1]) + float(found[2]) / 60 + float(found[3] or 0) / 3600
    return -size if found[4] in "SW" else size


def ratio(text: str) -> float:
    """The number in "88/10" or "8.8", NaN if it is none."""
    try:
        return float(Fraction(text))
    except (ValueError, ZeroDivisionError):
        return NAN


def relative_rotation(relatives_deg: tuple[float, ...]) -> np.ndarray:
    """(3, 3) reference_from_camera of RigRelatives: Rx(omega) Ry(phi) Rz(kappa), both frames x right, y down, z forward
    (as MicaSense's own library lays its bands on each other)."""
    return Rotation.from_euler("XYZ", relatives_deg, degrees=True).as_matrix()


def xmp_text(image: Any) -> str:
    """The XMP of an opened PIL image, "" without any."""
    found = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or b""
    try:
        found = found or getattr(image, "tag_v2", {}).get(XMP_TAG, b"")
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
