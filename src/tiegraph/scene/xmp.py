"""What cameras write into a file's XMP: the rig of a multispectral camera, and the position of a DJI drone with RTK.

The rig's tags are those of Pix4D's namespace Camera (http://pix4d.com/camera/1.0), written by Parrot, MicaSense and
Sentera, as attributes, as elements or as lists: RigCameraIndex, BandName, RigRelatives and
RigRelativesReferenceRigCameraIndex. DJI's stand in its namespace drone-dji (DJI, photo file description): GpsLatitude,
GpsLongitude (in old firmware GpsLongtitude), AbsoluteAltitude, RtkFlag (0 none, 16 single, 34 float, 50 fixed) and the
standard deviations RtkStdLat, RtkStdLon, RtkStdHgt in metres.
"""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.scene.cells import number

_XMP_TAG = 700  # of TIFF
_MAX_DEG = 360.0
_DJI = "drone-dji"


@dataclass(frozen=True)
class RigTags:
    """The rig of one image; index -1, "" and () = not written."""

    index: int = -1  # of the camera in its rig
    band: str = ""
    relatives_deg: tuple[float, ...] = ()  # omega, phi, kappa of this camera in the reference camera
    reference: int = -1  # index of the reference camera


def read_rig_tags(image: Any) -> RigTags:
    """Rig tags of an opened PIL image; damaged ones count as not written."""
    text = _text(image)
    if "RigCameraIndex" not in text and "BandName" not in text:
        return RigTags()
    angles = [number(v) for v in re.split(r"[,\s]+", _value(text, "RigRelatives")) if v]
    good = len(angles) == 3 and bool(np.all(np.abs(angles) <= _MAX_DEG))
    return RigTags(
        index=_whole(_value(text, "RigCameraIndex")),
        band=_value(text, "BandName")[:40],
        relatives_deg=tuple(angles) if good else (),
        reference=_whole(_value(text, "RigRelativesReferenceRigCameraIndex")),
    )


def read_rtk_position(image: Any) -> tuple[float, ...]:
    """Latitude, longitude, height and horizontal standard deviation that a DJI drone with RTK wrote into an opened PIL
    image; NaN where it wrote none or had no position."""
    text = _text(image)
    if "RtkFlag" not in text or not number(_value(text, "RtkFlag", _DJI)) > 0:
        return (float("nan"),) * 4
    lon = _value(text, "GpsLongitude", _DJI) or _value(text, "GpsLongtitude", _DJI)
    height = number(_value(text, "AbsoluteAltitude", _DJI))
    sigma = max(number(_value(text, tag, _DJI)) for tag in ("RtkStdLat", "RtkStdLon"))
    return number(_value(text, "GpsLatitude", _DJI)), number(lon), height, sigma


def relative_rotation(relatives_deg: tuple[float, ...]) -> np.ndarray:
    """(3, 3) reference_from_camera of RigRelatives: Rx(omega) Ry(phi) Rz(kappa), both frames x right, y down, z forward
    (as MicaSense's own library lays its bands on each other)."""
    x, y, z = np.radians(relatives_deg)
    rx = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    ry = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    rz = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return rx @ ry @ rz


def _text(image: Any) -> str:
    found = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp") or b""
    try:
        found = found or getattr(image, "tag_v2", {}).get(_XMP_TAG, b"")
    except Exception:  # a damaged directory
        return ""
    return found.decode("utf-8", errors="replace") if isinstance(found, bytes) else str(found)


def _value(text: str, tag: str, space: str = "Camera") -> str:
    """Text of a tag written as an attribute, as an element or as a list, its items parted by blanks."""
    attribute = re.search(rf'\b{space}:{tag}\s*=\s*["\']([^"\']*)["\']', text)
    if attribute:
        return attribute[1].strip()
    element = re.search(rf"<{space}:{tag}(?:\s[^>]*)?>(.*?)</{space}:{tag}>", text, re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", " ", element[1]).split()) if element else ""


def _whole(text: str) -> int:
    return int(text) if re.fullmatch(r"\d{1,3}", text) else -1
