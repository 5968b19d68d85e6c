"""Constants of filter, each with its unit, its meaning and the source of its value."""

from pydantic import Field

from tiegraph.settings import Section


class Tuning(Section):
    """Constants of the engine that are the same for every user: the coarse model as judge of pairs (`filter.py`)."""

    matches_a_pair: int = Field(150, gt=0)
    """Matches of a pair that are used, spread over all: enough for a decision."""
    max_refused: float = Field(0.2, ge=0, le=1)
    """Share of the judged pairs: a model that contradicts more of them is wrong itself."""
    max_refused_image: float = Field(0.5, ge=0, le=1)
    """Share of an image's judged pairs: a model that contradicts more of them has the image at a wrong place."""
