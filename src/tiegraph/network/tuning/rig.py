"""What the room rig decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class CheckTuning(Section):
    """Mirrored and rolled rigs (`check.py`)."""

    frames: int = Field(16, ge=0)
    """Frames whose images are compared, at most (0: rigs are believed as they are given) ..."""
    least_frames: int = Field(4, gt=0)
    """... and at least."""
    samples: int = Field(250, gt=0)
    """Pairs of images compared, about."""
    min_votes: int = Field(6, gt=0)
    """Image pairs with enough matches."""
    agreement: float = Field(0.5, ge=-1, le=1)
    """Mean cosine between predicted and seen motion that counts as agreement."""
    margin: float = Field(0.5, ge=0)
    """A hypothesis must beat the nominal rig by this much to replace it."""
    tie: float = Field(0.03, ge=0)
    """Agreements this close are the same."""


class OrderTuning(Section):
    """Cameras in another order (`check.py`)."""

    fit: float = Field(0.6, ge=-1, le=1)
    """Correlation between evidence and cosine of the axes that counts as an explanation."""
    better: float = Field(0.3, ge=0)
    """A new order must correlate better than the nominal one by this much, in all frames together ..."""
    alike: float = Field(0.02, ge=0)
    """Correlations this close are the same: turning or mirroring a ring changes no neighbours."""
    candidates: int = Field(60, gt=0)
    """Orders with the same neighbours that are told apart by the sense of rotation."""


class SynchronisationTuning(Section):
    """Whether cameras keep step (`synchronisation.py`)."""

    short: float = Field(0.6, ge=0)
    """Of the usual number of frames of the others: a pass that short may have ended early."""
    off: float = Field(0.04, ge=0)
    """Of the image size: a shift this far from the expected one is odd (5 degrees of a nominal rig: 0.04)."""
    few: int = Field(1, ge=0)
    """Camera pairs whose offsets are always looked at: parallel axes have no wrong shift to show."""
    faint: float = Field(0.25, ge=0)
    """Evidence below this share of the other camera pairs' is odd."""
    least: float = Field(0.3, gt=0)
    """Evidence (`min_matches` above chance) that a pair of cameras must reach somewhere to vote."""
    gain: float = Field(1.25, ge=0)
    """A lag must explain this much more evidence than none ..."""


class CommonViewTuning(Section):
    """What two passes have in common (`axes.py`)."""

    least_votes: float = Field(4.0, ge=0)
    """Effective number of nodes that speak for a common view ..."""
    least_share: float = Field(0.02, ge=0, le=1)
    """... or this share of the nodes looked at: enough where passes are short."""
    yaw_sigmas: float = Field(4.0, ge=0)
    """Standard deviations above cameras paired at random, the best of 30 yaws."""
    direction_sigmas: float = Field(3.0, ge=0)
    """Standard deviations of a rank correlation."""
    whole: float = Field(0.9, ge=0, le=1)
    """Share of a pass above which the frames in common are not named."""
    rim: float = Field(0.05, ge=0, lt=1)
    """Share of the best row's evidence below which a frame is not counted."""


class RigTuning(Section):
    """The rig against the images."""

    check: CheckTuning = Field(default_factory=CheckTuning)
    """Mirrored and rolled rigs."""
    order: OrderTuning = Field(default_factory=OrderTuning)
    """Cameras in another order."""
    synchronisation: SynchronisationTuning = Field(default_factory=SynchronisationTuning)
    """Frames that are lacking or late."""
    common_view: CommonViewTuning = Field(default_factory=CommonViewTuning)
    """Heading and direction of one pass against another."""
