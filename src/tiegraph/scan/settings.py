"""Settings of the scan stage."""

from math import isfinite
from typing import Annotated, Literal

from pydantic import Field, field_validator

from tiegraph.geometry.geodesy import utm_by_name
from tiegraph.settings import Section

_Px = Annotated[int, Field(ge=0, le=100_000)]


class ScanSettings(Section):
    """How the folder of images is read: which image belongs to which camera, frame and pass, and where it was taken."""

    layout: Literal["auto", "passes", "cameras", "sequence", "loose"] = "auto"
    """Meaning of the folders: passes = pass/camera/frame, cameras = camera/[pass/]frame, sequence = one camera and a
    folder a pass, loose = photographs without order; auto guesses and says what it guessed."""

    frames: Literal["auto", "name", "number", "order"] = "auto"
    """Which images of a rig belong to one frame: equal file names, equal last numbers in the names, or equal places in
    the order of names; auto takes the first of these that fits."""

    camera_model: Literal[
        "auto", "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"
    ] = "auto"
    """COLMAP camera model of sensors without one in the rig file; auto = RADIAL for rigs and sequences, SIMPLE_RADIAL
    for loose photographs, OPENCV_FISHEYE for folders named fisheye. RADIAL becomes OPENCV in the final adjustment."""

    crs: str = "auto"
    """Coordinate system of the products: EPSG:n (projected, metres), UTM10N, ENU (tangent plane), or auto = the UTM
    zone."""

    gnss_sigma_m: float = Field(default=5.0, gt=0, le=1000)
    """Standard deviation (m, horizontal) of positions whose file or EXIF gives none; twice that in height."""

    max_gap_s: float = Field(default=3.0, gt=0, le=3600)
    """Longest gap (s) between two GNSS or trajectory rows across which a frame's position is interpolated."""

    video_fps: float = Field(default=2.0, gt=0, le=60)
    """Pictures taken of a second of video (in a folder with videos and no images): the sharpest of each stretch."""

    video_clock: Literal["start", "end"] = "start"
    """Whether the creation time in a video's file is that of the start of the recording or that of its end."""

    video_clock_s: float = Field(default=0.0, ge=-4.2e9, le=4.2e9)
    """Seconds to add to the times of all videos, so that they are those of the GNSS file: 3600 for a clock that is
    an hour behind; for videos without a creation time when they began, in seconds since 1970."""

    video_offset: tuple[str, ...] = ()
    """When videos of a rig began, each in seconds after the one of its first camera, as cam1=0.35; default: found from
    the motion of their pictures. Of any other video: seconds to add to its times."""

    crop_px: tuple[_Px, _Px, _Px, _Px] = (0, 0, 0, 0)
    """Pixels cut off every image: left, top, right, bottom (a rig file may give this for each sensor)."""

    undistort: bool = False
    """Resample the images to a pinhole camera; needs calibrated cameras in the rig file."""

    @field_validator("video_offset")
    @classmethod
    def _names_and_seconds(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        """Refuses what is not a name, = and a number, and a name that stands there twice."""
        video_offsets(value)
        return value

    @field_validator("crs")
    @classmethod
    def _zone_as_code(cls, value: str) -> str:
        """A UTM zone by its name as the EPSG code that everything else reads; other words as they are."""
        zones = utm_by_name(value)
        return zones[0] if len(zones) == 1 else value


def video_offsets(words: tuple[str, ...]) -> dict[str, float]:
    """Seconds by name of ``scan.video_offset``. Raises ValueError for words of another form."""
    found: dict[str, float] = {}
    for word in words:
        name, _, number = word.rpartition("=")
        try:
            seconds = float(number)
        except ValueError:
            seconds = float("nan")
        if not name or not isfinite(seconds) or name in found:
            raise ValueError(f"{word!r}: give a video once, as its name without ending = seconds: cam1=0.35")
        found[name] = seconds
    return found
