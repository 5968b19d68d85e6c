"""Constants of filter, each with its unit, its meaning and the source of its value."""

from pydantic import Field

from tiegraph.settings import Section


class LoopTuning(Section):
    """Rotations of pairs, their average, and what contradicts it (`loops.py`)."""

    max_error_px: float = Field(4.0, gt=0)
    """Distance of a match from its epipolar line, pixels at the mean focal length, up to which it agrees."""
    max_deg: float = Field(3.0, gt=0)
    """Largest contradiction of a pair's rotation to that of all others; widened if loops close badly."""
    least_matches: int = Field(8, ge=5)
    """Least matches of a pair for a rotation."""
    trials: int = Field(500, gt=0)
    """Trials of the RANSAC, at most: five of a share of 0.4 are met by 1 in 98."""
    votes_a_pair: int = Field(100, gt=0)
    """Matches of one pair that count in a vote: a wall full of windows counts once."""
    directions: int = Field(200, gt=0)
    """Samples of a translation under a given rotation."""
    as_good: float = Field(0.65, ge=0, le=1)
    """Share of the matches that a pair's own rotation explains: if the predicted one explains as many, it is equal."""
    voters: int = Field(60, gt=0)
    """Ties between two clusters that are used, the heaviest."""
    rounds: int = Field(10, gt=0)
    """Rounds of the robust least squares, at most."""
    kernel_deg: float = Field(1.0, gt=0)
    """Geman-McClure kernel of the robust least squares."""
    noisy_deg: float = Field(10.0, gt=0)
    """A tolerance wider than this decides nothing."""
    neighbour_weight: float = Field(2.0, gt=0)
    """Weight of ties between neighbours of a pass, over their support."""
    neighbour_steps: int = Field(2, ge=0)
    """Steps of a pass within which two frames are neighbours; only these measure how well loops close."""


class PriorTuning(Section):
    """The coarse model as judge of pairs (`filter.py`)."""

    max_refused: float = Field(0.2, ge=0, le=1)
    """Share of the judged pairs: a model that contradicts more of them is wrong itself."""
    max_refused_image: float = Field(0.5, ge=0, le=1)
    """Share of an image's judged pairs: a model that contradicts more of them has the image at a wrong place."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    matches_a_pair: int = Field(150, gt=0)
    """Matches of a pair that are used, spread over all: enough for a decision."""
    loops: LoopTuning = Field(default_factory=LoopTuning)
    """Votes and loops."""
    prior: PriorTuning = Field(default_factory=PriorTuning)
    """The coarse model as judge."""
