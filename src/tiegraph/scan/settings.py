"""Settings of the scan stage."""

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

    crop_px: tuple[_Px, _Px, _Px, _Px] = (0, 0, 0, 0)
    """Pixels cut off every image: left, top, right, bottom (a rig file may give this for each sensor)."""

    undistort: bool = False
    """Resample the images to a pinhole camera; needs calibrated cameras in the rig file."""

    fisheye: Literal["auto", "views", "whole"] = "auto"
    """Images of fisheye lenses: views = each is cut into five pinhole views with one centre, up to 90 degrees off its
    axis; whole = as they are; auto = views of calibrated lenses that see more than 150 degrees across."""

    @field_validator("crs")
    @classmethod
    def _zone_as_code(cls, value: str) -> str:
        """A UTM zone by its name as the EPSG code that everything else reads; other words as they are."""
        zones = utm_by_name(value)
        return zones[0] if len(zones) == 1 else value
