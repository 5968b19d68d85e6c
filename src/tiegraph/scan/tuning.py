"""What scan decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.scene.tuning import GnssTuning
from tiegraph.settings import Section


class FoldersTuning(Section):
    """Which folders are cameras and which passes, and whether images are a sequence (`folders.py`)."""

    few: int = Field(30, ge=0)
    """Images below which they are loose: matching everything with everything then costs less than a wrong guess of the
    order."""
    one_depth: float = Field(0.75, ge=0, le=1)
    """Share of images at one depth of folders that makes the others strays."""
    apart_m: float = Field(30.0, gt=0)
    """Between images of one name in several folders, in the median: farther, these are no cameras of a rig. Positions
    in EXIF are some metres off."""
    apart_s: float = Field(2.0, gt=0)
    """Scatter of the time between them, in the median: EXIF has whole seconds, and clocks that differ do so alike."""
    regular: float = Field(0.9, ge=0, le=1)
    """Share of equal steps in the numbers, or in the times, of a sequence."""
    play: float = Field(0.25, ge=0)
    """Times are in equal steps if they differ by no more than this share of the median step ..."""
    play_s: float = Field(1.0, ge=0)
    """... or by this: EXIF often has whole seconds only."""


class FramesTuning(Section):
    """Which images of a rig were taken together (`frames.py`), and cameras that write into one folder (`bands.py`)."""

    unique: float = Field(0.9, ge=0, le=1)
    """Share of the numbers in a camera's names that stand there once, or they do not number frames."""
    whole: float = Field(0.75, ge=0, le=1)
    """Share of images that have a mark, and of the images that whole shots would have: else it is chance."""
    same_step: float = Field(0.25, gt=0, lt=0.5)
    """Of the median step between names that are times: images of several cameras within it are of one frame."""


class CameraTuning(Section):
    """What a camera can be (`rigfaults.py`), and what it is taken for where nothing tells (`cameras.py`)."""

    guessed_focal: float = Field(1.2, gt=0)
    """Focal length in longer sides of the image: COLMAP's ImageReaderOptions.default_focal_length_factor, a guess of 45
    degrees of view."""
    guessed_fisheye_deg: float = Field(180.0, gt=0, le=360)
    """What a fisheye image sees across, where its circle does not show ..."""
    guessed_circle_deg: float = Field(200.0, gt=0, lt=360)
    """... and where it does, what the lens sees across it: those of 360 cameras 195 to 200."""
    same_shape: float = Field(0.01, ge=0)
    """Relative difference of two aspect ratios that rounding to whole pixels may cause."""
    start_focal: float = Field(0.01, gt=0)
    """Sigma of the focal length of a camera of a start model, of that length: it is adjusted."""
    min_fov_deg: float = Field(1.0, ge=0)
    """What an image sees across, at least."""
    max_fov_deg: float = Field(170.0, gt=0, lt=180)
    """Of a perspective image, across: its edges lie at tan(85) = 11 focal lengths."""
    max_aspect: float = Field(2.0, ge=1)
    """fx over fy: pixels are nearly square."""
    off_centre: float = Field(0.4, gt=0, le=0.5)
    """Of the sides, both ways: a principal point that is farther from the middle counts from elsewhere."""
    stretch: tuple[float, float] = (1 / 3, 10.0)
    """How far out distortion lets the edge of an image look, times what a straight lens does."""
    round_trip: float = Field(0.01, gt=0)
    """Of the image's longer side: by so much may a pixel miss itself by way of its ray."""
    fisheye_middle: float = Field(0.5, gt=0, le=1)
    """Share of the shorter side of a fisheye image that is looked at: its circle may end before the edge."""


class RigTuning(Section):
    """What a rig can be (`rigfile.py`, `rigfaults.py`), and what presets say (`rigspec.py`)."""

    max_rig_m: float = Field(100.0, gt=0)
    """Between two cameras, or a camera and the antenna, of one rig; farther apart: wrong units."""
    contradiction_sigmas: float = Field(10.0, gt=0)
    """Between what a pair says and what the positions say: more is said."""
    camera: CameraTuning = Field(default_factory=CameraTuning)
    """Its cameras."""


class PanoramaTuning(Section):
    """The views of panoramas (`sharedfiles.py`): like the side cameras of a Ladybug, seen by the same offsets and
    sections as such a rig; and one up. What is below is the tripod, the operator or the platform."""

    around: int = Field(5, gt=0)
    """Level views of a panorama."""
    hfov_deg: float = Field(80.0, gt=0, lt=180)
    """Of a view: 8 degrees more than a fifth of the circle, so that features at the edges have a neighbourhood."""
    vfov_deg: float = Field(90.0, gt=0, lt=180)
    """Of a view, from top to bottom."""


