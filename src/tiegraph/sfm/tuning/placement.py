"""What sfm/placement decides by: each constant with its unit, its meaning and where its value comes from."""

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
    """Frames judged by the matches between them (`consistency.py`)."""

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
