"""What sfm/rig decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class LeverArmTuning(Section):
    """What the cameras of a rig let expect of each other's places (`leverarmprior.py`)."""

    least_others: int = Field(4, ge=3)
    """Cameras whose places tell something: twelve coordinates for the four unknowns of the rule."""
    uneven: float = Field(1 / 3, gt=0)
    """Sigma of the distance along the axis, of that distance: no housing is a sphere."""
    inexact: float = Field(0.1, gt=0)
    """Sigma of the distances in a drawing, of these."""
    cauchy_sigmas: float = Field(2.0, gt=0)
    """Scale of the robust weight, by which a camera that stands apart counts little."""


class RigPriorTuning(Section):
    """What a rig file gives with a sigma (`rigpriors.py`)."""

    least_deg: float = Field(0.001, gt=0)
    """A sigma of 0 means "exactly": as hard as the solver bears."""
    least_m: float = Field(0.0001, gt=0)
    """The same of places and lengths."""
    free_deg: float = Field(30.0, gt=0)
    """Sigma of the turn of a sensor without sigmas of its own in a soft rig: pairs hold it."""
    free_m: float = Field(1.0, gt=0)
    """The same of its place."""


class DeriveTuning(Section):
    """Extrinsics from a model made without the rig (`rig.py`)."""

    min_frames: int = Field(3, gt=0)
    """Frames that show a sensor with its reference; fewer tell nothing of their scatter."""
    max_scatter_deg: float = Field(1.0, gt=0)
    """MAD of the relative rotation; above: not rigid, not synchronised, or a bent model."""
    max_outliers: float = Field(0.4, ge=0, le=1)
    """Share of frames farther than `outlier_deg` from the average."""
    outlier_deg: float = Field(5.0, gt=0)
    """Off the average rotation: such a frame has no say in the place."""


class SupportTuning(Section):
    """Sensors with too few ties, and the model's units by what is given (`support.py`), where positions tell as much as
    `sfm.start.scale` asks of them."""

    min_ties: int = Field(2, gt=0)
    """Verified pairs of an image that count as support."""
    min_share: float = Field(0.5, ge=0, le=1)
    """Of a sensor's images, that must have them."""
    position_sigmas: float = Field(10.0, gt=0)
    """So many of their sigmas apart are two positions whose distance tells the scale."""
    pairs: int = Field(2000, gt=0)
    """Of positions that are compared, drawn at random."""


class DiagnosticsTuning(Section):
    """A camera that strays from its place in the rig, or lost its sightings in the adjustment (`diagnostics.py`)."""

    min_scatter_px: float = Field(0.3, ge=0)
    """In its images; less does no harm."""
    min_sightings: int = Field(200, gt=0)
    """Of a camera in all its images, to judge what an adjustment left of them."""
    min_kept: float = Field(0.6, ge=0, le=1)
    """Share of them that a camera keeps, and of the share that the best camera keeps."""


class SystemTuning(Section):
    """The normal equations of a rig's unknowns (`linear.py`)."""

    most_points: int = Field(30_000, gt=0)
    """A random part of more, and the sums are scaled up."""
    most_frames: int = Field(400, gt=0)
    """Of a longer model its best seen stretch of so many speaks for all."""
    least_frames: int = Field(5, gt=0)
    """Of the rig, below which too little tells."""


class PriorTestTuning(Section):
    """Which of a rig's givens the images contradict (`priortest.py`). Lenses in parts of f."""

    given_m: float = Field(0.002, gt=0)
    """Sigma of the places of a calibrated rig unless its file gives one."""
    given_deg: float = Field(0.01, gt=0)
    """And of the turns."""
    freed_m: float = Field(0.5, gt=0)
    """Sigma of a place that is freed."""
    freed_deg: float = Field(5.0, gt=0)
    """Of a turn that is freed."""
    freed_lens: float = Field(0.05, gt=0)
    """Of the parameters of a lens that is freed."""
    unknown_share: float = Field(0.3, gt=0)
    """Sigma of a time nobody speaks of in frame intervals, where frames have no times (else `late_s`)."""
    strong: float = Field(10.0, ge=0)
    """BIC beyond which evidence is very strong (Kass and Raftery 1995)."""
    clear: float = Field(0.003, ge=0, le=1)
    """Of the observations' sum of squares, that a group must explain: lenses are never quite as their model."""


