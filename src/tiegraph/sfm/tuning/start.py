"""What sfm/start decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class ScaleTuning(Section):
    """Whether a path is as long as its rig says (`pathscale.py`)."""

    matches_a_pair: int = Field(40, gt=0)
    """Matches of a pair of images that vote."""
    caps_rad: tuple[float, ...] = (0.002, 0.006)
    """Beyond, a match says nothing: two pixels of a survey camera; more, tried next, where poses are worse."""
    range: float = Field(64.0, gt=1)
    """Times too long or too short a path may be."""
    grid: int = Field(57, gt=2)
    """Scales tried over that range, evenly by their logarithm."""
    fine_grid: int = Field(21, gt=2)
    """Scales tried then about the best of them."""
    near: float = Field(1.25, gt=1)
    """So many times apart, two scales must differ in their votes for the scale to be known."""
    dip: float = Field(0.03, ge=0)
    """By which the votes must differ then, as a share (KITTI's baseline 0.30, PandaSet's rig 0.000)."""
    distances: int = Field(4000, gt=0)
    """Distances between two positions that are drawn to tell the scale by."""
    least_positions: int = Field(3, ge=2)
    """Positions of placed frames below which these tell no scale."""
    least_distances: int = Field(10, gt=0)
    """Distances beyond the noise below which positions tell no scale."""
    least_noise_m: float = Field(0.01, gt=0)
    """Of a distance between two positions, whatever their sigmas say."""
    sigmas: float = Field(4.0, gt=0)
    """Apart are two positions, or two places of the model, whose distance tells the scale."""
    clear: float = Field(1.1, ge=1)
    """A scale by positions that differs from the rig's by fewer times is not worth the change ..."""
    clear_sigmas: float = Field(3.0, ge=0)
    """... nor one within so many sigmas."""


class StagedTuning(Section):
    """The rounds of adjustment from rough poses to a model, and whether that is good enough (`stagedadjustment.py`).

    Measured on models that are right to some centimetres (canal, canal_demo, PandaSet, KITTI, Herz-Jesus-P25,
    oppaiyama, fountain-P11): 0.957 to 1.000 of the pairs agree, 0.97 to 1.00 of the tied images see points, 0.20 to
    0.69 px.
    """

    iterations: int = Field(25, gt=0)
    """Of a round's adjustment, at most."""
    tolerance: float = Field(1e-4, gt=0)
    """Of the cost; the next round starts from there with better points."""
    soft_l1_px: float = Field(1.0, gt=0)
    """Scale of the soft L1 loss: half the first points are off by more."""
    register_rounds: int = Field(3, ge=0)
    """Of placing the frames that had no pose."""
    min_agreeing: float = Field(0.9, ge=0, le=1)
    """Share of the verified pairs whose matches the model explains."""
    tied_pairs: int = Field(2, gt=0)
    """Verified pairs from which an image is tied."""
    min_seeing: float = Field(0.9, ge=0, le=1)
    """Share of the tied images that see points."""
    max_error_px: float = Field(2.0, gt=0)
    """Mean reprojection error; observations are cut at 4 px."""


class StartTuning(Section):
    """The start from poses that are roughly known."""

    min_share: float = Field(0.8, ge=0, le=1)
    """Of the images of one piece that must have a pose, to start from these."""
    max_lever_off: float = Field(0.5, ge=0)
    """Share of a given lever arm that the poses may show it off; more, and the start takes the given one."""
    told_change: float = Field(0.02, ge=0)
    """Of the length of a path: a smaller one is not told."""
    scale: ScaleTuning = Field(default_factory=ScaleTuning)
    """The length of the path against the rig."""
    staged: StagedTuning = Field(default_factory=StagedTuning)
    """Points and rounds of adjustment."""
