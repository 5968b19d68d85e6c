"""Constants of the stages sparse and georef, each with its unit, meaning and origin."""

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
    """Share of the connected images: if a start or a mapper places fewer, another is tried and a note says why."""
    roughly_fewer: float = Field(0.5, ge=0, le=1)
    """The same share for a rough model, where more images see few of its fewer points."""
    other_focal: float = Field(1.4, gt=1)
    """Ratio of a focal length to the given one, in either direction, from which the two contradict each other
    (`mapper.py`). Data sheets and EXIF are accurate to some percent; a diverged one was 2.1 times too long (a
    hand-held kitchen)."""
    turned_share: float = Field(0.9, gt=0, le=1)
    """Share of pairs explained by rotations alone, from which there is no base for a model (`registrationreport.py`).
    Views of one panorama 0.99; thirty real surveys 0 to 0.06, a drone over the sea 0.33."""
    turned_off: float = Field(0.002, gt=0)
    """Residual of a rotation for such a pair, as a share of the longer side: 0.0003 in those views, 0.003 to 0.06 in
    the surveys."""
    max_turned_deg: float = Field(3.0, ge=0)
    """Shift of the principal point of a camera in a held rig, as an angle; 1.5 at most in the correct rigs of canal
    and kerry_park."""
    min_model_images: int = Field(3, ge=2)
    """Fewest images of a mapper's model."""
    rough_tracks: int = Field(100, gt=0)
    """Number of tracks, longest first, that every image at least takes part in, in a rough model. Simulated block of
    372 previews: 15 instead of 69 CPU s, centres good to 0.15 instead of 0.01 m, rotations to 0.05 instead of 0.03
    deg (medians)."""


class FocalTuning(Section):
    """Focal lengths of unknown cameras (`focal.py`)."""

    pairs: int = Field(100, gt=0)
    """Pairs of images that are used, those with most matches."""
    least_matches: int = Field(30, ge=8)
    """Matches of such a pair."""
    least_pairs: int = Field(8, gt=0)
    """Pairs that tell a focal length, at least."""
    error: float = Field(0.003, gt=0)
    """Distance of a match from its epipolar line, in longer sides of the image."""
    flat: float = Field(0.8, gt=0, le=1)
    """Share of the matches that one plane explains, from which a pair tells nothing (COLMAP's max_H_inlier_ratio)."""
    tells: float = Field(0.02, gt=0)
    """A pair whose relative difference is nowhere larger tells nothing: the largest is 0.002 in pairs of one camera of
    vehicles that drive straight on (KITTI, PandaSet), 0.04 on canals, 0.2 on facades."""
    denied: float = Field(0.8, gt=0, le=1)
    """Cost of a camera's own focal length, as a share of that of the one of all, below which it has its own: 0.57 to
    0.76 of the long lens of PandaSet (in three conditions), 0.88 and more of equal ones (uav_bands, canals)."""
    sure: float = Field(1.6, gt=1)
    """Ratio of the 90th to the 10th percentile of the bootstrap above which the guess stays: 1.0 to 1.4 where the
    focal length is right, 3.3 over the flat beach of brighton."""


class LensTuning(Section):
    """Prior sigmas of lens parameters (`lens.py`)."""

    aspect: float = Field(0.002, gt=0)
    """Sigma of fx / fy - 1: pixels are square."""
    decentring: float = Field(0.0005, gt=0)
    """Sigma of p1, p2: lenses are centred to some hundredths of a millimetre."""
    loose_focal: float = Field(0.2, gt=0)
    """Relative sigma of a focal length without calibration (of a principal point too in models other than OPENCV)."""
    loose_centre: float = Field(0.1, gt=0)
    """Sigma of its principal point, as a share of the focal length."""
    radial: float = Field(0.5, gt=0)
    """Sigma of k1, k2 (of all distortion in models other than OPENCV): nothing is known of a lens without calibration,
    and the distortion of a calibration that the images contradict is not trusted at all (PandaSet gives none)."""
    given: float = Field(0.001, gt=0)
    """Sigma of the focal lengths and the principal point of such a calibration, as a share of the focal length."""


