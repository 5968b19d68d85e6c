"""Constants of the rig check, each with its unit, meaning and origin."""

from pydantic import Field

from tiegraph.settings import Section


class CheckTuning(Section):
    """Mirrored and rolled rigs (`check.py`)."""

    frames: int = Field(16, ge=0)
    """Frames whose images are compared, at most (0: rigs are not tested) ..."""
    least_frames: int = Field(4, gt=0)
    """... and at least."""
    samples: int = Field(250, gt=0)
    """Approximate number of compared pairs of images."""
    min_votes: int = Field(6, gt=0)
    """Image pairs with enough matches that are needed."""
    agreement: float = Field(0.5, ge=-1, le=1)
    """Mean cosine between predicted and seen motion that counts as agreement."""
    margin: float = Field(0.5, ge=0)
    """Difference by which a hypothesis must exceed the nominal rig to replace it."""
    tie: float = Field(0.03, ge=0)
    """Difference up to which agreements count as equal."""


class OrderTuning(Section):
    """Cameras in another order (`check.py`)."""

    fit: float = Field(0.6, ge=-1, le=1)
    """Correlation between evidence and cosine of the axes that counts as an explanation."""
    better: float = Field(0.3, ge=0)
    """Difference by which a new order must correlate better than the nominal one, in all frames together ..."""
    alike: float = Field(0.02, ge=0)
    """Difference up to which correlations count as equal: turning or mirroring a ring changes no neighbours."""
    candidates: int = Field(60, gt=0)
    """Orders with the same neighbours that are compared by the sense of rotation."""


class SynchronisationTuning(Section):
    """Synchronisation of cameras (`synchronisation.py`)."""

    short: float = Field(0.6, ge=0)
    """Share of the usual number of frames: a pass that short may have ended early."""
    off: float = Field(0.04, ge=0)
    """Deviation of a shift, as a share of the image size, from which it is odd (5 degrees of a nominal rig: 0.04)."""
    few: int = Field(1, ge=0)
    """Camera pairs whose offsets are always tested: parallel axes have no wrong shift to show."""
    faint: float = Field(0.25, ge=0)
    """Evidence below this share of the other camera pairs' is odd."""
    least: float = Field(0.3, gt=0)
    """Evidence (`min_matches` above chance) that a pair of cameras must reach somewhere to vote."""
    gain: float = Field(1.25, ge=0)
    """Ratio of the evidence with a lag to that without ..."""


class CommonViewTuning(Section):
    """The overlap of two passes (`axes.py`)."""

    least_votes: float = Field(4.0, ge=0)
    """Effective number of nodes with a common view that is needed ..."""
    least_share: float = Field(0.02, ge=0, le=1)
    """... or their share of the previewed nodes: enough where passes are short."""
    yaw_sigmas: float = Field(4.0, ge=0)
    """Standard deviations above cameras paired at random, the best of 30 yaws."""
    direction_sigmas: float = Field(3.0, ge=0)
    """Standard deviations of a rank correlation."""
    whole: float = Field(0.9, ge=0, le=1)
    """Share of a pass above which the frames in common are not named."""
    rim: float = Field(0.05, ge=0, lt=1)
    """Share of the best row's evidence below which a frame is not counted."""


class RigTuning(Section):
    """The rig compared with the images."""

    check: CheckTuning = Field(default_factory=CheckTuning)
    """Mirrored and rolled rigs."""
    order: OrderTuning = Field(default_factory=OrderTuning)
    """Cameras in another order."""
    synchronisation: SynchronisationTuning = Field(default_factory=SynchronisationTuning)
    """Missing or late frames."""
    common_view: CommonViewTuning = Field(default_factory=CommonViewTuning)
    """Heading and direction of one pass relative to another."""
