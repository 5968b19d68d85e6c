"""What sfm/world decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.geometry.gravity import UpTuning
from tiegraph.scene.tuning import TrendTuning
from tiegraph.settings import Section


class FixTuning(Section):
    """Measured positions, for the mapper (`database.py`) and tied to the poses about their time (`fixes.py`)."""

    held_out_every: int = Field(5, ge=2)
    """ALGORITHMS: every fifth position is left out of the fit, to look at its residual."""
    least_to_hold_out: int = Field(10, gt=0)
    """Positions below which none is held out: a fit without a fifth of them says little."""
    rows_per_frame: int = Field(5, ge=0)
    """Of the receiver, that are used between two frames: more say the same once more. 0: positions at frames alone."""
    max_step: float = Field(3.0, ge=1)
    """Median steps of a pass: no interpolation across wider gaps between frames."""
    cubic_error: float = Field(0.03, ge=0)
    """Of the third difference: error of interpolation between frames. A cubic between evenly spaced frames errs by
    0.023 of the fourth, which a sharp turn makes as large as the third."""
    parabola_error: float = Field(0.06, ge=0)
    """Of the second difference: the same at the ends of a pass, where it is 0.06 of the third."""
    unknown_sigma_m: float = Field(10.0, gt=0)
    """Of a position whose source gives none (hand-held GPS)."""
    floor_m: float = Field(0.05, gt=0)
    """Of a stated sigma, while it is not known how large the errors are: below, poses and times err as much."""
    lasting: float = Field(0.7, ge=0)
    """Of a receiver's stated sigma: what outlasts a survey, which no residual tells (half of the variance: base
    station, atmosphere)."""
    levels_per_octave: float = Field(2.0, gt=0)
    """Of the stated sigma: fixes of one level share one factor of it."""


class NoiseTuning(Section):
    """How much worse positions are than their sigmas say (`positionerrors.py`)."""

    max_factor: float = Field(30.0, ge=1)
    """On a stated sigma."""
    min_rows: int = Field(6, gt=1)
    """Of a level, to say anything of its factor; of positions with times, to say anything of their correlation."""
    max_correlation: float = Field(0.9, ge=0, lt=1)
    """Of neighbours in time: what looks more correlated is believed to be so much."""
    slow_s: float = Field(60.0, gt=0)
    """How long slow errors of a receiver last (multipath), before the residuals speak (`positionerrors.py`)."""
    belief: float = Field(1.0, gt=0)
    """Sigma of the logarithms of the sizes of errors and of that time, before the residuals speak."""


class MarkTuning(Section):
    """Marked points in the model (`marks.py`)."""

    mark_sigma_px: float = Field(1.0, gt=0)
    """Of a mark set by hand."""
    pose_sigma_px: float = Field(0.2, ge=0)
    """What pose and lens of an image add to the sigma of a mark that was found by itself: as much as feature points
    are off in a good model."""
    min_angle_deg: float = Field(1.0, ge=0)
    """Between rays, to believe where they meet."""
    max_mark_px: float = Field(20.0, gt=0)
    """A mark this far from its point is a wrong click or a wrong image."""
    soft_px: float = Field(3.0, gt=0)
    """Scale of the robust loss (soft L1) by which rays meet; marks that are off by less were made in these images."""
    min_for_copy: int = Field(3, gt=0)
    """Points marked twice, to tell in which copies of the images the marks were made."""
    points_for_copy: int = Field(20, gt=0)
    """That many of the most often marked are asked."""
    min_to_refuse: int = Field(5, ge=4)
    """Control points, of which four tell which one is wrong."""
    free_for_copy: int = Field(10, gt=0)
    """Values less unknowns that count at most where copies are compared, for marks share the errors of a model: in the
    right one they are off by a third of what they are in any other."""
    much_better: float = Field(3.0, ge=1)
    """Times the others agree without it."""
    refused_of: int = Field(3, gt=0)
    """One in so many control points may be refused, and one in so many marks of a point unless the rest is beyond
    chance."""


class ScaleTuning(Section):
    """Metres per model unit by the rig's baselines (`scale.py`). ALGORITHMS section 4: with 6 cm at 15 m a 2 mm error
    of the baseline is 3.3 % of scale; never take scale from that."""

    baseline_sigma_m: float = Field(0.002, gt=0)
    """Of the distance of two cameras of a rig unless its file gives one."""
    angle_sigma_rad: float = Field(0.00017, gt=0)
    """0.01 deg: what is left of the extrinsic rotation; it acts like a parallax."""
    max_sigma: float = Field(0.015, gt=0)
    """Of the scale, to be trusted."""
    long_share: float = Field(0.7, ge=0, lt=1)
    """Of the longest baseline: those that are longer tell the scale."""
    depth_points: int = Field(20_000, gt=0)
    """Points whose distances are looked at, about."""


class FitTuning(Section):
    """The similarity from a model to the world (`fit.py`)."""

    inlier_sigmas: float = Field(3.0, gt=0)
    """Per axis: a position within is believed; scale of the Cauchy loss over its vector."""
    cauchy_scales: tuple[float, ...] = (4.0, 1.0)
    """The robust fit begins with a loss that is wider by this."""
    orientation_sigma_deg: float = Field(3.0, gt=0)
    """Orientations of a trajectory are not independent from frame to frame: together they weigh as much as
    `orientation_freedom` of this sigma."""
    orientation_freedom: int = Field(4, gt=0)
    """See `orientation_sigma_deg`."""
    antenna_sigma_m: float = Field(1.0, gt=0)
    """Weak prior of a lever arm that no file gives: boats and cars carry it not much farther."""
    offset_sigma_s: float = Field(1.0, gt=0)
    """Weak prior of the receiver's clock against the cameras'."""
    rounds: int = Field(6, gt=0)
    """Of reweighting, at most, for each scale of the loss and for the choice of the inliers."""
    converged: float = Field(1e-5, ge=0)
    """Radians, metres, log scale: a step that ends the rounds."""


class SourceTuning(Section):
    """What each source of a placement says by itself (`sources.py`, `weighing.py`)."""

    told_deg: float = Field(20.0, gt=0)
    """A turn known worse than that says nothing."""
    told_scale: float = Field(0.3, gt=0)
    """Sigma of a scale that is stated."""
    any_scale: float = Field(1.0, gt=0)
    """Sigma of a scale beyond which a source has no say in it."""
    common_deg: float = Field(1.5, ge=0)
    """What the orientations of a path have in common does not average out."""
    rounds: int = Field(2, gt=0)
    """In which the sigmas of a source follow the scatter about its own fit."""


class SimilarityFitTuning(Section):
    """Which evidence there is, and whether lever arm and clock can be told from it (`similarityfit.py`)."""

    min_positions: int = Field(3, ge=3)
    """Positions and control points, to place a model."""
    rounds: int = Field(2, gt=0)
    """Of placing: the second time with the true scale for frames known through another camera than the first."""
    noise_rounds: int = Field(3, ge=0)
    """In which sigmas follow the residuals."""
    roll_limit_deg: float = Field(10.0, gt=0)
    """Sigma of the roll about the track above which lone cameras' upright direction is used."""
    tilt_share: float = Field(0.5, gt=0)
    """Of the sigma of a ring's upright direction: above that sigma of the tilt it is used."""
    many_points: int = Field(8, gt=0)
    """Control points among which a wrong one does not hide."""
    at_frame: float = Field(0.9, ge=0, le=1)
    """Weight of one frame in a fix, to compare orientations."""
    looks_up_deg: float = Field(45.0, gt=0, lt=90)
    """By which cameras look up on average that look at a ceiling, or down from a flight that is turned over: those at a
    facade look up less."""


