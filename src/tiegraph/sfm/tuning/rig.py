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
    """A camera against its rig, frame by frame, by its own sightings (`resections.py`), and one that
    lost its sightings in the adjustment (`diagnostics.py`)."""

    min_points: int = Field(12, gt=3)
    """Of the other cameras that an image sees, to be resected."""
    least_sigma_px: float = Field(0.1, gt=0)
    """Sigma of a coordinate at least, for the covariance of a resection."""
    min_frames: int = Field(5, gt=0)
    """Resected, to speak of a camera's scatter."""
    max_ratio: float = Field(3.0, gt=0)
    """Scatter over its expected sigma (ALGORITHMS section 4 d)."""
    min_scatter_px: float = Field(0.3, ge=0)
    """Less does no harm: points share their own errors, which the expected sigma leaves out."""
    chance: float = Field(0.05, gt=0, lt=1)
    """That a camera within these bounds is called loose for the few frames that happened to tell of it."""
    min_sightings: int = Field(200, gt=0)
    """Of a camera in all its images, to judge what an adjustment left of them."""
    min_kept: float = Field(0.6, ge=0, le=1)
    """Share of them that a camera keeps, and of the share that the best camera keeps."""
    torn_deg: float = Field(1.0, gt=0)
    """By which a camera with too few sightings left to be measured is let go."""


class TimeOffsetTuning(Section):
    """Whether the cameras of a rig fire at one instant (`diagnostics.py`)."""

    sigmas: float = Field(5.0, gt=0)
    """An offset this many sigmas from none is there."""
    min_effect: float = Field(2.0, ge=0)
    """Times the expected sigma of a place: what the offset must move a camera by at the highest speed."""


class TimeCalibrationTuning(Section):
    """A rig whose cameras do not fire at one instant (`timecalibration.py`)."""

    loose_deg: float = Field(0.05, gt=0)
    """From frame to frame, the turn of a camera whose extrinsics this model found: a mounting keeps."""
    loose_m: float = Field(0.003, gt=0)
    """The same of its place."""
    loose_s: float = Field(0.001, gt=0)
    """The same of its time: a trigger keeps."""
    expected_m: float = Field(0.001, gt=0)
    """Sigma of a constant error of calibrated extrinsics, place."""
    expected_deg: float = Field(0.002, gt=0)
    """And turn. What lens and shutter do that the camera model does not know (PandaSet: 0.1-0.4 deg) is the same in
    thousands of sightings and outvotes any honest sigma of a rotation: so the rotations are held, nearly, and only the
    time along the motion is free."""
    held_deg: float = Field(0.01, gt=0)
    """From frame to frame, the turn of a camera of a calibrated rig, held for the same reason."""
    nominal_m: float = Field(0.02, gt=0)
    """Sigma of a constant error of extrinsics that this model found, place."""
    nominal_deg: float = Field(1.0, gt=0)
    """And turn."""


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
    """Matches between two cameras of a rig against the model (`cameramatches.py`). Shares of disagreeing matches: of
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
    time_offset: TimeOffsetTuning = Field(default_factory=TimeOffsetTuning)
    """Times of the cameras."""
    time_calibration: TimeCalibrationTuning = Field(default_factory=TimeCalibrationTuning)
    """Rigs that are let go of."""
    system: SystemTuning = Field(default_factory=SystemTuning)
    """The linearised rig."""
    prior_test: PriorTestTuning = Field(default_factory=PriorTestTuning)
    """What is freed."""
    confront: ConfrontTuning = Field(default_factory=ConfrontTuning)
    """What is said."""
    camera_matches: CameraMatchesTuning = Field(default_factory=CameraMatchesTuning)
    """Ties between the cameras."""
