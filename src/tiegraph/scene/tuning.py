"""Constants of the shared library, each with its unit, its meaning and the source of its value."""

from pydantic import Field

from tiegraph.settings import Section


class RegisteredTuning(Section):
    """Registered images of a model (`colmapmodel.py`)."""

    min_points: int = Field(10, gt=0)
    """Points with small residuals that an image must see: fewer may agree by chance."""
    agree_px: float = Field(4.0, gt=0)
    """Largest residual between a point's projection and its observation; COLMAP's own limit."""


class BlocksTuning(Section):
    """A large survey in blocks (`blocks.py`)."""

    whole: int = Field(600, gt=0)
    """Largest number of images that are mapped as a whole."""
    own: int = Field(420, gt=0)
    """Largest number of own images of a block."""
    unplaced: float = Field(2.5, ge=1)
    """Factor of the survey mapped as a whole, and of the blocks, if less than half of the frames
    have positions: cut by their matches alone, blocks of 420 of those images mixed distant places and were wrong by 4
    to 40 m, four times; mapped as a whole the first model had 1188 of them, to 15 mm. Larger ones were not tried."""
    least: int = Field(30, gt=0)
    """Least images of a block: a smaller one without ties to the rest is left out."""
    lent: int = Field(60, ge=0)
    """Images that a block takes from each of its neighbours."""


class JoiningTuning(Section):
    """Models of blocks put into one frame (`blocks.py`)."""

    shared: int = Field(12, ge=3)
    """Least images of two models for a join, which must agree with it."""


class Tuning(Section):
    """Constants of the shared library that are the same for every user."""

    registered: RegisteredTuning = Field(default_factory=RegisteredTuning)
    """Registered images."""
    blocks: BlocksTuning = Field(default_factory=BlocksTuning)
    """Blocks of a survey."""
    joining: JoiningTuning = Field(default_factory=JoiningTuning)
    """Blocks joined again."""
