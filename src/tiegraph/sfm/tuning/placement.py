"""What sfm/placement and sfm/start decide by: each constant with its unit, its meaning and where its value is from."""

from pydantic import Field

from tiegraph.settings import Section


class AgreementTuning(Section):
    """Which verified matches a model explains (`verified.py`)."""

    tolerance_rad: float = Field(0.006, gt=0)
    """Between a ray and the other's epipolar line: about 2 px of a survey camera."""
    matches_a_pair: int = Field(100, gt=0)
    """Matches of one image pair that count: a wall full of windows is one opinion."""
    least_matches: int = Field(8, gt=0)
    """Matches below which a pair has no opinion, and points below which an image tells no reach."""
    reach_percent: tuple[float, float] = (2.0, 98.0)
    """Percentiles of the distances of the points an image sees: the nearest and the farthest."""
    reach: float = Field(3.0, ge=1)
    """Times the nearest and farthest points an image sees: matches must meet in between."""
    parallax: float = Field(3.0, ge=0)
    """Tolerances that the step between two images may be, seen from the farthest: parallel rays agree then."""


class ConsistencyTuning(Section):
    """Frames judged by the matches between them (`placement.py`)."""

    agrees: float = Field(0.5, ge=0, le=1)
    """Share of a pair's matches that the model explains, from which the pair agrees."""
    min_votes: float = Field(30.0, ge=0)
    """Matches that make an opinion of a frame."""
    loses: float = Field(1.5, ge=1)
    """Matches that contradict a place over those that agree. Of moved sections 1 to 1.5 find the same, 2 and 3 fewer;
    at 1 seven frames of a nuScenes drive were in doubt by 55 to 54."""


class TieTuning(Section):
    """The similarity between two models by the matches between their images (`ties.py`)."""

    least: int = Field(20, gt=0)
    """Matches that must agree with it."""
    independent: int = Field(2, gt=0)
    """Pairs of images without a common one that these must come from."""
    share: float = Field(0.15, ge=0, le=1)
    """Of the matches that must agree, known to the fit or held back: below, chance agreements are as many."""
    error: float = Field(0.1, gt=0)
    """Bound of the RANSAC, in median distances of the points from their cameras."""
    trials: int = Field(2000, ge=0)
    """Of the RANSAC; 0: matches join nothing."""
    most: int = Field(2000, gt=0)
    """Matches that a fit is made of: bounds its time, more say the same once more."""
    rounds: int = Field(3, gt=0)
    """Of fitting and asking again which matches agree."""


class PlacementTuning(Section):
    """The place of frames, tested, and of models among each other."""

    max_left_out: float = Field(0.2, ge=0, le=1)
    """Of the frames that may be left out for their place; more is a model that fell apart, and is said so."""
    agreement: AgreementTuning = Field(default_factory=AgreementTuning)
    """Matches that a model explains."""
    consistency: ConsistencyTuning = Field(default_factory=ConsistencyTuning)
    """What the ties of frames say of their place."""
    ties: TieTuning = Field(default_factory=TieTuning)
    """A model on another."""


class ScaleTuning(Section):
    """Whether a path is as long as its rig says (`start.py`)."""

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
    """The rounds of adjustment from rough poses to a model, and whether that is good enough (`run.py`).

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