class LensViewsTuning(Section):
    """What a fisheye lens lights, and the views of a calibrated one (`fisheye.py`)."""

    wider_deg: float = Field(150.0, gt=0, le=180)
    """A lens that sees more across is cut into views: at its rim a pixel counts 15 times and more in a plane."""
    back_to_back_deg: float = Field(150.0, gt=0, le=180)
    """Between two lenses: from here on they are those of a 360 camera."""
    fov_deg: float = Field(90.0, gt=0, lt=180)
    """Of a view of a lens alone, across and down: one ahead, four around as far as the reach. Level views of a 360
    camera are as wide and high as a panorama's: one ahead, two to the sides as far as the reach."""
    reach_deg: float = Field(88.0, gt=0, lt=90)
    """Off the axis, how far views reach: at 90 degrees COLMAP's lenses end, and the last pixels would be black."""
    nominal_sigma: float = Field(0.05, gt=0)
    """Of the focal length of a lens of a 360 camera that nobody calibrated, a share ..."""
    factory_sigma: float = Field(0.01, gt=0)
    """... and of one that its factory did: three of its models of one camera agree to 0.4 %."""
    most_sigma: float = Field(0.0075, gt=0)
    """A lens whose focal length is known worse, a share, is not cut into views: they hold it as it is."""
    factory_edge_deg: tuple[float, float] = (90.0, 106.0)
    """Where the circle of a picture must end by what the factory says, off the axis: lenses see 95 to 102 degrees."""
    factory_off: float = Field(0.02, gt=0)
    """How far its middle may be from the centre that the factory says, a share of its radius."""
    rim: float = Field(0.03, ge=0, lt=1)
    """Of its radius: a lens ends in a blurred, coloured rim."""


class PicturesTuning(Section):
    """Images that scan writes (`prepare.py`), and those it takes from videos (`video.py`)."""

    least_decoded: float = Field(0.95, ge=0, le=1)
    """Of the frames that a video says it has; the count in some headers is an estimate. Fewer are said."""
    creation_apart_s: float = Field(2.0, ge=0)
    """Creation times of two videos of a rig, in whole seconds each, that contradict their offset by more are said."""
    nearest_steps: float = Field(0.75, gt=0)
    """Frames of the other cameras of a rig are taken up to so many of their steps from those of the first: half a
    step, and some play for stamps in whole milliseconds."""
    most_dop: float = Field(5.0, gt=0)
    """Dilution of precision of a camera's own receiver from which a fix is left out: "under 500 is good", GoPro says of
    its hundredfold (gpmf-parser)."""
    receiver_apart_s: float = Field(0.5, gt=0)
    """Median difference of the receiver's clock from the video's that is said: those of payloads differ by a tenth."""
    zone_apart_s: float = Field(60.0, gt=0, lt=450)
    """Between the middles of a recording and of its fixes, once whole quarters of an hour, which are a time zone, are
    taken off: a receiver may find its first fix late."""
    zone_inside: float = Field(0.9, gt=0, le=1)
    """Share of the fixes within a recording from which its creation time is taken for UTC without more ado."""


class MotionTuning(Section):
    """How a video's picture moves (`videooffset.py`)."""

    width_px: int = Field(640, ge=64)
    """Width at which pictures are compared: KITTI's two cameras agree best there (of 320, 640 and 1241)."""
    most_s: float = Field(300.0, gt=0)
    """Of a video, from its start; clocks of cameras drift by 10 to 50 us a second, 15 ms in this time at most."""


class OffsetTuning(Section):
    """When one video of a rig began after another (`videooffset.py`)."""

    least_frames: int = Field(20, ge=4)
    """Frames of a video whose motion can tell."""
    least_s: float = Field(2.0, gt=0)
    """Seconds that two videos must share at an offset that is tried."""
    noise_px: float = Field(0.02, gt=0)
    """Sigma of the measured motion a step."""
    apart_steps: float = Field(4.0, gt=0)
    """Offsets that are farther apart are different ones: the motion of a second is alike in itself."""
    least_gain: float = Field(2.5, ge=1)
    """Of the likelihood of the best offset over that of the best different one, and over that of noise. Of wrong ones
    the best has up to 1.6 times the next (curves of 20 s); KITTI's 5 s of a straight road have 3.7."""
    smoothing: float = Field(0.01, ge=0)
    """Steps; what interpolation between frames may add to the error (synthetic curves: 0.007)."""
    most_sigma: float = Field(0.5, gt=0)
    """Steps; an offset that is worse known could as well be that of the next frame."""


class TimesTuning(Section):
    """When frames were taken (`times.py`)."""

    apart_s: float = Field(3600.0, ge=0)
    """A frame's time is far from those of its pass: so much, and ten times their range."""
    same_shot_s: float = Field(0.5, ge=0)
    """Images of one frame whose times are farther apart are said."""


class PositionsTuning(Section):
    """Where frames were taken (`positions.py`)."""

    unknown_height_sigma_m: float = Field(100.0, gt=0)
    """Of a photograph with latitude and longitude but no height."""
    apart_m: float = Field(1.0, ge=0)
    """Rows of one frame's images that are farther apart are said: a rig is smaller, or they share a row."""
    gnss: GnssTuning = Field(default_factory=GnssTuning)
    """What is believed of them."""


class TrajectoryTuning(Section):
    """Trajectories, and how they are laid on positions (`priors.py`, `trajectory.py`)."""

    least_positions: int = Field(3, ge=2)
    """Frames with a position that a trajectory needs to be laid on them."""
    least_extent_sigmas: float = Field(3.0, ge=0)
    """How far these must spread, in median sigmas of a position."""
    least_baselines: int = Field(3, gt=0)
    """Pairs of images of one frame with a known baseline that tell the unit of a start model."""


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
