"""Settings of a calibration by a board."""

from typing import Literal

from pydantic import Field

from tiegraph.settings import Section


class CalibrateSettings(Section):
    """How the images of a board are read, and what the cameras are taken for."""

    model: tuple[str, ...] = ("OPENCV",)
    """COLMAP's camera model, such as SIMPLE_RADIAL, OPENCV, FULL_OPENCV or OPENCV_FISHEYE; of one camera:
    cam3=OPENCV_FISHEYE."""
    layout: Literal["auto", "passes", "cameras", "sequence"] = "auto"
    """Meaning of the folders: cameras = camera/[pass/]image, passes = pass/camera/image, sequence = one camera; auto
    guesses and says what it guessed."""
    frames: Literal["auto", "name", "number", "order"] = "auto"
    """Which images were taken at one instant: equal file names, equal last numbers in the names, or equal places in the
    order of names, which is never guessed."""
    wide: tuple[str, ...] = ()
    """Cameras that get role = "wide" in the rig file: in a survey they alone carry structure from motion."""
    board_sigma: float = Field(0.0, ge=0, le=0.1)
    """How far a corner of the board may be from its place on a flat one, metres (0 = flat): its bend is estimated."""
