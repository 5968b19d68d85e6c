"""Constants of sfm/world, each with its unit, meaning and origin."""

from pydantic import Field

from tiegraph.geometry.gravity import UpTuning
from tiegraph.settings import Section


class FixTuning(Section):
    """Measured positions, for the mapper and connected to the poses around their time (`fixes.py`)."""

    held_out_every: int = Field(5, ge=2)
    """ALGORITHMS: every fifth position is left out of the fit to examine its residual."""
    rows_per_frame: int = Field(5, ge=0)
    """Rows of the receiver used between two frames: more add no information. 0: positions at frames alone."""
    max_step: float = Field(3.0, ge=1)
    """Gap between frames, in median steps of the pass, beyond which positions are not interpolated."""
    unknown_sigma_m: float = Field(10.0, gt=0)
    """Sigma of a position whose source gives none (hand-held GPS)."""
    floor_m: float = Field(0.05, gt=0)
    """Smallest sigma used while the actual errors are unknown: poses and times have errors of this size."""
    lasting: float = Field(0.7, ge=0)
    """Part of a receiver's stated sigma that is constant during a survey, so that no residual shows it (half of the
    variance: base station, atmosphere)."""
    levels_per_octave: float = Field(2.0, gt=0)
    """Levels of the stated sigma: fixes of one level share one factor."""


class NoiseTuning(Section):
    """Ratio of the errors of positions to their stated sigmas (`positionerrors.py`)."""

    min_rows: int = Field(6, gt=1)
    """Positions of a level that are needed to estimate its factor, and to say that the others contradict the model;
    control points among which a wrong one cannot hide."""
    slow_s: float = Field(60.0, gt=0)
    """Prior correlation time of slow errors of a receiver (multipath) (`positionerrors.py`)."""
    belief: float = Field(1.0, gt=0)
    """Prior sigma of the logarithms of the sizes of errors and of that time."""


class MarkTuning(Section):
    """Marked points in the model (`marks.py`)."""

    mark_sigma_px: float = Field(1.0, gt=0)
    """Sigma of a mark set by hand."""
    pose_sigma_px: float = Field(0.2, ge=0)
    """Contribution of pose and lens of an image to the sigma of an automatically found mark: the error of feature
    points in a good model."""
    min_angle_deg: float = Field(1.0, ge=0)
    """Smallest angle between rays at which their intersection is used."""
    max_mark_px: float = Field(20.0, gt=0)
    """A mark at this distance from its point is a wrong click or in a wrong image."""
    min_to_refuse: int = Field(5, ge=4)
    """Control points that are needed to identify a wrong one by the other four."""
    free_for_copy: int = Field(10, gt=0)
    """Largest redundancy that counts where copies are compared, because marks share the errors of a model: in the
    correct copy their errors are a third of those in any other."""
    refused_of: int = Field(3, gt=0)
    """One of so many control points may be refused, and one of so many marks of a point unless the others are beyond
    chance."""


class ScaleTuning(Section):
    """Metres per model unit from the rig's baselines (`scale.py`). ALGORITHMS section 4: with 6 cm at 15 m a 2 mm
    error of the baseline is 3.3 % of scale; never take the scale from that."""

    baseline_sigma_m: float = Field(0.002, gt=0)
    """Sigma of the distance of two cameras of a rig unless its file gives one."""
    angle_sigma_rad: float = Field(0.00017, gt=0)
    """0.01 deg: remaining error of the extrinsic rotation; it acts like a parallax."""
    max_sigma: float = Field(0.015, gt=0)
    """Largest relative sigma of the scale at which it is used."""
    long_share: float = Field(0.7, ge=0, lt=1)
    """Share of the longest baseline; longer ones determine the scale."""


class FitTuning(Section):
    """The similarity from a model to the world (`fit.py`), and the adjustment that follows (`georeferencing.py`)."""

    cauchy_scales: tuple[float, ...] = (4.0, 1.0)
    """Factors on the scale of the loss, in order."""
    common_deg: float = Field(1.5, gt=0)
    """Error common to the orientations of a path, which does not average out: together they have this sigma, a single
    one twice as much."""
    antenna_sigma_m: float = Field(1.0, gt=0)
    """Weak prior of an unknown lever arm: boats and cars have the antenna not much farther away."""
    offset_sigma_s: float = Field(1.0, gt=0)
    """Weak prior of the receiver's clock offset."""
    least_bend: float = Field(0.05, ge=0)
    """Bend as a share of the sigma of the shape, below which the model stays as it is."""
    not_worse: float = Field(1.05, gt=0)
    """Largest ratio of the held-out residual of the adjustment to that of the similarity, and of the reprojection
    errors after and before: above it, the positions bend the model."""


class StatementTuning(Section):
    """Remarks on a georeference (`statements.py`, `georef.py`)."""

    scatter: float = Field(3.0, ge=1)
    """Factor on the stated sigma beyond which the scatter contradicts it; the rig's baselines are named as the source
    of the scale if the sigma by everything else is larger than theirs by it."""
    told: float = Field(0.3, gt=0)
    """Largest sigma of a rotation, in radians, or of a scale of a source alone that is stated."""
    agreeing: float = Field(0.7, ge=0, le=1)
    """Share of the positions that agree with the model, below which they contradict each other."""


class WorldTuning(Section):
    """Constants of sfm/world."""

    fixes: FixTuning = Field(default_factory=FixTuning)
    noise: NoiseTuning = Field(default_factory=NoiseTuning)
    up: UpTuning = Field(default_factory=UpTuning)
    marks: MarkTuning = Field(default_factory=MarkTuning)
    scale: ScaleTuning = Field(default_factory=ScaleTuning)
    fit: FitTuning = Field(default_factory=FitTuning)
    statements: StatementTuning = Field(default_factory=StatementTuning)
