"""What masks decide by: each constant with its unit, its meaning and where its value comes from.

The groups of what is learnt, from matches to water, stand in `tuning_learnt.py`.
"""

from pydantic import Field

from tiegraph.masks.tuning_learnt import (
    AppearanceTuning,
    ClassificationTuning,
    LabelTuning,
    MatchabilityTuning,
    ProofTuning,
    RegionsTuning,
    SkylineTuning,
    WaterTuning,
)
from tiegraph.settings import Section


class FramesTuning(Section):
    """How images are read, and which two of a camera are compared (`frames.py`)."""

    work_px: int = Field(640, gt=0)
    """Longer side at which masks are computed; all sizes in pixels refer to it where they name no other."""
    look_px: int = Field(320, gt=0)
    """Longer side at which appearance is learnt and looked up."""
    compare_px: int = Field(320, gt=0)
    """Longer side at which two frames are compared for what has moved."""
    equal_grey: float = Field(1.0, ge=0)
    """Two frames whose grey values differ less than this on average are one picture, not two."""
    most_tries: int = Field(12, gt=0)
    """Unreadable, differently sized or equal frames passed over before a camera is given up."""


class MovedTuning(Section):
    """What of the texture moved between two frames (`platform.py`, `quality.py`); sizes at `frames.compare_px`."""

    dark_grey: float = Field(10.0, gt=0)
    """Added to the grey values before their logarithm: so dark, noise is no contrast."""
    detail_sigma_px: float = Field(4.0, gt=0)
    """What is coarser is no detail."""
    window_sigma_px: float = Field(3.0, gt=0)
    """Neighbourhood in which contrast and correlation are taken."""
    contrast_noise: float = Field(0.01, gt=0)
    """Contrast in log grey that counts half when the contrast is taken out."""
    alike_noise: float = Field(0.02, gt=0)
    """Added to the denominator of the correlation."""
    texture: float = Field(0.03, ge=0)
    """Contrast in log grey that counts as texture."""
    alike: float = Field(0.5, ge=-1, le=1)
    """Correlation from which texture counts as unchanged."""


class QualityTuning(Section):
    """Images that are hardly worth keeping (`quality.py`)."""

    blurred: float = Field(0.5, ge=0)
    """An image is blurred if its sharpness is below this share of the median of its neighbours in the sequence."""
    similar: float = Field(0.05, ge=0, le=1)
    """An image is similar if less than this share of its textured area moved since the one before."""
    neighbours: int = Field(4, gt=0)
    """Images to each side that are its neighbours."""
    least_neighbours: int = Field(2, gt=0)
    """Neighbours whose sharpness must be known, or none is blurred against them."""
    min_used: float = Field(0.02, ge=0, le=1)
    """Share of the image that must be used for a figure."""
    fine_sigma_px: float = Field(0.7, gt=0)
    """Noise of the pixels that is taken out first. Sharpness is detail of one pixel against detail of four: blur takes
    the first away, darkness and haze take both."""
    medium_sigma_px: float = Field(1.4, gt=0)
    """Between fine and medium lies the detail of one pixel ..."""
    coarse_sigma_px: float = Field(5.6, gt=0)
    """... and between medium and coarse that of four."""
    rim_px: int = Field(9, gt=0)
    """Side of the square by which the used area is shrunk: the edge of the mask is no detail."""


