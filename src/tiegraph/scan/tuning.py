"""Constants of scan, each with its unit, its meaning and the source of its value."""

from pydantic import Field

from tiegraph.scene.tuning import GnssTuning
from tiegraph.settings import Section


class FoldersTuning(Section):
    """Camera and pass folders, and whether images are a sequence (`folders.py`)."""

    few: int = Field(30, ge=0)
    """Images below which they are loose: matching everything with everything then costs less than a wrong order."""
    one_depth: float = Field(0.75, ge=0, le=1)
    """Share of images at one depth of folders above which the others are strays."""
    apart_m: float = Field(30.0, gt=0)
    """Median distance between images of one name in several folders above which these are no cameras of a rig.
    Positions in EXIF are some metres off."""
    apart_s: float = Field(2.0, gt=0)
    """Median scatter of the time between them: EXIF has whole seconds, and different clocks differ by a constant."""
    regular: float = Field(0.9, ge=0, le=1)
    """Share of equal steps in the numbers, or in the times, of a sequence."""
    play: float = Field(0.25, ge=0)
    """Times are in equal steps if they differ by no more than this share of the median step ..."""
    play_s: float = Field(1.0, ge=0)
    """... or by this: EXIF often has whole seconds only."""


class FramesTuning(Section):
    """Images of a rig that were taken together (`assign.py`), and cameras that write into one folder (`folders.py`)."""

    unique: float = Field(0.9, ge=0, le=1)
    """Least share of numbers in a camera's names that occur once, if they number frames."""
    whole: float = Field(0.75, ge=0, le=1)
    """Least share of images with a mark, and of the images of complete shots: with less it is chance."""
    same_step: float = Field(0.25, gt=0, lt=0.5)
    """Share of the median step between names that are times: images of several cameras within it are of one frame."""


class CameraTuning(Section):
    """Limits of a camera (`rigfaults.py`), and assumed values if nothing is known (`cameras.py`)."""

    guessed_focal: float = Field(1.2, gt=0)
    """Focal length in longer sides of the image: COLMAP's ImageReaderOptions.default_focal_length_factor, a guess of 45
    degrees of view."""
    guessed_fisheye_deg: float = Field(180.0, gt=0, le=360)
    """Assumed field of view across a fisheye image, if its circle does not show ..."""
    guessed_circle_deg: float = Field(200.0, gt=0, lt=360)
    """... and across the circle, if it does: lenses of 360 cameras have 195 to 200."""
    same_shape: float = Field(0.01, ge=0)
    """Relative difference of two aspect ratios that rounding to whole pixels may cause."""
    start_focal: float = Field(0.01, gt=0)
    """Relative sigma of the focal length of a start model's camera, and of a factory's: it is adjusted. Three of
    Insta360's models of one camera agree to 0.4 %."""
    min_fov_deg: float = Field(1.0, ge=0)
    """Least field of view across an image."""
    max_fov_deg: float = Field(170.0, gt=0, lt=180)
    """Largest field of view across a perspective image: its edges lie at tan(85) = 11 focal lengths."""
    max_aspect: float = Field(2.0, ge=1)
    """fx over fy: pixels are nearly square."""
    off_centre: float = Field(0.4, gt=0, le=0.5)
    """Share of the sides, both ways: a principal point farther from the middle has another origin."""
    stretch: tuple[float, float] = (1 / 3, 10.0)
    """Limit of the field angle at the edge of the image with distortion over that without."""
    round_trip: float = Field(0.01, gt=0)
    """Share of the image's longer side: tolerance of a pixel projected back from its ray."""
    fisheye_middle: float = Field(0.5, gt=0, le=1)
    """Share of the shorter side of a fisheye image that is tested: its circle may end before the edge."""


class RigTuning(Section):
    """Limits of a rig (`rigfile.py`, `rigfaults.py`), and values of presets (`rigspec.py`)."""

    max_rig_m: float = Field(100.0, gt=0)
    """Largest distance between two cameras, or a camera and the antenna, of one rig; above it units are wrong."""
    contradiction_sigmas: float = Field(10.0, gt=0)
    """Tolerated difference between pairs and positions; larger ones are reported."""
    camera: CameraTuning = Field(default_factory=CameraTuning)
    """Number of its cameras."""


class PanoramaTuning(Section):
    """The views of panoramas (`views.py`): like the side cameras of a Ladybug, for the same offsets and
    sections as such a rig; and one up. Below are the tripod, the operator or the platform."""

    around: int = Field(5, gt=0)
    """Level views of a panorama."""
    hfov_deg: float = Field(80.0, gt=0, lt=180)
    """Width of a view: 8 degrees more than a fifth of the circle, so that features at the edges have surroundings."""
    vfov_deg: float = Field(90.0, gt=0, lt=180)
    """Height of a view, and width and height of one of a single fisheye lens."""


class LensViewsTuning(Section):
    """The image circle of a fisheye lens, and the views of a calibrated one (`views.py`)."""

    wider_deg: float = Field(150.0, gt=0, le=180)
    """A lens with a larger field of view is cut into views: at its rim a pixel counts 15 times and more in a plane."""
    back_to_back_deg: float = Field(150.0, gt=0, le=180)
    """Least angle between two lenses of a 360 camera."""
    reach_deg: float = Field(88.0, gt=0, lt=90)
    """Largest angle off the axis in views: at 90 degrees COLMAP's lenses end, and the last pixels would be black."""
    nominal_sigma: float = Field(0.05, gt=0)
    """Relative sigma of the focal length of a lens of a 360 camera without calibration."""
    most_sigma: float = Field(0.0075, gt=0)
    """A lens with a larger relative sigma of the focal length is not cut into views: they hold it fixed."""
    factory_edge_deg: tuple[float, float] = (90.0, 106.0)
    """Field angle of the edge of the circle by the factory's values: lenses see 95 to 102 degrees off the axis."""
    factory_off: float = Field(0.02, gt=0)
    """Tolerated distance of its middle from the factory's centre, a share of its radius."""
    rim: float = Field(0.03, ge=0, lt=1)
    """Share of its radius: a lens ends in a blurred, coloured rim."""


