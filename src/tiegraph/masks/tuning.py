"""Constants of masks, each with its unit, its meaning and the source of its value.

Those of the learnt classes, from matches to water, are in `tuning_learnt.py`.
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
    """Reading of images, and the two of a camera that are compared (`frames.py`)."""

    work_px: int = Field(640, gt=0)
    """Longer side at which masks are computed; all sizes in pixels refer to it where they name no other."""
    look_px: int = Field(320, gt=0)
    """Longer side at which appearance is learnt and looked up."""
    compare_px: int = Field(320, gt=0)
    """Longer side at which two frames are compared for motion."""


class MovedTuning(Section):
    """Motion of the texture between two frames (`platform.py`, `quality.py`); sizes at `frames.compare_px`."""

    dark_grey: float = Field(10.0, gt=0)
    """Added to the grey values before their logarithm: so dark, noise is no contrast."""
    window_sigma_px: float = Field(3.0, gt=0)
    """Neighbourhood for contrast and correlation."""
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
    rim_px: int = Field(9, gt=0)
    """Side of the square by which the used area is shrunk: the edge of the mask is no detail."""


class PlatformTuning(Section):
    """The platform in the picture (`platform.py`); gradients in grey levels times the Sobel gain of 8."""

    min_moved: float = Field(0.4, ge=0, le=1)
    """Share of the textured area that must have changed between two frames that count as different."""
    min_frames: int = Field(6, gt=0)
    """Different frames that a camera needs before anything is called platform."""
    smooth_sigma_px: float = Field(0.8, gt=0)
    """Blur before gradients are taken."""
    coherent: float = Field(0.6, ge=0, le=1)
    """Length of the mean gradient direction over the frames from which a pixel is an edge of the platform ..."""
    moving: float = Field(0.45, ge=0, le=1)
    """Share of the textured frames in which the gradient has another direction, from which a place moves."""
    open_px: int = Field(3, gt=0)
    """Side of the square in which regions and the platform are opened: thinner parts are removed."""
    outline: float = Field(0.35, ge=0, le=1)
    """Share of a region's outline that must be fixed edges; on scenes without platform 0 .. 0.14, dark roads 0.34."""
    rim: float = Field(2 / 640, ge=0)
    """Share of the longer side: the gradients are smoothed, and their kernel is three pixels wide."""
    min_area: float = Field(0.003, ge=0, le=1)
    """Share of the image: smaller parts at its border are no platform."""
    range_left_out_percent: float = Field(10.0, ge=0, lt=50)
    """Of the frames, at either end of that range."""


class Meguro2024Tuning(Section):
    """Masks from the difference of two images (`tiegraph.papers.meguro2024`); paper 000 gives no sizes."""

    square_px: int = Field(7, gt=0)
    """Structuring element of opening and closing."""
    min_area: float = Field(0.005, ge=0, le=1)
    """Share of the image: smaller areas, white or black, change colour."""


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
    """The bank is searched in every such column of the reduced image."""
    cells: int = Field(400, gt=0)
    """Cells of the plan along its longer side."""
    full: int = Field(2, gt=0)
    """Points in a cell and its neighbours from which it is bank."""
    rounds: int = Field(2, gt=0)
    """First the banks are all points round the cameras' height, then those just above the water found before."""
    band: float = Field(1.5, gt=0)
    """Bank: points less than this many camera heights above the water."""


class SkyPointsTuning(Section):
    """False sky, because the model has points there (`skyline.py`)."""

    dense: float = Field(0.2, ge=0)
    """Density of points within a piece of sky, with the holes in it, as a share of that outside of all sky: 0 .. 0.04
    in the rendered canal, up to 0.17 where trees stand before the sky (PandaSet, KITTI), 0.14 .. 1 on walls with
    windows."""
    least_points: int = Field(4, gt=0)
    """Least number of points in a piece of sky that is removed."""
    hole: float = Field(0.05, ge=0)
    """Share of the longer side: windows in a piece of sky, which are filled."""
    edge: float = Field(0.011, ge=0)
    """Share of the longer side: blur of the skyline, which is left out."""
    joint: float = Field(0.008, ge=0)
    """Share of the longer side: connections of two pieces of sky."""
    widest: float = Field(3.0, gt=0)
    """Tangent of the angle off the axis up to which lens models are to be trusted."""


class RefineTuning(Section):
    """Corrections of the first masks by the model (`pipeline/refine.py`)."""

    most_views: int = Field(240, gt=0)
    """Views whose waterlines measure the water's height."""
    least_track: int = Field(3, gt=0)
    """Least number of images that must see a trusted point."""
    most_points: int = Field(20_000, gt=1)
    """The nearest points, which are searched in the sky of an image."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    auto_frames: int = Field(5, gt=0)
    """Frames every camera must have before ``source = auto`` learns masks from them."""
    fisheye_half_deg: float = Field(89.0, gt=0, lt=90)
    """Used field angle of a whole fisheye image: farther off the axis COLMAP has no rays. With 80
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
