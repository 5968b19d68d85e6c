"""What sparse and georef decide by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section
from tiegraph.sfm.tuning.placement import PlacementTuning, StartTuning
from tiegraph.sfm.tuning.rig import LeverArmTuning, RigTuning
from tiegraph.sfm.tuning.world import WorldTuning


class MappingTuning(Section):
    """Which mapper makes the model, and how (`mapping.py`, `run.py`)."""

    global_from_images: int = Field(60, ge=0)
    """Images from which a survey without a rig is mapped globally: below some tens of images the incremental mapper is
    as fast (PYCOLMAP 4)."""
    clearly_fewer: float = Field(0.8, ge=0, le=1)
    """Of the images tied to each other: fewer placed ask for another try, and for a word on why."""
    roughly_fewer: float = Field(0.5, ge=0, le=1)
    """Likewise in a rough model, where more images see few of its fewer points."""
    other_length: float = Field(1.25, gt=1)
    """Times too long or too short for its rig a path is mapped again."""
    other_focal: float = Field(1.4, gt=1)
    """Times longer or shorter than the given focal length that ask for the other mapper (`mapping.py`). Data sheets
    and EXIF are good to some percent; what ran off was 2.1 times too long (a hand-held kitchen)."""
    second_survey: int = Field(10, gt=0)
    """Images without any tie to the model that are mapped by themselves."""
    turned_share: float = Field(0.9, gt=0, le=1)
    """Of pairs that turns alone explain, where there is no base to make a model of (`turning.py`). Views of one
    panorama 0.99; thirty real surveys 0 to 0.06, a drone over the sea 0.33."""
    turned_off: float = Field(0.002, gt=0)
    """What a turn may leave of such a pair, in parts of the longer side: 0.0003 in those views, 0.003 to 0.06 in the
    surveys."""
    min_model_images: int = Field(3, ge=2)
    """Of a mapper's model."""
    rough_tracks: int = Field(100, gt=0)
    """Tracks that every image takes part in at least, longest first, in a rough model. Simulated block of 372 previews:
    15 instead of 69 CPU s, centres good to 0.15 instead of 0.01 m, rotations to 0.05 instead of 0.03 deg (medians)."""


class LensTuning(Section):
    """What lenses look like before the images speak: sigmas of their priors (`lens.py`)."""

    aspect: float = Field(0.002, gt=0)
    """Of fx / fy - 1: pixels are square."""
    decentring: float = Field(0.0005, gt=0)
    """Of p1, p2: lenses are centred to some hundredths of a millimetre."""
    loose_focal: float = Field(0.2, gt=0)
    """Of a focal length that no calibration gives, in parts of it."""
    loose_centre: float = Field(0.1, gt=0)
    """Of its principal point, in parts of the focal length."""
    loose_radial: float = Field(0.5, gt=0)
    """Of its k1, k2."""
    given_focal: float = Field(0.001, gt=0)
    """Of a calibration that the images contradict: the focal length, in parts of it."""
    given_centre: float = Field(0.0015, gt=0)
    """Of its principal point, in parts of the focal length."""
    given_aspect: float = Field(0.0005, gt=0)
    """Of its fx / fy."""
    given_radial: float = Field(0.1, gt=0)
    """Of its k1, k2: its distortion is not believed at all (PandaSet gives none)."""
    weak_pixels: float = Field(0.2, gt=0)
    """Of focal length and principal point of models that are not OPENCV, in parts of the focal length: the adjustment
    expects nothing of them, their sigmas need a little."""
    weak_distortion: float = Field(0.5, gt=0)
    """Of the distortion of such models, likewise."""


class FewPointsTuning(Section):
    """The points of the adjustments that bring a model near (`fewpoints.py`).

    `sparse` with them, trajectory error and CPU time against all points: 1200 rendered images 3.6 -> 3.6 mm, 615 -> 374
    s; canal 3.8 -> 3.3 mm, 159 -> 99 s; PandaSet 26 -> 31 mm, 159 -> 128 s (the times of its cameras differ by 1 ms);
    before that canal_demo 9.2 -> 8.9 mm, 19 -> 16 s and Herz-Jesus-P25 6.4 -> 6.5 mm, 13 -> 12 s.
    """

    cells: int = Field(8, gt=0)
    """Of an image, each way: points are taken in each."""
    in_a_cell: int = Field(3, gt=0)
    """The longest tracks of a cell that are taken."""
    worth: float = Field(0.5, ge=0, le=1)
    """Of the observations: if more would stay, all do (0: always)."""


