"""What a calibration decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class BoardTuning(Section):
    """What a board can be, and when it counts as seen (`board.py`, `detect.py`)."""

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


class StartTuning(Section):
    """Start values (`start.py`)."""

    least_views: int = Field(3, ge=2)
    """Views of a camera: two of a plane fix a focal length and no more."""
    least_joint: int = Field(2, ge=1)
    """Instants at which two cameras see the board together, for one to be tied to the other: a single one may be wrong
    unnoticed."""


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


class JudgeTuning(Section):
    """How good it is (`judge.py`)."""

    undetermined: float = Field(0.01, gt=0)
    """Relative sigma of a focal length that is an error ..."""
    weak: float = Field(0.001, gt=0)
    """... and one that is advice: half the 0.05 % a calibration should reach would need it four times smaller."""
    few_views: int = Field(10, gt=0)
    """Views of a camera below which more are advised (OpenCV's tutorial: at least 10)."""
    tilt_deg: float = Field(20.0, gt=0)
    """Tilt of the board against the image that some views should have."""
    cells: int = Field(10, ge=3)
    """Cells along the longer side of the image, for the coverage and the mean residuals."""
    bad_view: float = Field(3.0, gt=1)
    """RMS of a view over the median of its camera's from which the image is named."""
    held_out_ratio: float = Field(1.5, gt=1)
    """Error of held-out instants over that of the adjusted ones from which it is told."""
    agree_sigmas: float = Field(3.0, gt=0)
    """Two calibrations differ by less, in sigmas of both: by chance more in one of 370."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    board: BoardTuning = Field(default_factory=BoardTuning)
    start: StartTuning = Field(default_factory=StartTuning)
    adjust: AdjustTuning = Field(default_factory=AdjustTuning)
    judge: JudgeTuning = Field(default_factory=JudgeTuning)
