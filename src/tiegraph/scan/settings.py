"""Settings of the scan stage."""

from dataclasses import dataclass, field
from math import isfinite
from typing import Annotated, Literal

from pydantic import Field, field_validator

from tiegraph.geometry.geodesy import utm_by_name
from tiegraph.scene.cells import number
from tiegraph.scene.gnss.fixes import HEIGHTS_M
from tiegraph.settings import Section
from tiegraph.text import composed

_Px = Annotated[int, Field(ge=0, le=100_000)]
_Height = Annotated[float, Field(ge=-12_000, le=100_000)]  # from the deepest sea to the edge of space


class ScanSettings(Section):
    """Reading of the folder of images: camera, frame and pass of each image, and its position."""

    layout: Literal["auto", "passes", "cameras", "sequence", "loose"] = "auto"
    """Meaning of the folders: passes = pass/camera/frame, cameras = camera/[pass/]frame, sequence = one camera and a
    folder a pass, loose = photographs without order; auto guesses and reports its guess."""

    frames: Literal["auto", "name", "number", "order"] = "auto"
    """Which images of a rig belong to one frame: equal file names, equal last numbers in the names, or equal places in
    the order of names; auto takes the first of these that fits."""

    camera_model: Literal[
        "auto", "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"
    ] = "auto"
    """COLMAP camera model of sensors without one in the rig file; auto = RADIAL for rigs and sequences, SIMPLE_RADIAL
    for loose photographs, OPENCV_FISHEYE for folders named fisheye. The final adjustment makes OPENCV of the radial
    ones."""

    crs: str = "auto"
    """Coordinate system of the products: EPSG:n (projected, metres), UTM10N, ENU (tangent plane), or auto = the UTM
    zone."""

    gnss_sigma_m: float = Field(default=5.0, gt=0, le=1000)
    """Standard deviation (m, horizontal) of positions whose file or EXIF gives none; twice that in height."""

    heights_m: tuple[_Height, _Height] = HEIGHTS_M
    """Lowest and highest plausible height (m) of positions and control points: others are in another unit. For an
    aircraft -500 12000, for a deep mine or a dive -11000 500."""

    max_gap_s: float = Field(default=3.0, gt=0, le=3600)
    """Longest gap (s) between two GNSS or trajectory rows across which a frame's position is interpolated."""

    video_fps: float = Field(default=2.0, gt=0, le=60)
    """Pictures taken of a second of video (in a folder with videos and no images): the sharpest of each stretch."""

    video_offset: tuple[str, ...] = ()
    """Times of videos. cam1=0.35: this video began 0.35 s after that of its rig's first camera (default: by the motion
    of their pictures), or, outside a rig, seconds to add to its times; -7200: seconds to add to those of all videos,
    or their start (since 1970) if they have none; end: their creation times are those of the end."""

    crop_px: tuple[_Px, _Px, _Px, _Px] = (0, 0, 0, 0)
    """Pixels cut off every image: left, top, right, bottom (a rig file may give this for each sensor)."""

    undistort: bool = False
    """Resample the images to a pinhole camera; needs calibrated cameras in the rig file."""

    fisheye: Literal["auto", "views", "whole"] = "auto"
    """Images of fisheye lenses: views = each is cut into five pinhole views with one centre, up to 90 degrees off its
    axis; whole = unchanged; auto = views of calibrated lenses that see more than 150 degrees across."""

    @field_validator("video_offset")
    @classmethod
    def _names_and_seconds(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        """Refuses words of another form, and repeated ones."""
        video_offsets(value)
        return value

    @field_validator("crs")
    @classmethod
    def _zone_as_code(cls, value: str) -> str:
        """A UTM zone by its name as EPSG code, as elsewhere; other words unchanged."""
        zones = utm_by_name(value)
        return zones[0] if len(zones) == 1 else value


@dataclass(frozen=True)
class VideoOffsets:
    """The parts of ``scan.video_offset``: seconds to add to the times of all videos, and by name; whether creation
    times are those of the end."""

    all_s: float = 0.0
    by_name: dict[str, float] = field(default_factory=dict)
    from_end: bool = False


def video_offsets(words: tuple[str, ...]) -> VideoOffsets:
    """``scan.video_offset`` read. Raises ValueError for words of another form."""
    found: dict[tuple[bool, str], float] = {}  # the key of "end" has no name
    for word in words:
        name, equals, text = word.rpartition("=")
        seconds = 0.0 if word == "end" else number(text)
        if (equals and not name) or not isfinite(seconds) or (word == "end", name) in found:
            form = "NAME=SECONDS (the video's name without ending), SECONDS or end"
            raise ValueError(f"{word!r}: give {form}, each once")
        found[word == "end", composed(name)] = seconds
    from_end = found.pop((True, ""), None) is not None
    all_s = found.pop((False, ""), 0.0)
    return VideoOffsets(all_s=all_s, by_name={name: s for (_, name), s in found.items()}, from_end=from_end)
