"""Constants of masks, each with its unit, its meaning and the source of its value."""

from typing import Annotated

from pydantic import Field

from tiegraph.settings import Section

_Count = Annotated[int, Field(gt=0)]
_Colour = tuple[int, int, int]


class QualityTuning(Section):
    """Images that are hardly worth keeping (`platform.py`)."""

    blurred: float = Field(0.5, ge=0)
    """An image is blurred if its sharpness is below this share of the median of its neighbours in the sequence."""
    similar: float = Field(0.05, ge=0, le=1)
    """An image is similar if less than this share of its textured area moved since the one before."""
    neighbours: int = Field(4, gt=0)
    """Images to each side that are its neighbours; of half as many the sharpness must be known."""


class PlatformTuning(Section):
    """The platform in the picture, and the motion of the texture between two frames, which is measured at
    `look_px` (`platform.py`); gradients in grey levels times the Sobel gain of 8."""

    window_sigma_px: float = Field(3.0, gt=0)
    """Neighbourhood for contrast, correlation and motion."""
    texture: float = Field(0.03, ge=0)
    """Contrast in log grey that counts as texture."""
    alike: float = Field(0.5, ge=-1, le=1)
    """Correlation from which texture counts as unchanged."""
    min_moved: float = Field(0.4, ge=0, le=1)
    """Share of the textured area that must have changed between two frames that count as different."""
    min_frames: int = Field(6, gt=0)
    """Different frames that a camera needs before anything is called platform, and frames that it must have before
    ``source = auto`` learns masks from them."""
    coherent: float = Field(0.6, ge=0, le=1)
    """Length of the mean gradient direction over the frames from which a pixel is an edge of the platform ..."""
    moving: float = Field(0.45, ge=0, le=1)
    """Share of the textured frames in which the gradient has another direction, from which a place moves."""
    left_out: float = Field(0.1, ge=0, lt=0.5)
    """Share of the frames left out at either end of the range of a place's brightness."""
    outline: float = Field(0.35, ge=0, le=1)
    """Share of a region's outline that must be fixed edges; on scenes without platform 0 .. 0.14, dark roads 0.34."""


class MatchabilityTuning(Section):
    """Matches in neighbouring frames at `look_px`, their distance, and what they prove (`matchability.py`)."""

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
    focals: tuple[float, ...] = Field((0.9, 1.4), min_length=1)
    """Focal lengths that are tried, of the longer side: no lens is known yet."""
    min_moving: float = Field(0.1, ge=0, le=1)
    """Share of the pairs of frames that must verify a motion before fixed parts are a platform."""
    near: float = Field(0.33, ge=0)
    """Share of the parallax at the scene's median depth: with more it is not sky."""


class SkyTuning(Section):
    """Appearance and place of the sky (`learnt.py`, `classification.py`) and the points in it (`skyline.py`)."""

    places: tuple[_Count, _Count] = (12, 16)
    """Rows and columns of the map of places."""
    wide: float = Field(0.12, ge=0, le=1)
    """Share of the image's width: narrower pieces of sky are no seeds. Without, a white house of KITTI is sky."""
    min_down: float = Field(0.25, ge=-1, le=1)
    """Share of the length of all edges that faces down more than up: 0.4 and more for skies, also behind trees; 0.15
    and less of false ones, from the air, on facades and sand."""
    horizon: float = Field(0.15, ge=0, le=1)
    """Of the height: images whose lowest sky differs by less agree on the horizon, so far below it there may be sky,
    and a pale area that does not reach farther down stands on no ground."""
    bins: int = Field(16, gt=0, le=256)
    """Bins of L, of a and of b, the latter two about neutral."""
    texture_edges_grey: tuple[float, ...] = (0.8, 2.0, 4.5, 10.0)
    """Standard deviations of L between the bins of texture."""
    unseen: float = Field(0.1, gt=0, lt=1)
    """Probability of all bins together, were no seed ever to fall into any."""
    edge_grey: float = Field(4.0, gt=0)
    """Grey levels a pixel: skylines are stronger, most clouds are not."""
    credit: float = 1.0
    """Log ratio from which a place is sky."""
    hole_px: int = Field(33, gt=0)
    """Side of the square: windows in a piece of sky, which are filled before the points of the model in it count. With
    42 the banks beside the sky were filled, and the sky of a rendered canal went (IoU 97 -> 68 %)."""
    widest: float = Field(3.0, gt=0)
    """Tangent of the angle off the axis up to which lens models are to be trusted."""