class FewPointsTuning(Section):
    """Points of the adjustments of models that are not yet near their solution (`adjust.py`).

    `sparse` with them, trajectory error and CPU time against all points: 1200 rendered images 3.6 -> 3.6 mm, 615 ->
    374 s; canal 3.8 -> 3.3 mm, 159 -> 99 s; PandaSet 26 -> 31 mm, 159 -> 128 s (the times of its cameras differ by 1
    ms); in an earlier version canal_demo 9.2 -> 8.9 mm, 19 -> 16 s and Herz-Jesus-P25 6.4 -> 6.5 mm, 13 -> 12 s.
    """

    cells: int = Field(8, gt=0)
    """Cells of an image in each direction: points are taken from every cell."""
    in_a_cell: int = Field(3, gt=0)
    """Number of longest tracks taken from a cell."""
    worth: float = Field(0.5, ge=0, le=1)
    """Share of the observations: if more would remain, all are used (0: always)."""


class AdjustTuning(Section):
    """The final adjustment (`adjust.py`) and what all adjustments share.

    A principal point 6 px off in a 232 px lens turns its camera by 1.5 degrees against the rig and bends the model: on
    canal_demo (nominal rig, guessed intrinsics) the final adjustment brings the trajectory error from 0.06-0.09 m to
    0.01-0.03 m.
    """

    robust_px: float = Field(0.5, gt=0)
    """Cauchy scale: about the sigma of a SIFT key point. Reprojection errors are not divided by their sigma, so
    priors are multiplied by it."""
    min_points: int = Field(10, gt=0)
    """Model points that an image sees; with fewer, only the rig gives its pose."""
    min_images: int = Field(10, gt=0)
    """Images of a camera from which its intrinsics are adjusted once more with the principal point; images without any
    tie to the model that are mapped separately."""
    filter_px: float = Field(2.0, gt=0)
    """Observations with larger errors after the first adjustment are removed."""
    filter_angle_deg: float = Field(1.0, ge=0)
    """Points whose rays all meet at a smaller angle are removed."""
    iterations: int = Field(30, ge=0)
    """Iterations of a solution with few points, at most: a flat minimum such as that of focal length and height over
    flat ground needs many. 0: the model stays as its mapper leaves it, neither adjusted nor checked."""
    last_iterations: int = Field(10, gt=0)
    """Iterations of the last solutions, with all points, and of those for the points alone."""
    robust_rounds: int = Field(2, ge=0)
    """The last round has all points. The first plain solution is bent by observations that are filtered after it, and
    still by those that the robust solution rejects: with one more round without them canal_demo is 4.7 mm off instead
    of 6.5 and canal 6.8 instead of 12.4, in the same time."""
    tolerance: float = Field(1e-6, gt=0)
    """Relative change of the cost that ends the iteration: canal_demo's trajectory is the same to 0.001 mm, in three
    quarters of the time. A hundred times as much where another adjustment follows."""
    enough_seen: int = Field(50, ge=0)
    """Points that a frame or a group of frames shares with all others, from which its place needs no more; below, its
    own errors, such as those of a blur, show in no residual. In 15 runs of kerry_park frames with fewer are off by up
    to 120 times the median, with 50 to 100 by up to 13; P8 thinned to 89 points 5 times with 16, once with 40; KITTI
    thinned to 807 has none below 50, and a half of its pass below 75, off 5 times. Sets that do well have 449 and
    more."""
    max_centre_shift: float = Field(0.1, ge=0)
    """Shift of a principal point as a share of the image size; a larger one is a bent model, not a lens."""
    focal_range: tuple[float, float] = (0.2, 5.0)
    """Range of focal lengths in units of the longer image side; no lens of a survey camera is outside it."""
    used_gain: float = Field(0.02, ge=0, le=1)
    """Reduction of the robust cost from which what nobody asked for is used: free distortion against a calibration,
    the readout of a rolling shutter (predicted, and then reached). A telephone that sways by a degree 0.2; with
    PandaSet's 28 ms its cameras' rotations are 0.04 deg better and their places 6 mm worse, because its rig is held
    as calibrated without a readout."""
    few_points: FewPointsTuning = Field(default_factory=FewPointsTuning)
    """Points of all adjustments but the last."""
    lens: LensTuning = Field(default_factory=LensTuning)
    """Priors of lenses."""
    lever_arms: LeverArmTuning = Field(default_factory=LeverArmTuning)
    """Prior of the rig's geometry."""

    @property
    def rough_tolerance(self) -> float:
        """The tolerance where another adjustment follows, which starts with better points."""
        return 100 * self.tolerance


