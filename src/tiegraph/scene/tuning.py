"""What the shared library decides by: each constant with its unit, its meaning and where its value comes from.

``GnssTuning`` and ``TrendTuning`` are of one engine alone, scan and sfm, and stand in its tuning.
"""

from pydantic import Field

from tiegraph.settings import Section


class PanoramaTuning(Section):
    """Which images are equirectangular panoramas (`panorama.py`)."""

    min_width_px: int = Field(1024, gt=0)
    """Smaller panoramas have views of less than 290 px."""
    pole_grey: float = Field(6.0, gt=0)
    """Grey levels by which a row that is one point of the sphere may vary (JPEG noise), and the image must."""
    seam: float = Field(3.0, gt=0)
    """Step over the seam, in steps between the columns beside it."""
    least_step_grey: float = Field(0.5, gt=0)
    """Such a step at least: a clear sky has none."""


class FisheyeTuning(Section):
    """The circle that a fisheye lens lights in its image (`fisheye.py`), at `look_px` where pixels are meant."""

    look_px: int = Field(480, gt=0)
    """Longer side of a lens' image at which its circle is sought: a pixel is 0.4 % of its radius."""
    corner: float = Field(0.02, gt=0, lt=0.5)
    """Of the shorter side: squares in the corners that must be dark. A circle as wide as the image leaves 0.1."""
    dark_grey: float = Field(24.0, ge=0, le=255)
    """Brightest channel of what no light falls on, with JPEG's noise; kerry_park's surround has 0 .. 12."""
    play_px: float = Field(1.5, gt=0)
    """By which a place may lie off the circle: a pixel and its blur; of those so near the border none is used ..."""
    play: float = Field(0.01, ge=0)
    """... or by this share of the radius: the rim of a lens is no exact circle."""
    least_share: float = Field(0.4, gt=0, le=1)
    """Of the rays that must end on the circle: the image may cut it on two or four sides, and dark scenes end early."""
    off_middle: float = Field(0.1, ge=0)
    """Of the shorter side: between the circle's centre and the image's."""
    least_radius: float = Field(0.3, gt=0)
    """Of the shorter side: a smaller circle is a spot of light in a dark picture."""
    alike: float = Field(0.03, ge=0)
    """Relative difference of the radii of two circles side by side."""


class ImageTuning(Section):
    """What a look at an image file tells (`images.py`, `exif.py`)."""

    min_side_px: int = Field(32, gt=0)
    """Of an image that can be used."""
    focal_range: tuple[float, float] = (0.2, 20.0)
    """Focal lengths in longer image sides that EXIF is believed: 136 degrees of view ... a 700 mm lens."""
    panorama: PanoramaTuning = Field(default_factory=PanoramaTuning)
    """Panoramas."""
    fisheye: FisheyeTuning = Field(default_factory=FisheyeTuning)
    """Fisheye images."""


class GnssTuning(Section):
    """What is believed of a receiver's positions (`gnss/`)."""

    vertical: float = Field(2.0, gt=0)
    """Sigma of a height over that of the place: satellites fix it about half as well, all of them are above."""
    most_far: float = Field(0.1, ge=0, le=1)
    """Share of positions that is left out as false, at most."""
    stuck: int = Field(3, gt=1)
    """Positions, at least, that are said to be all the same."""


class ControlTuning(Section):
    """Control points as their files give them (`gcp.py`)."""

    sigma_m: tuple[float, float, float] = (0.02, 0.02, 0.03)
    """East, north and up of a surveyed point whose file says nothing: network RTK with a pole."""
    bar_sigma_m: float = Field(0.001, gt=0)
    """Of the length of a scale bar whose file says nothing: measured with a tape."""
    longest_bar_m: float = Field(100.0, gt=0)
    """More are millimetres."""
    largest_copy: float = Field(4.0, ge=1)
    """Of an image that was marked, times the survey's: images are halved twice for a survey at most."""


class TrendTuning(Section):
    """What is no noise in residuals along the way (`evidence.py`)."""

    min_rows: int = Field(8, ge=6)
    """Values below which a trend and noise cannot be told apart."""
    step_rows: int = Field(3, gt=0)
    """Values on either side of a step, at least."""
    max_correlation: float = Field(0.98, ge=0, lt=1)
    """Of neighbouring values."""
    caution_sigmas: float = Field(2.0, ge=0)
    """By which the correlation may be larger than it looks: short series look less correlated than they are."""
    spike_sigmas: float = Field(6.0, gt=0)
    """Robust sigmas from the neighbours: a single bad value is no trend."""


class RegisteredTuning(Section):
    """Which images of a model are registered (`registered.py`)."""

    min_points: int = Field(10, gt=0)
    """Points that an image must see where they should be: fewer may agree by chance."""
    agree_px: float = Field(4.0, gt=0)
    """Between a point's projection and where it is seen; COLMAP's own limit of an observation."""


class BlocksTuning(Section):
    """A large survey in blocks (`blocks.py`)."""

    whole: int = Field(600, gt=0)
    """Images that are mapped in one piece."""
    own: int = Field(420, gt=0)
    """Images that a block has of its own, at most."""
    near: int = Field(24, gt=0)
    """Nearest frames by prior positions whose links count. Of 1200 rendered images with repeated walls (canal
    generator, seed 5) 12, 24 and 48 give the same three stretches of the way, also with noise of 5 m and with 30 % of
    the positions missing."""
    unplaced: float = Field(2.5, ge=1)
    """Times by which surveys are larger that are mapped in one piece, and blocks, where less than half of the frames
    have positions: cut by their matches alone, blocks of 420 of those images mixed places far apart and were wrong by 4
    to 40 m, four times; in one piece the first model had 1188 of them, to 15 mm. Larger ones were not tried."""
    least: int = Field(30, gt=0)
    """Images of a block: a smaller one, that nothing ties to the rest, is left out."""
    lent: int = Field(60, ge=0)
    """Images that a block takes from each of its neighbours ..."""
    least_lent_frames: int = Field(4, ge=0)
    """... and the least frames of them."""
    least_ties: int = Field(10, gt=0)
    """Pairs of images between two parts that make them neighbours."""
    margin: float = Field(0.2, ge=0, le=1)
    """Of a part: a cut may be so far from where it would halve it, to be where ties are few."""
    order: float = Field(0.05, gt=0)
    """Of the mean link: what the order of a pass alone links its frames with."""


class JoiningTuning(Section):
    """Models of blocks put into one frame (`joining.py`)."""

    shared: int = Field(12, ge=3)
    """Images of two models that a join needs, and that must agree with it."""
    agree: float = Field(0.6, ge=0, le=1)
    """Share of the shared images that must agree."""
    turn_deg: float = Field(3.0, gt=0)
    """By which the poses of an image in two models may differ."""
    shift: float = Field(0.06, gt=0)
    """Likewise, as a share of the distance to what the images see."""
    drift: float = Field(0.1, gt=0)
    """Of the survey's extent, by which the places of a join may differ along a chain of others."""


class Tuning(Section):
    """Constants of the shared library that are the same for every user."""

    images: ImageTuning = Field(default_factory=ImageTuning)
    """Image files."""
    control: ControlTuning = Field(default_factory=ControlTuning)
    """Control points."""
    registered: RegisteredTuning = Field(default_factory=RegisteredTuning)
    """Registered images."""
    blocks: BlocksTuning = Field(default_factory=BlocksTuning)
    """Blocks of a survey."""
    joining: JoiningTuning = Field(default_factory=JoiningTuning)
    """Blocks joined again."""