class AdjustTuning(Section):
    """The final adjustment (`adjust.py`) and what all adjustments share.

    A principal point 6 px off in a 232 px lens turns its camera by 1.5 degrees against the rig and bends the model: on
    canal_demo (nominal rig, guessed intrinsics) the final adjustment brings the trajectory error from 0.06-0.09 m to
    0.01-0.03 m.
    """

    robust_px: float = Field(0.5, gt=0)
    """Cauchy scale: about the sigma of a SIFT key point. Reprojection errors are not divided by their sigma, so what is
    known beside the images is multiplied by it."""
    min_points: int = Field(10, gt=0)
    """Model points that an image sees: with fewer it has its pose from the rig alone."""
    min_images: int = Field(10, gt=0)
    """Of a camera, to adjust its intrinsics once more with the principal point."""
    filter_px: float = Field(2.0, gt=0)
    """Observations worse than this after the first pass go."""
    filter_angle_deg: float = Field(1.0, ge=0)
    """Points go whose rays all meet at a smaller angle."""
    iterations: int = Field(30, ge=0)
    """Of a solution with few points, at most: a valley such as that of focal length and height over flat ground takes
    its time. 0: the model stays as its mapper leaves it, neither adjusted nor checked."""
    last_iterations: int = Field(10, gt=0)
    """Of the last solutions, with all points."""
    robust_rounds: int = Field(2, ge=0)
    """The last with all points. The first plain solution is bent by what is filtered after it, and what the robust one
    shows to be wrong pulls on it still: once more without that, canal_demo is 4.7 mm off for 6.5 and canal 6.8 for
    12.4, in the same time."""
    tolerance: float = Field(1e-6, gt=0)
    """Of the cost: canal_demo's trajectory is the same to 0.001 mm, in three quarters of the time."""
    enough_seen: int = Field(50, ge=0)
    """Points of a frame that other frames see too: its place needs no others."""
    max_centre_shift: float = Field(0.1, ge=0)
    """Of a principal point, in parts of the image size; more is a bent model, not a lens."""
    focal_range: tuple[float, float] = (0.2, 5.0)
    """Focal lengths in longer image sides: outside, no lens of a survey camera."""
    lens_gain: float = Field(0.03, ge=0, le=1)
    """Of the robust cost: what distortion must gain over a calibration to be believed against it."""
    few_points: FewPointsTuning = Field(default_factory=FewPointsTuning)
    """Of all adjustments but the last."""
    points_iterations: int = Field(10, gt=0)
    """Of the points alone, once the poses are found with few of them."""
    lens: LensTuning = Field(default_factory=LensTuning)
    """Priors of lenses."""
    lever_arms: LeverArmTuning = Field(default_factory=LeverArmTuning)
    """What the cameras of a rig let expect of each other's places."""


class SigmaTuning(Section):
    """How well the adjustment knows what it estimates (`covariance.py`)."""

    most_points: int = Field(200_000, gt=0)
    """More are not looked at one by one: a random part, and the sums are scaled up."""
    frames: int = Field(200, gt=0)
    """Whose sigmas are worked out: evenly over the pass, for a median of more is the same."""
    points: int = Field(200, gt=0)
    """Whose sigmas are worked out: a random part."""
    between_pairs: int = Field(10, gt=0)
    """Pairs of frames about so far apart, of which the sigma of what lies between is told (`shape.py`)."""
    strong_correlation: float = Field(0.7, ge=0, le=1)
    """Of a parameter of interior orientation: one that is told."""
    open_share: float = Field(0.1, ge=0)
    """Sigma of a camera's place in the rig, in parts of its lever arm ..."""
    open_times: float = Field(3.0, ge=0)
    """... and in sigmas of the frames: beyond both, a place is hardly known."""