class WaterTuning(Section):
    """Where features never match, and the line below which everything is water (`waterline.py`)."""

    grid: tuple[_Count, _Count] = (60, 80)
    """Rows and columns of the map of matches of a camera, and of the blocks on which the line is found."""
    reach_cells: float = Field(1.5, gt=0)
    """Sigma of this map."""
    water_rate: float = Field(0.02, gt=0, lt=1)
    """Share of features found again in the next frame: 0.01 .. 0.03 on water (rendered canal) ..."""
    scene_rate: float = Field(0.25, gt=0, lt=1)
    """... on the scene 0.24 .. 0.38 there, 0.1 .. 0.25 on streets (PandaSet, KITTI), less at the sides, where the scene
    leaves the image: at most this."""
    zone_says: float = 8.0
    """Log of P(features | water) / P(features | scene) from which a camera has a zone."""
    least_says: float = 120.0
    """The least sum of these logs of most level cameras, of which there must be some ``witnesses``, before water is
    accepted without being asked for. A road ahead does not match either when the car is fast (KITTI, CamVid), so
    cameras that look one way only prove nothing; to the side a road matches."""
    cells: int = Field(400, gt=0)
    """Cells of the plan of the banks along its longer side."""
    band: float = Field(1.5, gt=0)
    """Bank: points less than this many camera heights above the water."""


class PapersTuning(Section):
    """Masks of papers 000 and 001 (`tiegraph.papers`), which give no sizes."""

    square_px: int = Field(7, gt=0)
    """Structuring element of opening and closing."""
    min_area: float = Field(0.005, ge=0, le=1)
    """Share of the image: smaller areas, white or black, change colour; smaller regions of masked blocks are used."""
    block_px: int = Field(8, gt=0)
    """Side of the blocks of both stages of paper 001."""
    min_block: float = Field(0.5, ge=0, le=1)
    """Share of masked pixels from which a block is masked."""
    blue_low: _Colour = (90, 80, 150)
    """Hue, saturation and brightness of sky blue, at least, "typical range of sky colors" in the paper. OpenCV's hue is
    in half degrees, so blue is 180-260 degrees. Saturation below 80 takes in walls that lie in the shade of a blue sky:
    from 40 on, 27 % of the Strecha facades, from 80 on 2.5 %, while the sky of CamVid and of the rendered canal is
    found nearly as well ..."""
    blue_high: _Colour = (130, 255, 255)
    """... and at most."""


class Tuning(Section):
    """Constants of the engine that are the same for every user: those that several of its parts share, then each
    part's own."""

    work_px: int = Field(640, gt=0)
    """Longer side at which masks are computed and the platform is learnt."""
    fisheye_half_deg: float = Field(89.0, gt=0, lt=90)
    """Used field angle of a whole fisheye image: farther off the axis COLMAP has no rays. With 80
    kerry_park_360rig, whole, fell apart (417 points; 755 with 89)."""
    samples: int = Field(40, gt=0)
    """Pairs of neighbouring frames, and images, of all cameras together, from which is learnt what matches, and how
    sky, water and scene look."""
    witnesses: int = Field(3, gt=1)
    """Least number that proves anything: matches in a class of all cameras, points in a piece of sky, images of a
    trusted point, points of a bank, matches that predict a motion, level cameras that show water."""
    dense: float = Field(0.2, ge=0)
    """Density of matches or points in a sky, as a share of that in an equal area outside, from which it is a surface.
    Matches: fewer are wires, lamps and tops of trees in a true sky (0.07 on PandaSet, 0.01 on kerry_park; where forest
    was taken for it, uav_bands, 0.32 and more). Points: 0 .. 0.04 in the rendered canal, up to 0.17 where trees stand
    before the sky (PandaSet, KITTI), 0.14 .. 1 on walls with windows."""
    small: float = Field(0.002, ge=0, le=1)
    """Share of the image: smaller pieces and holes of sky, parts of the platform and regions are noise ..."""
    part: float = Field(0.02, ge=0, le=1)
    """... and smaller skies, zones of water and used areas prove nothing."""
    fine_px: int = Field(3, gt=0)
    """Side of the square in which areas are opened, and by which those that are sure lose their rim ..."""
    window_px: int = Field(5, gt=0)
    """... over which brightness, texture and the log ratio of sky are averaged ..."""
    band_px: int = Field(11, gt=0)
    """... in which the edge of a mask may be wrong, and what it looks like is learnt ..."""
    reach_px: int = Field(21, gt=0)
    """... and by which the edge of a sky is left out, at `look_px`: it is that of trees and roofs, whose key points
    reach into it. With 7 of them the true skies of KITTI, PandaSet and kerry_park were refuted."""
    smooth_sigma_px: float = Field(0.8, gt=0)
    """Blur against the noise of pixels before gradients are taken."""
    faint_grey: float = Field(14.0, gt=0)
    """Grey levels: what is darker is black, and less difference of brightness tells nothing."""
    most_says: float = Field(3.0, gt=0)
    """Limit of one pixel's log ratio for its region or the line of the water; a third of it that of a place."""
    quality: QualityTuning = Field(default_factory=QualityTuning)
    platform: PlatformTuning = Field(default_factory=PlatformTuning)
    matchability: MatchabilityTuning = Field(default_factory=MatchabilityTuning)
    sky: SkyTuning = Field(default_factory=SkyTuning)
    water: WaterTuning = Field(default_factory=WaterTuning)
    papers: PapersTuning = Field(default_factory=PapersTuning)

    @property
    def look_px(self) -> int:
        """Longer side at which appearance is learnt and looked up, and two frames are compared."""
        return self.work_px // 2

    def each(self, cameras: int) -> int:
        """Samples of one of so many cameras, two at least."""
        return max(2, self.samples // max(1, cameras))
