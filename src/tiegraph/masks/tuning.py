"""Constants of masks, each with its unit, its meaning and the source of its value."""

from typing import Annotated

from pydantic import Field

from tiegraph.settings import Section

_Count = Annotated[int, Field(gt=0)]


class FramesTuning(Section):
    """Reading of images, and the two of a camera that are compared (`frames.py`)."""

    work_px: int = Field(640, gt=0)
    """Longer side at which masks are computed; all sizes in pixels refer to it where they name no other."""

    @property
    def look_px(self) -> int:
        """Longer side at which appearance is learnt and looked up, and two frames are compared for motion."""
        return self.work_px // 2


class QualityTuning(Section):
    """Images that are hardly worth keeping (`platform.py`)."""

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
    """The platform in the picture, and the motion of the texture between two frames, which is measured at
    `frames.look_px` (`platform.py`); gradients in grey levels times the Sobel gain of 8."""

    dark_grey: float = Field(10.0, gt=0)
    """Added to the grey values before their logarithm: so dark, noise is no contrast."""
    window_sigma_px: float = Field(3.0, gt=0)
    """Neighbourhood for contrast and correlation."""
    texture: float = Field(0.03, ge=0)
    """Contrast in log grey that counts as texture."""
    alike: float = Field(0.5, ge=-1, le=1)
    """Correlation from which texture counts as unchanged."""
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


class MatchabilityTuning(Section):
    """Matches in neighbouring frames, and their distance (`matchability.py`)."""

    most_pairs: int = Field(36, gt=0)
    """Pairs of neighbouring frames, of all cameras together, for learning which areas match."""
    match_px: int = Field(400, gt=0)
    """Longer side at which frames are matched."""
    most_features: int = Field(800, gt=0)
    """Of one frame."""
    contrast: float = Field(0.02, ge=0)
    """Threshold of SIFT: half of OpenCV's."""
    ratio: float = Field(0.75, gt=0, le=1)
    """Ratio of the best and second best distance."""
    min_inliers: int = Field(20, gt=0)
    """With fewer matches the two frames show different scenes, and neither is used."""
    epipolar_px: float = Field(1.0, gt=0)
    """Tolerance of a match from its epipolar line."""
    around: int = Field(3, gt=1)
    """Neighbouring matches that predict the position of a feature without a match."""
    focals: tuple[float, ...] = Field((0.9, 1.4), min_length=1)
    """Focal lengths that are tried, of the longer side: no lens is known yet."""


class ProofTuning(Section):
    """Tests of a class before anything is masked (`matchability.py`)."""

    min_moving: float = Field(0.1, ge=0, le=1)
    """Share of the pairs of frames that must verify a motion before fixed parts are a platform."""
    near: float = Field(0.33, ge=0)
    """Share of the parallax at the scene's median depth: with more it is not sky."""
    refuted: float = Field(0.5, ge=0, le=1)
    """Share of near matches in a sky from which it is none."""
    least_matches: int = Field(3, gt=0)
    """Least matches in a class of all cameras for a decision."""
    inner_px: int = Field(21, gt=0)
    """Side of the square by which the edge of a sky is left out, at `frames.look_px`: it is that of trees and roofs,
    whose key points reach into it. With 7 of them the true skies of KITTI, PandaSet and kerry_park were refuted."""
    dense: float = Field(0.2, ge=0)
    """Share of the matches that an equal area of the images has: fewer are wires, lamps and tops of trees in a true sky
    (0.07 on PandaSet, 0.01 on kerry_park; where forest was taken for it, uav_bands, 0.32 and more)."""


class SkylineTuning(Section):
    """The sky of one image by its border, or above a camera that looks up (`skyline.py`)."""

    min_share: float = Field(0.02, ge=0, le=1)
    """Least share of the image that is sky ..."""
    rim_px: int = Field(3, gt=0)
    """Side of the square by which an accepted sky, and each calm area above an upward camera, loses its rim."""
    inner_px: int = Field(5, gt=0)
    """Side of the square over which texture is measured, and by which a sky is shrunk before its texture is, or its
    matched features are counted."""


class LabelTuning(Section):
    """Seeds of sky, water and scene in single images, and whether a sky lies above what is not sky (`learnt.py`), at
    `frames.look_px`."""

    images: int = Field(40, gt=0)
    """Images, of all cameras together, from which appearance is learnt."""
    least_images: int = Field(2, gt=0)
    """Images of each camera, however many there are."""
    matched_sky: float = Field(0.25, ge=0)
    """Matched features on a sky, as a share of those on an equal area of the image: with more it is none."""
    lower: float = Field(0.15, ge=0, le=1)
    """Share of the height, below all known sky: from there on is the ground ..."""
    wide: float = Field(0.12, ge=0, le=1)
    """Share of the image's width: narrower pieces of sky are no seeds."""
    agreed: float = Field(0.05, ge=0, le=1)
    """Share of the height: images whose lowest sky differs by less agree on the horizon."""
    places: tuple[_Count, _Count] = (12, 16)
    """Rows and columns of the map of places."""
    place_seeds: float = Field(0.5, gt=0)
    """Prior weight in images: as many for sky as for none at each place."""
    place_clip: float = Field(1.5, ge=0)
    """Limit of a place's log ratio."""
    min_down: float = Field(0.25, ge=-1, le=1)
    """Share of the length of all edges that faces down more than up: 0.4 and more for skies, also behind trees; 0.15
    and less of false ones, from the air, on facades and sand (benchmarks/masks/above.py)."""
    reach_px: int = Field(25, gt=0)
    """Side of the square over which the blur carries an edge: so near to what is not told, it is not its own."""