class PlatformTuning(Section):
    """The platform in the picture (`platform.py`); gradients in grey levels times the Sobel gain of 8."""

    max_read: int = Field(160, gt=0)
    """Frames looked at when choosing those that differ."""
    min_moved: float = Field(0.4, ge=0, le=1)
    """Of the textured area must have changed between two frames that count as different."""
    min_frames: int = Field(6, gt=0)
    """Frames that differ from each other which a camera needs before anything is called platform."""
    max_frames: int = Field(28, gt=0)
    """Different frames that are used: more add time and no certainty."""
    smooth_sigma_px: float = Field(0.8, gt=0)
    """Blur before gradients are taken."""
    gradient_noise: float = Field(14.0, gt=0)
    """A gradient this strong counts half."""
    clear_gradient: float = Field(0.5, ge=0, le=1)
    """Share of its full weight from which the gradient of a frame is texture, and may depart from the others."""
    same_cosine: float = Field(0.5, ge=-1, le=1)
    """Of the angle to the mean direction of the other frames; below, a gradient departs from them."""
    min_strength: float = Field(0.3, ge=0, le=1)
    """Mean weight of the gradients over the frames from which a pixel has a direction at all."""
    strength_noise: float = Field(0.15, gt=0)
    """Added to that mean weight where the coherence is divided by it: weak edges are less coherent."""
    coherent: float = Field(0.6, ge=0, le=1)
    """Length of the mean gradient direction over the frames from which a pixel is an edge of the platform ..."""
    very_coherent: float = Field(0.75, ge=0, le=1)
    """... and from which it may shake more."""
    still_px: float = Field(0.35, ge=0)
    """How far an edge may shake: camera shake moves a far scene by more."""
    still_coherent_px: float = Field(0.5, ge=0)
    """How far a very coherent edge may."""
    shakes_px: float = Field(0.7, ge=0)
    """A coherent edge that shakes by more moves."""
    shake_frames: int = Field(14, gt=0)
    """Frames by which shake is measured: enough for a median and for the 70 % of it."""
    shake_share: float = Field(0.7, ge=0, le=1)
    """Share of the frames that move less than the shake."""
    shake_detail_sigma_px: float = Field(5.0, gt=0)
    """What is coarser is no detail that could shake."""
    shake_contrast_sigma_px: float = Field(7.0, gt=0)
    """Neighbourhood whose contrast is taken out of the detail."""
    shake_contrast_grey: float = Field(3.0, gt=0)
    """Contrast that counts half then: less is noise."""
    shake_window_sigma_px: float = Field(4.0, gt=0)
    """Neighbourhood that shakes as one."""
    shake_energy: float = Field(1e-4, gt=0)
    """Added to the energy of the gradients: where there is hardly any texture, nothing shakes."""
    moving: float = Field(0.45, ge=0, le=1)
    """Share of the textured frames in which the gradient has another direction, from which a place moves."""
    moving_sigma_px: float = Field(3.0, gt=0)
    """Neighbourhood in which this share is taken."""
    moving_noise: float = Field(0.06, gt=0)
    """Added to the share of textured frames: where hardly any is, nothing moves."""
    min_edge_px: int = Field(16, ge=0)
    """Shorter edges are chance."""
    join_px: int = Field(3, gt=0)
    """Side of the square that joins the pieces of an edge before its length is taken."""
    open_px: int = Field(3, gt=0)
    """Side of the square in which regions and the platform are opened: thinner bits go."""
    close_px: int = Field(7, gt=0)
    """Side of the square in which the gaps between edges and inside are closed."""
    outline: float = Field(0.35, ge=0, le=1)
    """Share of a region's outline that must be fixed edges; on scenes without platform 0 .. 0.14, dark roads 0.34."""
    outline_reach_px: int = Field(7, gt=0)
    """Side of the square by which fixed edges are grown to meet an outline."""
    min_region_px: int = Field(40, ge=0)
    """Pixels of a region: a smaller one is not judged by its outline."""
    rim: float = Field(2 / 640, ge=0)
    """Of the longer side: the gradients are smoothed, and their kernel is three pixels wide."""
    railing_px: int = Field(2, ge=0)
    """Wider than the rim by this: what is narrower than both, a railing, keeps its rim."""
    min_area: float = Field(0.003, ge=0, le=1)
    """Of the image: smaller parts at its border are no platform."""
    few_frames: int = Field(10, ge=0)
    """Fewer frames agree by chance, at a pole straight ahead ..."""
    few_area: float = Field(0.03, ge=0, le=1)
    """... up to 0.02 of the image: of so few frames, this is the least area of the platform's parts."""
    max_enclosed_area: float = Field(0.06, ge=0, le=1)
    """Of the image: a larger hole of the platform is a window on the scene."""
    max_enclosed_moving: float = Field(0.58, ge=0)
    """Mean share of frames in which a hole moves: the view through a railing moves more, and stays."""
    pinhole_area: float = Field(0.0005, ge=0, le=1)
    """Of the image: smaller holes are platform whatever they show."""
    steady_grey: float = Field(14.0, ge=0)
    """Range of the grey value over the frames, whatever the light: black boxes, burnt-out decks."""
    range_left_out_percent: float = Field(10.0, ge=0, lt=50)
    """Of the frames, at either end of that range."""
    range_sigma_px: float = Field(1.0, gt=0)
    """Blur before that range is taken, at half the size."""
    black_grey: float = Field(12.0, ge=0)
    """Brightest grey value of what is black in every frame: round the image of a fisheye lens nothing is ever seen."""
    surround: float = Field(4 / 640, ge=0)
    """Of the longer side: blur of that surround's rim."""


