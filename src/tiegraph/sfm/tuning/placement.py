"""Constants of sfm/placement and sfm/start, each with its unit, meaning and origin."""

from pydantic import Field

from tiegraph.settings import Section


class AgreementTuning(Section):
    """Which verified matches a model explains (`verified.py`)."""

    tolerance_rad: float = Field(0.006, gt=0)
    """Angle between a ray and the other image's epipolar line: about 2 px of a survey camera."""
    matches_a_pair: int = Field(100, gt=0)
    """Matches of one image pair that count: a wall full of windows is one vote."""
    least_matches: int = Field(8, gt=0)
    """Matches below which a pair has no verdict, and points below which the reach of an image is unknown."""
    reach_percent: tuple[float, float] = (2.0, 98.0)
    """Percentiles of the distances of the points an image sees: the nearest and the farthest."""
    reach: float = Field(3.0, ge=1)
    """Factor on the nearest and farthest distance of an image's points: matches must intersect in between. Parallel
    rays agree if the base, seen from the farthest point, is at most so many tolerances."""


class ConsistencyTuning(Section):
    """Judging frames by the matches between them (`placement.py`)."""

    agrees: float = Field(0.5, ge=0, le=1)
    """Share of a pair's matches that the model explains, from which the pair agrees."""
    min_votes: float = Field(30.0, ge=0)
    """Matches that are needed for a verdict on a frame, and that must agree with a similarity between two models."""
    loses: float = Field(1.5, ge=1)
    """Ratio of contradicting to agreeing matches. On displaced sections 1 to 1.5 find the same, 2 and 3 fewer; at 1
    seven frames of a nuScenes drive were in doubt by 55 to 54."""
    near_steps: int = Field(2, gt=0)
    """Frames of a pass: images this close to each other show whether a model is torn between them."""
    explains: float = Field(0.75, ge=0, le=1)
    """Share of the verified matches that a right model explains: of 90 surveys the right ones 0.77 (a canal in fog) to
    1.0, most above 0.9; the wrong ones 0.65 and 0.67 (canals without their rig) and 0.74 (a torn photograph set).
    Between frames that follow each other a model is torn if it contradicts as large a share: right models of five
    sets explain 0.8 and more there, 0.44 at the longest step of a diving robot; 0 to 0.15 where a wall that repeats
    put one half of a canal elsewhere (three models)."""


class TieTuning(Section):
    """The similarity between two models from the matches between their images (`ties.py`)."""

    independent: int = Field(2, gt=0)
    """Pairs of images without a common image from which these must come."""
    share: float = Field(0.15, ge=0, le=1)
    """Share of the matches that must agree, in the fitted and the held-out ones: below it, chance agreement is as
    frequent."""
    error: float = Field(0.1, gt=0)
    """Tolerance of the RANSAC, in median distances of the points from their cameras."""
    trials: int = Field(2000, ge=0)
    """Trials of the RANSAC; 0: models are never joined by matches."""
    most: int = Field(2000, gt=0)
    """Matches used for a fit: more add time, not information."""
    proposals: int = Field(50, ge=0)
    """Pairs of images that each propose a similarity. Of a canal whose wall repeats (`benchmarks/sfm/README.md`) 10
    miss the true place, 20, 50 and 100 find it."""
    fits: int = Field(3, gt=0)
    """Similarities with different agreeing ties that are refined."""
    rounds: int = Field(3, gt=0)
    """Rounds of fitting and selecting the matches that agree."""


class PlacementTuning(Section):
    """Test of the places of frames, and of models relative to each other."""

    max_left_out: float = Field(0.2, ge=0, le=1)
    """Share of the frames that may be left out for their place; if more are in doubt, the model fell apart, and a
    note says so."""
    agreement: AgreementTuning = Field(default_factory=AgreementTuning)
    """Matches that a model explains."""
    consistency: ConsistencyTuning = Field(default_factory=ConsistencyTuning)
    """Evidence of ties for and against places."""
    ties: TieTuning = Field(default_factory=TieTuning)
    """The similarity between two models."""


class ScaleTuning(Section):
    """Length of a path compared with its rig (`start.py`)."""

    range: float = Field(64.0, gt=1)
    """Factor by which a path may be too long or too short."""
    near: float = Field(1.25, gt=1)
    """Ratio of two scales whose votes must differ for the scale to be determined; a path that is longer or shorter by
    more is mapped again."""
    dip: float = Field(0.03, ge=0)
    """Relative difference of the votes that is needed then (KITTI's baseline 0.30, PandaSet's rig 0.000)."""
    least_distances: int = Field(10, gt=0)
    """Distances above the noise that are needed to determine the scale."""
    least_noise_m: float = Field(0.01, gt=0)
    """Of a distance between two positions, whatever their sigmas say."""


class StartTuning(Section):
    """The start from approximate poses."""

    register_rounds: int = Field(3, ge=0)
    """Rounds of placing the frames without a pose."""
    least_share: float = Field(0.9, ge=0, le=1)
    """Share of the verified pairs whose matches an accepted model explains, and of the tied images that see points:
    0.957 and 0.97 to 1.00 in models that are correct to some centimetres (canal, canal_demo, PandaSet, KITTI,
    Herz-Jesus-P25, oppaiyama, fountain-P11)."""
    max_lever_off: float = Field(0.5, ge=0)
    """Relative deviation of the poses from a given lever arm; beyond it the start takes the given one."""
    scale: ScaleTuning = Field(default_factory=ScaleTuning)
    """The length of the path against the rig."""