class StatementTuning(Section):
    """What a placement says of itself (`statements.py`, `georef.py`)."""

    scatter: float = Field(3.0, ge=1)
    """Times the stated sigma: what is beyond is no scatter but contradicts it."""
    scatter_told: float = Field(1.5, ge=1)
    """Times the stated sigma: less scatter is not worth a note."""
    agreeing: float = Field(0.7, ge=0, le=1)
    """Of the positions, below which they and the model contradict each other."""
    least_positions: int = Field(6, gt=0)
    """For that."""
    rig_tells: float = Field(0.5, gt=0)
    """Of the sigma that the positions leave of the scale: below it the rig's baselines are named as its source."""


class AdjustmentTuning(Section):
    """The bundle adjustment in the world, and whether it stands its check (`georeferencing.py`)."""

    rounds: int = Field(3, gt=0)
    """Of bending the model and fitting it anew, at most."""
    least_bend: float = Field(0.05, ge=0)
    """Of the sigma of the shape: what is bent by less stays as it is."""
    worse_pixels: float = Field(1.05, ge=1)
    """Times the reprojection error before: more, and the positions bend the model."""
    not_worse: float = Field(1.01, gt=0)
    """Times the held-out residual of the similarity, that the adjustment may have."""
    clip_sigmas: float = Field(5.0, gt=0)
    """An outlier among the held-out positions counts as that."""
    min_held: int = Field(3, gt=0)
    """Held-out positions below which their check says nothing."""


class WorldTuning(Section):
    """Constants of sfm/world."""

    fixes: FixTuning = Field(default_factory=FixTuning)
    """Measured positions."""
    noise: NoiseTuning = Field(default_factory=NoiseTuning)
    """Their sigmas."""
    up: UpTuning = Field(default_factory=UpTuning)
    """The upward direction."""
    marks: MarkTuning = Field(default_factory=MarkTuning)
    """Control points."""
    scale: ScaleTuning = Field(default_factory=ScaleTuning)
    """The scale by the rig."""
    fit: FitTuning = Field(default_factory=FitTuning)
    """The similarity."""
    sources: SourceTuning = Field(default_factory=SourceTuning)
    """The sources by themselves."""
    similarity_fit: SimilarityFitTuning = Field(default_factory=SimilarityFitTuning)
    """The placement."""
    trend: TrendTuning = Field(default_factory=TrendTuning)
    """Residuals that are no noise."""
    statements: StatementTuning = Field(default_factory=StatementTuning)
    """What is said of it."""
    adjustment: AdjustmentTuning = Field(default_factory=AdjustmentTuning)
    """The adjustment with the positions."""
