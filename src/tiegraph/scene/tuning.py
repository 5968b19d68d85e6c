"""Constants of the shared library, each with its unit, its meaning and the source of its value.

``TrendTuning`` belongs to one engine alone, sfm, and is in its tuning.
"""

from pydantic import Field

from tiegraph.settings import Section


class TrendTuning(Section):
    """Tests of residuals along the path against noise (`evidence.py`)."""

    min_rows: int = Field(8, ge=6)
    """Least number of values for distinguishing a trend from noise."""
    step_rows: int = Field(3, gt=0)
    """Values on either side of a step, at least."""
    max_correlation: float = Field(0.98, ge=0, lt=1)
    """Of neighbouring values."""
    caution_sigmas: float = Field(2.0, ge=0)
    """Added to the correlation: short series look less correlated than they are."""
    spike_sigmas: float = Field(6.0, gt=0)
    """Robust sigmas from the neighbours: a single bad value is no trend."""


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
    near: int = Field(24, gt=0)
    """Nearest frames by prior positions whose links count. Of 1200 rendered images with repeated walls (canal
    generator, seed 5) 12, 24 and 48 give the same three sections of the path, also with noise of 5 m and with 30 % of
    the positions missing."""
    unplaced: float = Field(2.5, ge=1)
    """Factor of the survey mapped as a whole, and of the blocks, if less than half of the frames
    have positions: cut by their matches alone, blocks of 420 of those images mixed distant places and were wrong by 4
    to 40 m, four times; mapped as a whole the first model had 1188 of them, to 15 mm. Larger ones were not tried."""
    least: int = Field(30, gt=0)
    """Least images of a block: a smaller one without ties to the rest is left out."""
    lent: int = Field(60, ge=0)
    """Images that a block takes from each of its neighbours ..."""
    least_lent_frames: int = Field(4, ge=0)
    """... and the least frames of them."""
    least_ties: int = Field(10, gt=0)
    """Pairs of images that make two parts neighbours."""
    margin: float = Field(0.2, ge=0, le=1)
    """Share of a part: largest distance of a cut from the half, to be where ties are few."""
    order: float = Field(0.05, gt=0)
    """Share of the mean link: weight of the links by the order of a pass alone."""


class JoiningTuning(Section):
    """Models of blocks put into one frame (`blocks.py`)."""

    shared: int = Field(12, ge=3)
    """Least images of two models for a join, which must agree with it."""
    agree: float = Field(0.6, ge=0, le=1)
    """Share of the shared images that must agree."""
    turn_deg: float = Field(3.0, gt=0)
    """Tolerance of the poses of an image in two models."""
    shift: float = Field(0.06, gt=0)
    """Likewise, as a share of the distance to its points."""
    drift: float = Field(0.1, gt=0)
    """Share of the survey's extent: tolerance of a join along a chain of others."""


class Tuning(Section):
    """Constants of the shared library that are the same for every user."""

    registered: RegisteredTuning = Field(default_factory=RegisteredTuning)
    """Registered images."""
    blocks: BlocksTuning = Field(default_factory=BlocksTuning)
    """Blocks of a survey."""
    joining: JoiningTuning = Field(default_factory=JoiningTuning)
    """Blocks joined again."""