class SigmaTuning(Section):
    """Accuracy of the estimated parameters (`covariance.py`)."""

    most_points: int = Field(200_000, gt=0)
    """Points used; of more, a random sample, and the sums are scaled up."""
    sampled: int = Field(200, gt=0)
    """Frames, evenly over the pass, and random points whose sigmas are computed: the median of more is the same."""
    between_pairs: int = Field(10, gt=0)
    """Pairs of frames at a distance that are needed for the sigma of the vector between frames (`shape.py`)."""
    open_share: float = Field(0.1, ge=0)
    """Sigma of a camera's place in the rig as a share of its lever arm, beyond which it is hardly determined, if it
    is beyond that of the frames too."""


class ShutterTuning(Section):
    """Detection of rolling shutters (`finish.py`)."""

    max_gap_s: float = Field(3.0, gt=0)
    """Gap between neighbours of a pass beyond which their difference gives no velocity (`scan.max_gap_s`)."""
    range_s: tuple[float, float] = (0.005, 0.1)
    """No shutter has a shorter readout, and KITTI's lenses look like 0.003; ODM's table ends at 0.074."""
    told_gain: float = Field(0.001, ge=0, le=1)
    """Predicted reduction of the robust cost from which a readout is reported. PandaSet 0.003 to 0.006; KITTI
    (global) 0.0006, canal 0."""
    used_gap_s: float = Field(0.25, gt=0)
    """Median time between images up to which a readout is used without request: a hand sways faster than twice a
    second, and the readout absorbs motion that is not sampled (simulated at 2 images a second: 35 ms instead of 20,
    at 10: 20.0)."""


class StartCheckTuning(Section):
    """Agreement of a start model with the model that the images gave (`start.py`)."""

    turn_deg: float = Field(2.0, gt=0)
    """Rotation relative to the consistent part: a finished model is straighter, one bent by a mapper is not."""
    off: float = Field(0.1, gt=0)
    """Distance from that part's place, as a share of the distance to the surface: beyond it the predicted overlap
    differs."""
    share: float = Field(0.1, ge=0, le=1)
    """Share of the images: if more disagree, start model and images contradict each other."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    mapping: MappingTuning = Field(default_factory=MappingTuning)
    """The mappers."""
    adjust: AdjustTuning = Field(default_factory=AdjustTuning)
    """The final adjustment."""
    sigma: SigmaTuning = Field(default_factory=SigmaTuning)
    """Sigmas of a model."""
    shutter: ShutterTuning = Field(default_factory=ShutterTuning)
    """Rolling shutters."""
    start: StartTuning = Field(default_factory=StartTuning)
    """The start from approximate poses."""
    placement: PlacementTuning = Field(default_factory=PlacementTuning)
    """Test of the places of frames."""
    rig: RigTuning = Field(default_factory=RigTuning)
    """Test of the rig against the images."""
    world: WorldTuning = Field(default_factory=WorldTuning)
    """Georeferencing."""
    focal: FocalTuning = Field(default_factory=FocalTuning)
    """Focal lengths of unknown cameras."""
    start_check: StartCheckTuning = Field(default_factory=StartCheckTuning)
    """Test of a start model against the images."""
