"""Constants of filter, each with its unit, its meaning and the source of its value."""

from pydantic import Field

from tiegraph.settings import Section


class PriorTuning(Section):
    """Matches against the coarse model (`filter.py`)."""

    steps: int = Field(24, gt=1)
    """Distances between the nearest and the farthest at which a ray is followed."""
    margin: float = Field(2.0, ge=1)
    """Distances outside those of the image's model points by this factor are still possible."""
    tolerance_deg: float = Field(1.0, gt=0)
    """Largest deviation from the course: preview key points are good to 0.2 degrees, rotations of their model to 0.15
    (canal)."""
    min_share: float = Field(0.25, ge=0, le=1)
    """Share of a pair's matches that must agree with the model. On canal (chosen there) it keeps 99.1 % of the pairs
    most of whose matches are true and 4 of 217 of which hardly any is; on canal_demo 98.6 % and 0 of 4."""
    max_refused: float = Field(0.2, ge=0, le=1)
    """Share of the judged pairs: a model that contradicts more of them is wrong itself."""
    max_refused_image: float = Field(0.5, ge=0, le=1)
    """Share of an image's judged pairs: a model that contradicts more of them has the image at a wrong place."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    matches_a_pair: int = Field(150, gt=0)
    """Matches of a pair that are used, spread over all: enough for a decision."""
    prior: PriorTuning = Field(default_factory=PriorTuning)
    """The coarse model as judge."""