class ConfrontTuning(Section):
    """What is said of a rig as given against the images (`confront.py`). Sigmas that a calibration is held to before
    it is said to contradict the images: lenses are never quite as their model, and what they have left of distortion
    turns and shifts cameras of a rig by so much (KITTI, PandaSet)."""

    held_to_m: float = Field(0.005, gt=0)
    """Of a place."""
    held_to_deg: float = Field(0.05, gt=0)
    """Of a turn."""
    held_to_lens: float = Field(0.002, gt=0)
    """Of a focal length, in parts of it."""
    held_to_time: float = Field(0.05, gt=0)
    """Of the times of a rig said to be synchronised: ms, or % of the frame interval where frames have no times."""
    loosely_m: float = Field(0.05, gt=0)
    """Of the place in extrinsics that a model found: all that is asked of these is the time."""
    loosely_deg: float = Field(3.0, gt=0)
    """Of the turn in such extrinsics."""


class CameraMatchesTuning(Section):
    """Matches between two cameras of a rig against the model (`diagnostics.py`). Shares of disagreeing matches: of
    cameras with themselves 0.7 to 12 %, between two up to 10 % where all is well (boat, canal_demo, KITTI, vehicle),
    19 to 79 % where they fire apart (pieces of PandaSet, vehicle 0.5 m apart along the way)."""

    contradicted: float = Field(0.2, ge=0, le=1)
    """Share of disagreeing matches between two cameras that contradicts the model ..."""
    times: float = Field(3.0, ge=1)
    """... and so many times that of their own."""
    min_pairs: int = Field(4, gt=0)
    """Of images with an opinion."""


class RigTuning(Section):
    """Constants of sfm/rig."""

    late_s: float = Field(0.1, gt=0)
    """Sigma of when a camera fires after the reference, before the images speak and where nobody says."""
    late_sigmas: float = Field(5.0, gt=0)
    """A time this many sigmas from none is there."""
    late_wide: float = Field(16.0, ge=1)
    """Times the error that an observation may have while times are found that move cameras by decimetres."""
    late_rounds: int = Field(10, gt=0)
    """Of an adjustment and a step of the times, until a step is below its sigma."""
    held_deg: float = Field(0.01, gt=0)
    """Of a camera of its own time against its frame, where positions bend the way: the turn."""
    held_m: float = Field(0.003, gt=0)
    """And the place."""
    nominal_m: float = Field(0.02, gt=0)
    """Sigma of a place in a drawn rig that the images did not tell."""
    nominal_deg: float = Field(1.0, gt=0)
    """And of its turn."""
    tight_deg: float = Field(0.5, ge=0)
    """Extrinsics known better than this lead the mapper as they are; worse ones it may refine."""
    priors: RigPriorTuning = Field(default_factory=RigPriorTuning)
    """What a file gives with a sigma."""
    derive: DeriveTuning = Field(default_factory=DeriveTuning)
    """Extrinsics from a model without rig."""
    support: SupportTuning = Field(default_factory=SupportTuning)
    """Sensors without ties, and the model's units."""
    diagnostics: DiagnosticsTuning = Field(default_factory=DiagnosticsTuning)
    """Rig diagnostics."""
    system: SystemTuning = Field(default_factory=SystemTuning)
    """The linearised rig."""
    prior_test: PriorTestTuning = Field(default_factory=PriorTestTuning)
    """What is freed."""
    confront: ConfrontTuning = Field(default_factory=ConfrontTuning)
    """What is said."""
    camera_matches: CameraMatchesTuning = Field(default_factory=CameraMatchesTuning)
    """Ties between the cameras."""
