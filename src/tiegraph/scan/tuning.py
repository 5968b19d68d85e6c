"""Constants of scan, each with its unit, its meaning and the source of its value."""

from pydantic import Field

from tiegraph.settings import Section


class FoldersTuning(Section):
    """Whether images are a sequence (`folders.py`)."""

    few: int = Field(30, ge=0)
    """Images below which they are loose: matching everything with everything then costs less than a wrong order."""


class CameraTuning(Section):
    """Assumed values of a camera if nothing is known (`cameras.py`)."""

    guessed_focal: float = Field(1.2, gt=0)
    """Focal length in longer sides of the image: COLMAP's ImageReaderOptions.default_focal_length_factor, a guess of 45
    degrees of view. Focal lengths wrong by 0.8 to 2.5 keep the same pairs of previews (rendered images)."""
    guessed_fisheye_deg: float = Field(180.0, gt=0, le=360)
    """Assumed field of view across a fisheye image, if its circle does not show."""


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
