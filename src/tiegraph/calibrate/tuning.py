"""What a calibration decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class BoardTuning(Section):
    """What a board can be, and when it counts as seen (`board.py`)."""

    least_corners: int = Field(8, ge=4)
    """Corners of a view: four hold a pose without telling anything of it."""
    refine_share: float = Field(0.8, gt=0, lt=1)
    """Half window of the refinement of a corner, in the distance from it to other edges of the print ..."""
    refine_px: tuple[int, int] = (2, 11)
    """... and its bounds."""
    trimmed: float = Field(0.3, gt=0, le=1)
    """Free about a corner of a checkerboard, in sides of a square: paper is trimmed, and windows that reach over its
    edge pulled corners off by up to 6 px (OpenCV's photographs); 0.4 still does where 0.4 of the outer squares are
    left, and full windows are no better than 0.019 px for 0.021 (rendered, `tests/calibrate`)."""


class AdjustTuning(Section):
    """The adjustment (`adjust.py`)."""

    stages_px: tuple[float, ...] = (50.0, 5.0)
    """Scales of the Cauchy loss of the first adjustments: undistorted start values are tens of pixels off."""
    least_scale_px: float = Field(0.02, gt=0)
    """Lower bound of that of the last ones, which is told by the residuals."""
    doubt_sigmas: float = Field(10.0, gt=0)
    """A view whose median residual is more, in sigmas of a corner, and ..."""
    doubt_px: float = Field(1.0, gt=0)
    """... more than this is left out: taken at another instant, or the board read wrongly."""
    most_doubted: float = Field(0.5, gt=0, le=1)
    """Share of a camera's views that must stay: else board, model or instants are wrong and not the views."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    board: BoardTuning = Field(default_factory=BoardTuning)
    adjust: AdjustTuning = Field(default_factory=AdjustTuning)