class PicturesTuning(Section):
    """Images that scan writes (`prepare.py`), and those it takes from videos (`video.py`)."""

    least_decoded: float = Field(0.95, ge=0, le=1)
    """Least share of a video's stated frames; the count in some headers is an estimate. Fewer are reported."""
    creation_apart_s: float = Field(2.0, ge=0)
    """Creation times of two videos of a rig, in whole seconds each, whose difference to their offset is reported."""
    nearest_steps: float = Field(0.75, gt=0)
    """Frames of the other cameras of a rig are taken up to this many of their steps from those of the first: half a
    step, and a margin for stamps in whole milliseconds."""
    most_dop: float = Field(5.0, gt=0)
    """Dilution of precision of a camera's own receiver above which a fix is left out: "under 500 is good" for its
    hundredfold by GoPro (gpmf-parser)."""
    receiver_apart_s: float = Field(0.5, gt=0)
    """Median difference of the receiver's clock from the video's above which it is reported: payloads differ by 0.1."""
    zone_apart_s: float = Field(60.0, gt=0, lt=450)
    """Largest distance between the middles of a recording and of its fixes after subtracting a time zone in whole
    quarters of an hour: a receiver may find its first fix late."""
    zone_inside: float = Field(0.9, gt=0, le=1)
    """Share of the fixes within a recording above which its creation time is taken as UTC."""


class MotionTuning(Section):
    """The motion of a video's picture (`videooffset.py`)."""

    width_px: int = Field(640, ge=64)
    """Width at which pictures are compared: KITTI's two cameras agree best there (of 320, 640 and 1241)."""
    most_s: float = Field(300.0, gt=0)
    """Length from the video's start; clocks of cameras drift by 10 to 50 us a second, 15 ms in this time at most."""


class OffsetTuning(Section):
    """When one video of a rig began after another (`videooffset.py`)."""

    least_frames: int = Field(20, ge=4)
    """Least frames of a video for a measurement of its motion."""
    least_s: float = Field(2.0, gt=0)
    """Seconds that two videos must share at a tried offset."""
    noise_px: float = Field(0.02, gt=0)
    """Sigma of the measured motion per step."""
    apart_steps: float = Field(4.0, gt=0)
    """Offsets farther apart are different: the motion within a second is similar to itself."""
    least_gain: float = Field(2.5, ge=1)
    """Least ratio of the likelihood of the best offset to that of the best different one, and to noise. Among wrong
    ones the best has up to 1.6 times the next (curves of 20 s); KITTI's 5 s of a straight road have 3.7."""
    smoothing: float = Field(0.01, ge=0)
    """Steps; what interpolation between frames may add to the error (synthetic curves: 0.007)."""
    most_sigma: float = Field(0.5, gt=0)
    """Steps; with a larger sigma the offset could be that of the next frame."""


class TimesTuning(Section):
    """When frames were taken (`times.py`)."""

    apart_s: float = Field(3600.0, ge=0)
    """A frame's time is far from those of its pass beyond this and ten times their range."""
    same_shot_s: float = Field(0.5, ge=0)
    """Images of one frame whose times are farther apart are reported."""


class PositionsTuning(Section):
    """Where frames were taken (`positions.py`)."""

    unknown_height_sigma_m: float = Field(100.0, gt=0)
    """Height for a photograph with latitude and longitude only."""
    apart_m: float = Field(1.0, ge=0)
    """Rows of one frame's images that are farther apart are reported: a rig is smaller, or they share a row."""
    gnss: GnssTuning = Field(default_factory=GnssTuning)
    """Their plausible range."""


class TrajectoryTuning(Section):
    """Trajectories, and their fit to positions (`priors.py`, `trajectory.py`)."""

    least_positions: int = Field(3, ge=2)
    """Least frames with a position for fitting a trajectory."""
    least_extent_sigmas: float = Field(3.0, ge=0)
    """Least spread of these, in median sigmas of a position."""
    least_baselines: int = Field(3, gt=0)
    """Least pairs of images of one frame with a known baseline for the unit of a start model."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    folders: FoldersTuning = Field(default_factory=FoldersTuning)
    """Folders and order."""
    frames: FramesTuning = Field(default_factory=FramesTuning)
    """Images taken together."""
    rig: RigTuning = Field(default_factory=RigTuning)
    """Rigs and their cameras."""
    panorama: PanoramaTuning = Field(default_factory=PanoramaTuning)
    """Panoramas."""
    lens_views: LensViewsTuning = Field(default_factory=LensViewsTuning)
    """Fisheye images."""
    pictures: PicturesTuning = Field(default_factory=PicturesTuning)
    """What is written."""
    motion: MotionTuning = Field(default_factory=MotionTuning)
    """Motion of videos."""
    offset: OffsetTuning = Field(default_factory=OffsetTuning)
    """Offsets between videos."""
    times: TimesTuning = Field(default_factory=TimesTuning)
    """Times of frames."""
    positions: PositionsTuning = Field(default_factory=PositionsTuning)
    """Positions of frames."""
    trajectory: TrajectoryTuning = Field(default_factory=TrajectoryTuning)
    """Trajectories."""