class Meguro2024Tuning(Section):
    """Masks from the difference of two images (`tiegraph.papers.meguro2024`); paper 000 gives no sizes."""

    square_px: int = Field(7, gt=0)
    """Structuring element of opening and closing."""
    min_area: float = Field(0.005, ge=0, le=1)
    """Of the image: smaller areas, white or black, change colour."""


class Meguro2025Tuning(Section):
    """Masks from structural similarity, and the sky by Sobel edges (`tiegraph.papers.meguro2025`); paper 001 gives no
    sizes."""

    block_px: int = Field(8, gt=0)
    """Side of the blocks of both stages."""
    min_block: float = Field(0.5, ge=0, le=1)
    """Share of masked pixels from which a block is masked."""
    min_region_blocks: int = Field(24, ge=0)
    """Smaller regions of masked blocks are used: 0.5 % of 640 x 480."""
    blue_low: tuple[int, int, int] = (90, 80, 150)
    """Hue, saturation and brightness of sky blue, at least, "typical range of sky colors" in the paper. OpenCV's hue is
    in half degrees, so blue is 180-260 degrees. Saturation below 80 takes in walls that lie in the shade of a blue sky:
    from 40 on, 27 % of the Strecha facades, from 80 on 2.5 %, while the sky of CamVid and of the rendered canal is
    found nearly as well ..."""
    blue_high: tuple[int, int, int] = (130, 255, 255)
    """... and at most."""


class WaterlineTuning(Section):
    """The waterline from geometry (`waterline.py`)."""

    column_px: int = Field(8, gt=0)
    """The bank is sought in every such column of the reduced image."""
    hidden_px: int = Field(3, ge=0)
    """Above the first row of water: where the platform is there, it hides the bank."""
    cells: int = Field(400, gt=0)
    """Of the plan along its longer side."""
    full: int = Field(2, gt=0)
    """Points in a cell and its neighbours from which it is bank."""
    step_cells: float = Field(1.5, gt=0)
    """A step along a ray."""
    first_step: int = Field(2, ge=0)
    """Steps from the camera at which a bank is first sought."""
    rounds: int = Field(2, gt=0)
    """First the banks are all points round the cameras' height, then those just above the water found before."""
    first_level: float = Field(0.05, ge=0, le=1)
    """Of the points below the cameras that lie below the water, to begin with."""
    band: float = Field(1.5, gt=0)
    """Bank: points less than this many camera heights above the water."""
    reach_bands: float = Field(10.0, gt=0)
    """How far from the cameras points are bank, if the cameras' path is not longer."""
    level_slope: float = Field(0.02, ge=0)
    """Flatter rays meet the plane too far off to measure its height."""
    least_heights: int = Field(100, gt=0)
    """Waterline rays that met a bank, before a height is believed."""
    most_spread: float = Field(0.35, ge=0)
    """Of the height below the cameras: half width of the middle half of what single rays say."""
    lower_slope: float = Field(0.05, ge=0)
    """From which a ray certainly goes down: up is known to about 3 degrees."""
    widest_gap: float = Field(0.5, ge=0, le=1)
    """Of the width: so many columns without a bank are bridged."""