class ClassificationTuning(Section):
    """Classification of an image by a learnt table over colour, brightness and texture, and by regions without an edge
    inside (`classification.py`); at `frames.look_px` except the edge of the sky."""

    light_bins: int = Field(16, gt=0, le=256)
    """Bins of L."""
    colour_bins: int = Field(12, gt=0)
    """Bins of a and b each, about neutral."""
    texture_edges_grey: tuple[float, ...] = (0.8, 2.0, 4.5, 10.0)
    """Standard deviations of L between the bins of texture."""
    texture_px: int = Field(5, gt=0)
    """Side of the square over which this deviation is taken."""
    floor: float = Field(1e-5, gt=0)
    """Probability of a bin no seed ever fell into."""
    edge_grey: float = Field(4.0, gt=0)
    """Grey levels a pixel: skylines are stronger, most clouds are not."""
    edge_sigma_px: float = Field(0.7, gt=0)
    """Blur before this edge is searched."""
    region_share: float = Field(0.001, ge=0, le=1)
    """Share of the image: smaller regions do not decide about their pixels."""
    region_clip: float = Field(3.0, gt=0)
    """Limit of one pixel's log ratio for its region."""
    smooth_px: int = Field(5, gt=0)
    """Side of the square over which the log ratio of sky is averaged."""
    sky_credit: float = 1.0
    """Log ratio from which a place is sky."""
    sky_margin: float = Field(0.1, ge=0)
    """Of the height: so far below the lowest certain sky there may be some."""
    open_px: int = Field(3, gt=0)
    """Side of the square in which sky and burnt-out areas are opened: thinner parts are removed."""
    small: float = Field(0.002, ge=0, le=1)
    """Share of the image: smaller pieces of sky or holes in it are removed."""
    grow_window_px: int = Field(11, gt=0)
    """... side of the square over which its own brightness is taken there ..."""
    ring_px: int = Field(5, gt=0)
    """Side of the square by which a burnt-out area is grown to its surroundings."""
    edge_band_px: int = Field(9, gt=0)
    """Side of the square round its edge in which the edge of the sky is searched by the brightness."""
    edge_around_px: int = Field(10, ge=0)
    """To each side of a pixel: what its edge is learnt from."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Bins of L, a, b and texture."""
        return self.light_bins, self.colour_bins, self.colour_bins, len(self.texture_edges_grey) + 1

    @property
    def bins(self) -> int:
        """Bins of the whole table."""
        light, a, b, texture = self.shape
        return light * a * b * texture


class WaterTuning(Section):
    """Where features never match, and the line below which everything is water (`waterline.py`)."""

    grid: tuple[_Count, _Count] = (60, 80)
    """Rows and columns of the map of matches of a camera."""
    reach_cells: float = Field(1.5, gt=0)
    """Sigma of this map."""
    water_rate: float = Field(0.02, gt=0, lt=1)
    """Share of features found again in the next frame: 0.01 .. 0.03 on water (rendered canal) ..."""
    min_scene_rate: float = Field(0.025, gt=0, lt=1)
    """... on the scene 0.24 .. 0.38 there, 0.1 .. 0.25 on streets (PandaSet, KITTI); less at the sides, where the scene
    leaves the image: at least this ..."""
    max_scene_rate: float = Field(0.25, gt=0, lt=1)
    """... and at most this."""
    min_area: float = Field(0.02, ge=0, le=1)
    """Share of the image: a smaller zone is none."""
    highest: float = Field(0.25, ge=0, le=1)
    """Share of the height: a zone that reaches above it is no water seen from above."""
    zone_says: float = 8.0
    """Log of P(features | water) / P(features | scene) from which a camera has a zone."""
    least_cameras: int = Field(3, gt=0)
    """Level cameras needed before water is accepted without being asked for. A road ahead does not match either
    when the car is fast (KITTI, CamVid), so cameras that look one way only prove nothing; to the side a road
    matches."""
    least_share: float = Field(0.6, ge=0, le=1)
    """Share of them that must have a zone then ..."""
    least_says: float = 120.0
    """... and the least sum of these zones' log ratios."""
    prior_clip: float = Field(1.0, ge=0)
    """Limit of a place's log ratio."""
    block_px: tuple[_Count, _Count] = (4, 2)
    """Width and height of the blocks on which the line is found, at `frames.look_px`."""
    max_credit: float = Field(3.0, gt=0)
    """Limit of one pixel's log ratio for the line."""


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
    """Corrections of the first masks by the model."""

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
    quality: QualityTuning = Field(default_factory=QualityTuning)
    platform: PlatformTuning = Field(default_factory=PlatformTuning)
    matchability: MatchabilityTuning = Field(default_factory=MatchabilityTuning)
    proof: ProofTuning = Field(default_factory=ProofTuning)
    skyline: SkylineTuning = Field(default_factory=SkylineTuning)
    labels: LabelTuning = Field(default_factory=LabelTuning)
    classification: ClassificationTuning = Field(default_factory=ClassificationTuning)
    water: WaterTuning = Field(default_factory=WaterTuning)
    meguro2024: Meguro2024Tuning = Field(default_factory=Meguro2024Tuning)
    meguro2025: Meguro2025Tuning = Field(default_factory=Meguro2025Tuning)
    waterline: WaterlineTuning = Field(default_factory=WaterlineTuning)
    sky_points: SkyPointsTuning = Field(default_factory=SkyPointsTuning)
    refine: RefineTuning = Field(default_factory=RefineTuning)
