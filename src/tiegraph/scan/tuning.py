"""Constants of scan, each with its unit, its meaning and the source of its value."""

from pydantic import Field

from tiegraph.settings import Section


class FoldersTuning(Section):
    """Camera and pass folders, and whether images are a sequence (`folders.py`)."""

    few: int = Field(30, ge=0)
    """Images below which they are loose: matching everything with everything then costs less than a wrong order."""
    one_depth: float = Field(0.75, ge=0, le=1)
    """Share of images at one depth of folders above which the others are strays."""
    apart_m: float = Field(30.0, gt=0)
    """Median distance between images of one name in several folders above which these are no cameras of a rig.
    Positions in EXIF are some metres off."""
    apart_s: float = Field(2.0, gt=0)
    """Median scatter of the time between them: EXIF has whole seconds, and different clocks differ by a constant."""
    regular: float = Field(0.9, ge=0, le=1)
    """Share of equal steps in the numbers, or in the times, of a sequence."""
    play: float = Field(0.25, ge=0)
    """Times are in equal steps if they differ by no more than this share of the median step ..."""
    play_s: float = Field(1.0, ge=0)
    """... or by this: EXIF often has whole seconds only."""


class CameraTuning(Section):
    """Assumed values of a camera if nothing is known (`cameras.py`)."""

    guessed_focal: float = Field(1.2, gt=0)
    """Focal length in longer sides of the image: COLMAP's ImageReaderOptions.default_focal_length_factor, a guess of 45
    degrees of view."""
    guessed_fisheye_deg: float = Field(180.0, gt=0, le=360)
    """Assumed field of view across a fisheye image, if its circle does not show ..."""
    guessed_circle_deg: float = Field(200.0, gt=0, lt=360)
    """... and across the circle, if it does: lenses of 360 cameras have 195 to 200."""
    start_focal: float = Field(0.01, gt=0)
    """Relative sigma of the focal length of a start model's camera, and of a factory's: it is adjusted. Three of
    Insta360's models of one camera agree to 0.4 %."""


class RigTuning(Section):
    """Limits of a rig (`rigfaults.py`), and its cameras."""

    max_rig_m: float = Field(100.0, gt=0)
    """Largest distance between two cameras, or a camera and the antenna, of one rig; above it units are wrong."""
    camera: CameraTuning = Field(default_factory=CameraTuning)
    """Number of its cameras."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    folders: FoldersTuning = Field(default_factory=FoldersTuning)
    """Folders and order."""
    rig: RigTuning = Field(default_factory=RigTuning)
    """Rigs and their cameras."""
