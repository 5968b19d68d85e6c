"""Constants of sfm/rig, each with its unit, meaning and origin."""

from pydantic import Field

from tiegraph.settings import Section


class LeverArmTuning(Section):
    """Prior of the places of cameras in a rig, from each other (`leverarmprior.py`)."""

    least_others: int = Field(4, ge=3)
    """Cameras needed for the prior: twelve coordinates for the four unknowns of the rule."""
    uneven: float = Field(1 / 3, gt=0)
    """Sigma of the distance along the axis, as a share of it: no housing is a sphere."""
    inexact: float = Field(0.1, gt=0)
    """Relative sigma of the distances in a drawing."""


class DeriveTuning(Section):
    """Extrinsics derived from a model made without the rig (`rig.py`)."""

    min_frames: int = Field(3, gt=0)
    """Frames that show a sensor with its reference; fewer give no scatter."""
    max_scatter_deg: float = Field(1.0, gt=0)
    """MAD of the relative rotation; above: not rigid, not synchronised, or a bent model."""
    max_outliers: float = Field(0.4, ge=0, le=1)
    """Share of frames farther than `outlier_deg` from the average."""
    outlier_deg: float = Field(5.0, gt=0)
    """Deviation from the average rotation beyond which a frame is not used for the place."""


class SupportTuning(Section):
    """Sensors with too few ties (`rig.py`)."""

    min_ties: int = Field(2, gt=0)
    """Verified pairs that an image needs to be supported."""
    min_share: float = Field(0.5, ge=0, le=1)
    """Share of a sensor's images that must be supported."""


class DiagnosticsTuning(Section):
    """A camera that moves in the rig, or lost its observations in the adjustment (`diagnostics.py`)."""

    min_scatter_px: float = Field(0.3, ge=0)
    """Movement in its images; a smaller one does no harm."""
    min_kept: float = Field(0.6, ge=0, le=1)
    """Share of its observations that a camera keeps, absolute and relative to that of the best camera."""
    contradicted: float = Field(0.2, ge=0, le=1)
    """Share of contradicting matches between two cameras, from which they contradict the model ..."""
    times: float = Field(3.0, ge=1)
    """... and its ratio to the share within the cameras: within cameras 0.7 to 12 %, between two up to 10 % where all
    is well (boat, canal_demo, KITTI, vehicle), 19 to 79 % where they fire at different times (sections of PandaSet,
    vehicle 0.5 m apart along the path)."""
    min_pairs: int = Field(4, gt=0)
    """Pairs of images with a verdict that are needed."""


class PriorTestTuning(Section):
    """Test of which given values of a rig the images contradict (`confront.py`). Lenses as shares of f."""

    given_m: float = Field(0.002, gt=0)
    """Sigma of the places of a calibrated rig unless its file gives one, and of a camera with its own time relative to
    its frame, where positions bend the path."""
    given_deg: float = Field(0.01, gt=0)
    """The same for the rotations."""
    freed_m: float = Field(0.5, gt=0)
    """Sigma of a place that is freed, or that in a soft rig only pairs of sensors hold."""
    freed_deg: float = Field(5.0, gt=0)
    """The same for a rotation."""
    freed_lens: float = Field(0.05, gt=0)
    """Sigma of the parameters of a lens that is freed."""
    unknown_share: float = Field(0.3, gt=0)
    """Sigma of an unknown firing time in frame intervals, where frames have no times (else `late_s`)."""
    strong: float = Field(10.0, ge=0)
    """BIC beyond which evidence is very strong (Kass and Raftery 1995)."""
    clear: float = Field(0.003, ge=0, le=1)
    """Share of the observations' sum of squares that a group must explain: lenses never follow their model exactly."""
    held_to_m: float = Field(0.005, gt=0)
    """Sigma of the places of a calibrated rig where it is said to contradict the images: what lenses have beyond their
    model rotates and shifts cameras of a rig by this much (KITTI, PandaSet)."""
    held_to_deg: float = Field(0.05, gt=0)
    """The same for the rotations."""
    held_to_lens: float = Field(0.002, gt=0)
    """The same for a focal length, as a share of it."""
    held_to_time: float = Field(0.05, gt=0)
    """The same for the times of a rig given as synchronised: ms, or % of the frame interval where frames have none."""


class RigTuning(Section):
    """Constants of sfm/rig."""

    late_s: float = Field(0.1, gt=0)
    """Prior sigma of the delay of a camera relative to the reference, if it is unknown."""
    late_wide: float = Field(16.0, ge=1)
    """Factor on the tolerance for observations while delays that move cameras by decimetres are estimated."""
    nominal_m: float = Field(0.02, gt=0)
    """Sigma of a place in a nominal rig, or in extrinsics derived from a model: these are tested for the times only."""
    nominal_deg: float = Field(1.0, gt=0)
    """The same for its rotation."""
    most_points: int = Field(30_000, gt=0)
    """Points in the normal equations of a rig or of a readout; of more, a random sample, and the sums are scaled up."""
    most_frames: int = Field(400, gt=0)
    """Frames in those of a rig; of a longer model, the section of this length with most observations."""
    tight_deg: float = Field(0.5, ge=0)
    """Extrinsics with a smaller sigma are fixed in the mapper; it may refine others."""
    derive: DeriveTuning = Field(default_factory=DeriveTuning)
    """Extrinsics derived from a model without rig."""
    support: SupportTuning = Field(default_factory=SupportTuning)
    """Sensors without ties, and the model's units."""
    diagnostics: DiagnosticsTuning = Field(default_factory=DiagnosticsTuning)
    """Rig diagnostics."""
    prior_test: PriorTestTuning = Field(default_factory=PriorTestTuning)
    """Test of given values."""
