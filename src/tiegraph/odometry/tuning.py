"""What the odometry decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class PoseTuning(Section):
    """The pose of a frame by points that are known (`worldmap.py`)."""

    first_px: float = Field(25.0, gt=0)
    """Points that are off by more from where the predicted pose sees them do not count in the first refinement."""
    inlier_px: float = Field(3.0, gt=0)
    """A point that is off by more is followed no further."""
    least_points: int = Field(15, ge=6)
    """With fewer points there is no pose: six unknowns, and RANSAC finds a few that agree in any heap."""


class MapTuning(Section):
    """Keyframes and points (`worldmap.py`)."""

    loss_px: float = Field(1.0, gt=0)
    """Scale of the Cauchy loss."""
    outlier_px: float = Field(2.5, gt=0)
    """An observation that is off by more after the adjustment is forgotten."""
    shared: float = Field(3.0, ge=1)
    """Errors over the sigmas that the observations say: what all corners of an image share, hundredths of a pixel by
    which following errs, is in no residual. Told by a rendered drive (`tests/odometry`), checked on five paths that
    it did not see (docs/odometry.md): turns over some way come out at 0.8 to 1.65 of the widened sigmas."""


class RecallTuning(Section):
    """Known places seen again (`recall.py`)."""

    patience: int = Field(3, ge=1)
    """Frames in a row without a pose after which a new segment is begun."""
    least_points: int = Field(25, ge=8)
    """Points that must agree with the pose for it to be the same place."""
    inlier_px: float = Field(4.0, gt=0)
    """Of the pose by matched points: corners are found again to a pixel or two."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    pose: PoseTuning = Field(default_factory=PoseTuning)
    map: MapTuning = Field(default_factory=MapTuning)
    recall: RecallTuning = Field(default_factory=RecallTuning)