class SkyPointsTuning(Section):
    """Sky that cannot be sky, as the model has points there (`skyline.py`)."""

    dense: float = Field(0.2, ge=0)
    """Density of points within a piece of sky, with the holes in it, as a share of that outside of all sky: 0 .. 0.04
    in the rendered canal, up to 0.17 where trees stand before the sky (PandaSet, KITTI), 0.14 .. 1 on walls with
    windows."""
    least_points: int = Field(4, gt=0)
    """In a piece of sky, or it stays."""
    hole: float = Field(0.05, ge=0)
    """Of the longer side: windows in a piece of sky, that are filled."""
    edge: float = Field(0.011, ge=0)
    """Of the longer side: blur of the skyline, that is left out."""
    joint: float = Field(0.008, ge=0)
    """Of the longer side: what joins two pieces of sky."""
    widest: float = Field(3.0, gt=0)
    """Tangent of the angle off the axis up to which lens models are to be trusted."""


class RefineTuning(Section):
    """What of the model corrects the first masks (`pipeline/refine.py`)."""

    most_views: int = Field(240, gt=0)
    """Views whose waterlines measure the water's height."""
    least_track: int = Field(3, gt=0)
    """Images that must see a point for it to be believed."""
    most_points: int = Field(20_000, gt=1)
    """The nearest, that are looked for in the sky of an image."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    auto_frames: int = Field(5, gt=0)
    """Frames every camera must have before ``source = auto`` learns masks from them."""
    fisheye_half_deg: float = Field(89.0, gt=0, lt=90)
    """Off the axis, what of a fisheye image is used that is not cut into views: farther out COLMAP has no rays. With 80
    kerry_park_360rig, whole, fell apart (417 points; 755 with 89)."""
    frames: FramesTuning = Field(default_factory=FramesTuning)
    """Reading images."""
    moved: MovedTuning = Field(default_factory=MovedTuning)
    """What moved between two frames."""
    quality: QualityTuning = Field(default_factory=QualityTuning)
    """Images hardly worth keeping."""
    platform: PlatformTuning = Field(default_factory=PlatformTuning)
    """The platform."""
    matchability: MatchabilityTuning = Field(default_factory=MatchabilityTuning)
    """What matches, and how near it is."""
    proof: ProofTuning = Field(default_factory=ProofTuning)
    """What refutes a class."""
    appearance: AppearanceTuning = Field(default_factory=AppearanceTuning)
    """What classes look like."""
    skyline: SkylineTuning = Field(default_factory=SkylineTuning)
    """The border of the sky."""
    labels: LabelTuning = Field(default_factory=LabelTuning)
    """What is certain in single images, and what they agree on."""
    regions: RegionsTuning = Field(default_factory=RegionsTuning)
    """Regions without an edge."""
    classification: ClassificationTuning = Field(default_factory=ClassificationTuning)
    """Looking up an image."""
    water: WaterTuning = Field(default_factory=WaterTuning)
    """Water before any model."""
    meguro2024: Meguro2024Tuning = Field(default_factory=Meguro2024Tuning)
    """The recipe of paper 000, where it prints no number."""
    meguro2025: Meguro2025Tuning = Field(default_factory=Meguro2025Tuning)
    """The recipe of paper 001, where it prints no number."""
    waterline: WaterlineTuning = Field(default_factory=WaterlineTuning)
    """Water by the model."""
    sky_points: SkyPointsTuning = Field(default_factory=SkyPointsTuning)
    """Sky that the model contradicts."""
    refine: RefineTuning = Field(default_factory=RefineTuning)
    """What the model is asked."""