class ShutterTuning(Section):
    """Whether the rows of images are read one after another (`finish.py`)."""

    max_gap_s: float = Field(3.0, gt=0)
    """Between neighbours of a pass: beyond, their difference is no velocity at either (`scan.max_gap_s`)."""
    most_points: int = Field(20_000, gt=0)
    """Looked at: a random part of more."""
    sigmas: float = Field(5.0, gt=0)
    """Of a readout that is believed: a sigma of points knows nothing of what a lens does to all."""
    range_s: tuple[float, float] = (0.005, 0.1)
    """A shorter one is not known of any shutter, and KITTI's lenses look like 0.003; ODM's table ends at 0.074."""
    rounds: int = Field(4, gt=0)
    """Of an adjustment and a step of the readout, until a step is below its sigma."""
    told_gain: float = Field(0.001, ge=0, le=1)
    """Of the robust cost, foreseen: a readout that is told. PandaSet 0.003 to 0.006; KITTI (global) 0.0006, canal 0."""
    used_gain: float = Field(0.02, ge=0, le=1)
    """Foreseen, then reached: one that is used unasked. A telephone that sways by a degree 0.2; with PandaSet's 28 ms
    its cameras turn 0.04 deg better and stand 6 mm worse, for its rig is held to how it was calibrated without."""
    used_gap_s: float = Field(0.25, gt=0)
    """From image to image, then too: a hand sways faster than twice a second, and the readout stands in for what is not
    seen of that (simulated at 2 images a second: 35 ms for 20, at 10: 20.0)."""


class RegistrationTuning(Section):
    """What is said of a model's losses and doubts (`registrationreport.py`)."""

    few_points: int = Field(50, gt=0)
    """Points that a frame or a group of frames shares with all others, below which its own noise, such as a blur,
    shows in no residual. In 15 runs of kerry_park those with fewer are off by up to 120 times the median, with 50 to
    100 by up to 13; P8 thinned to 89 points 5 times with 16, once with 40; KITTI thinned to 807 has none below 50, and
    a half of its pass below 75, off 5 times. Sets that do well have 449 and more."""
    max_turned_deg: float = Field(3.0, ge=0)
    """By which the principal point of a camera in a held rig lies off; 1.5 at most in the right rigs of canal and
    kerry_park."""
    max_centre_off: float = Field(0.25, ge=0)
    """Of the image size that a principal point may lie off the middle."""


class TwoViewTuning(Section):
    """The accuracy of a pair by itself (`papers/fuse2014.py`)."""

    min_points: int = Field(8, ge=5)
    """Matches, and points before both images, below which there is no geometry."""
    max_error_px: float = Field(3.0, gt=0)
    """For the essential matrix, pixels of the preview."""
    trials: int = Field(200, gt=0)
    """Of the RANSAC for the essential matrix, at most."""
    confidence: float = Field(0.999, gt=0, lt=1)
    """Of that RANSAC."""
    farthest: float = Field(1e4, gt=0)
    """Points farther away, in bases, are not believed."""
    iterations: int = Field(20, gt=0)
    """Of the bundle adjustment."""


class StartCheckTuning(Section):
    """Whether a start model agrees with the model that the images made (`start.py`)."""

    least: int = Field(3, ge=3)
    """Images with both poses that tell something."""
    turn_deg: float = Field(2.0, gt=0)
    """Against the part that agrees: a finished model is straighter, one that a mapper bent is not."""
    off: float = Field(0.1, gt=0)
    """Likewise of the place, in distances to what is seen: beyond it predicts other overlap."""
    share: float = Field(0.1, ge=0, le=1)
    """Of the images: if more disagree, model and images contradict each other."""
    most: float = Field(0.5, ge=0, le=1)
    """Of the images: if more disagree, the model may be of something else."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    mapping: MappingTuning = Field(default_factory=MappingTuning)
    """The mappers."""
    adjust: AdjustTuning = Field(default_factory=AdjustTuning)
    """The final adjustment."""
    sigma: SigmaTuning = Field(default_factory=SigmaTuning)
    """The sigmas of a model."""
    shutter: ShutterTuning = Field(default_factory=ShutterTuning)
    """Rolling shutters."""
    registration: RegistrationTuning = Field(default_factory=RegistrationTuning)
    """What was lost, and what is in doubt."""
    two_view: TwoViewTuning = Field(default_factory=TwoViewTuning)
    """Two images alone."""
    start: StartTuning = Field(default_factory=StartTuning)
    """The start from poses that are roughly known."""
    placement: PlacementTuning = Field(default_factory=PlacementTuning)
    """The place of frames, tested."""
    rig: RigTuning = Field(default_factory=RigTuning)
    """The rig against the images."""
    world: WorldTuning = Field(default_factory=WorldTuning)
    """The model in the world."""
    start_check: StartCheckTuning = Field(default_factory=StartCheckTuning)
    """A start model against the images."""
