"""What dense decides by: each constant with its unit, its meaning and where its value comes from."""

from typing import Literal

from pydantic import Field

from tiegraph.settings import Section


class ViewTuning(Section):
    """Undistorted images (`undistort.py`)."""

    max_growth: float = Field(1.3, gt=0)
    """Pixels of the undistorted image per pixel of the original: more only stretches the corners."""
    round_trip_px: float = Field(0.5, gt=0)
    """A ray that comes back from the image farther off lies where the distortion polynomial folds over."""
    averaged_below: float = Field(0.75, ge=0)
    """An image shrunk to less than this of its size is averaged over areas first, against aliasing."""


class PartnerTuning(Section):
    """Which images are matched with which (`neighbours.py`)."""

    min_shared: int = Field(10, gt=0)
    """Sparse points two images share; below, angle and scale are anyone's guess."""
    considered: int = Field(32, gt=0)
    """Candidates of an image that are looked at point by point."""
    points_a_pair: int = Field(300, gt=0)
    """Shared points looked at per pair."""
    max_angle_deg: float = Field(35.0, gt=0)
    """Median angle of intersection: semi-global matching fails on convergent images (paper 004, section 5.2.4)."""
    best_angles_deg: tuple[float, float] = (4.0, 12.0)
    """Full weight between these angles: intersection is sound, and the images still look alike."""
    least_narrow: float = Field(0.01, ge=0, le=1)
    """Weight that the narrowest angles keep: it falls from `best_angles_deg` in proportion to the angle."""
    wide_fall_deg: float = Field(10.0, gt=0)
    """Width of the Gaussian by which the weight falls beyond `best_angles_deg`."""
    max_scale: float = Field(2.0, ge=1)
    """Size of an object in one image over its size in the other, at most."""
    min_usable: float = Field(0.5, ge=0, le=1)
    """Share of the shared points outside the surroundings of the epipole."""
    enough: int = Field(2, gt=0)
    """A point seen by so many partners counts little for a further one: two confirm each other."""
    beyond_enough: float = Field(0.3, ge=0, le=1)
    """What it then counts."""
    witnesses: int = Field(8, ge=0)
    """Images whose depth maps are compared, partners included."""
    range_percent: float = Field(1.0, ge=0, lt=50)
    """Of the sparse points at either end of the depths are left out as possible errors."""
    near_margin: float = Field(2.0, ge=1)
    """Factor on the inverse depth at the near end: sparse points do not cover everything. Twice as near costs no time,
    because only the coarsest level is matched over the full range."""
    far_margin: float = Field(1.35, ge=1)
    """Factor on the depth at the far end."""


class ShotTuning(Section):
    """Partners of single shots, by geometry alone (`shot.py`)."""

    grid_points: int = Field(24, gt=0)
    """Pixels a side that stand for an image."""
    distances: int = Field(5, gt=1)
    """Distances between near and far at which they are looked at, even in inverse depth."""
    min_overlap: float = Field(0.1, ge=0, le=1)
    """Share of the reference that the partner sees."""
    near_baselines: float = Field(5.0, gt=0)
    """Nearest distance in longest baselines of the rig, where none is given: at 11.5 degrees images still look
    alike."""
    far_baselines: float = Field(100.0, gt=0)
    """Farthest distance in longest baselines, where none is given: at 0.6 degrees rays hardly intersect."""
    angle_percentile: float = Field(90.0, ge=0, le=100)
    """The angle of a pair is this percentile of its angles in the range: what is near can be measured though the far
    end cannot."""


class ShotScaleTuning(Section):
    """The unit of a model by the depth maps of shots (`shotscale.py`)."""

    rounds: int = Field(8, gt=1)
    """Steps of a point along its ray; at a parallax of 6 degrees each shrinks the error ten times on slopes of 45."""
    settled: float = Field(1e-3, gt=0)
    """Relative change of a point's scale in the last step, at most: 0.7 mm at 0.7 m; over a jump it changes by more."""
    least_points: int = Field(10, gt=0)
    """Points that must fall onto the depth maps of a shot, so that its median is better than a point by three."""
    grid: float = Field(0.04, gt=0)
    """Relative step of the units that are tried first; half of it is how well a depth must agree there: more than the
    error of a depth, less than that of a wrong unit."""
    beside: int = Field(2, ge=0)
    """So many units on either side of the best one share its points."""
    clearly: float = Field(1.5, ge=1)
    """The best unit has so many times the points of any other: points off the maps agree with any unit alike."""
    widest: float = Field(16.0, gt=1)
    """They reach from the ratio of the median depths over this to this ratio times this."""


class PairTuning(Section):
    """Rectified pairs, and their way back into the reference image (`engine.py`)."""

    max_disparities: int = Field(1024, gt=0, le=2047)
    """A pair with more is matched at a coarser resolution; the 16-bit fixed point of the matcher ends at 2047."""
    least_disparities: int = Field(16, gt=3)
    """So many are matched however large the images."""
    max_pixels_ratio: float = Field(1.5, gt=0)
    """Rectified pixels per pixel of the reference, at most."""
    blend_px: float = Field(1.0, ge=0)
    """Neighbouring disparities closer than this are interpolated, others are a depth jump."""
    range_margin: float = Field(2.0, ge=1)
    """Depths outside the range sought by more than this factor are dropped."""


class SgbmTuning(Section):
    """OpenCV's matcher (`sgbm.py`)."""

    block_px: int = Field(3, gt=0)
    """Side of the blocks compared. OpenCV's rule gives the penalties 72 and 288 for 3 x 3 blocks, the most exact ones
    on the Middlebury pairs; larger ones reach further over weak texture. The penalties lie between."""
    small_jump: int = Field(120, ge=0)
    """Penalty of a disparity step of one pixel (P1)."""
    large_jump: int = Field(480, ge=0)
    """Penalty of larger steps (P2)."""
    uniqueness_percent: int = Field(5, ge=0)
    """By which the best disparity must beat all but its neighbours."""
    prefilter_cap: int = Field(63, ge=0)
    """Bound of the gradients that are compared."""


class TsgmTuning(Section):
    """The hierarchical matcher (`tsgm.py`); benchmarks/dense/README.md says how its values were found."""

    radius_px: tuple[int, int] = (4, 3)
    """Of the census window, along the row and across."""
    small_jump: int = Field(20, ge=0)
    """Penalty of a disparity step of one pixel (P1)."""
    large_jump: int = Field(120, ge=0)
    """Penalty of larger steps (P2) where neighbouring pixels are equally bright."""
    large_floor: float = Field(0.25, ge=0, le=1)
    """P2 falls with the grey step between neighbours to this share of itself ..."""
    large_knee: float = Field(6.0, gt=0)
    """... from so many grey values on."""
    reach_px: int = Field(3, ge=0)
    """Pixels of the coarser level around a pixel whose disparities it is given."""
    margin_px: int = Field(1, ge=0)
    """Disparities added to these on both sides."""
    hole_disparities: int = Field(254, gt=0)
    """Disparities at most where the coarser level has none. 510 find thin bars a little better in the same time, but
    then no strip of 192 rows is sure to stay within 300 MB."""
    cost: Literal["census", "blend", "mutual"] = "blend"
    """On the last level census, mutual information or the mean of both, which beats census on seven of nine pairs."""
    mutual_span: float = Field(0.5, gt=0)
    """Span of the others' costs, as a share of the largest census cost."""
    full_disparities: int = Field(256, gt=0)
    """Disparities at most of the level that is matched over its full range."""
    dense_below: int = Field(16, ge=0)
    """With so few disparities there is one level only: ranges for each pixel save nothing."""
    strip_overlap_px: int = Field(64, gt=0)
    """Rows that strips of a level share: a path has nearly forgotten where it began."""
    everywhere: bool = False
    """Full size is matched over its full range too: a reference for measurements."""
    kernel: str = ""
    """Name of a native kernel, or cuda; empty = the fastest of this machine. All give the same."""


class SpeckleTuning(Section):
    """Small patches of disparity (`sgbm.py`)."""

    size_px: int = Field(100, ge=0)
    """Patches below 100 pixels ... (paper 004, section 5.2.2)"""
    jump_px: float = Field(1.0, gt=0)
    """... with jumps above 1 pixel are errors (the same)."""


class RayTuning(Section):
    """Partners and depth maps that say the same of a pixel (`triangulate.py`, `consistency.py`)."""

    max_relative: float = Field(0.05, gt=0)
    """However coarse a pair is, depths further apart than this share of the depth are not the same surface."""
    sigma_px: float = Field(0.3, gt=0)
    """One standard deviation of a disparity where an image cannot tell its own: 0.2-0.3 in paper 004, and the larger
    figure also covers the smoothing of slanted surfaces."""
    sigma_limits_px: tuple[float, float] = (0.1, 0.5)
    """Bounds of what an image tells of it."""
    shared_variance: float = Field(0.3, ge=0, lt=1)
    """Share of a disparity's variance that partners have in common, as they share the base image. On a rendered rig
    (exact truth) disparities err by 0.107-0.120 px and differ from each other by 0.085-0.099 px, on three images of
    canal by 0.15-0.23 and 0.11-0.24 px."""
    few_pixels: int = Field(1000, gt=0)
    """Pixels with two proposals; below, an image says nothing of its sigma."""
    refinements: int = Field(2, ge=0)
    """Rounds in which partners are judged again: two or three rays settle at once, four or five in two steps."""
    min_along: float = Field(0.3, gt=0, le=1)
    """Cosine-like: a witness looking across our ray does not move our depth by more than 1 / 0.3."""
    min_relative: float = Field(0.002, ge=0)
    """Agreement is never asked closer than this share of the depth: poses are not perfect."""
    vague_share: float = Field(0.005, ge=0)
    """A point whose sigma is more than this share of its depth needs one depth map more: where a pixel of disparity is
    a large share of the depth, depth maps agree by chance. On canal these were half of the ghosts and 2 % of the right
    depths."""
    through_tolerances: float = Field(1.5, ge=1)
    """A witness sees through a point when its surface lies this many tolerances behind."""


class NormalTuning(Section):
    """Surface normals (`depth.py`)."""

    radius_px: int = Field(3, gt=0)
    """Of the window a plane is fitted in: 7 x 7."""
    min_pixels: int = Field(12, ge=3)
    """Pixels of the window with a depth."""
    max_residual: float = Field(0.02, gt=0)
    """Root mean square of the plane's fit as a share of the depth: more is an edge, not a plane."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    views: ViewTuning = Field(default_factory=ViewTuning)
    """Undistorted images."""
    partners: PartnerTuning = Field(default_factory=PartnerTuning)
    """The choice of partners."""
    shots: ShotTuning = Field(default_factory=ShotTuning)
    """Single shots."""
    shot_scale: ShotScaleTuning = Field(default_factory=ShotScaleTuning)
    """The unit of a model by shots."""
    pairs: PairTuning = Field(default_factory=PairTuning)
    """Rectified pairs."""
    sgbm: SgbmTuning = Field(default_factory=SgbmTuning)
    """OpenCV's matcher."""
    tsgm: TsgmTuning = Field(default_factory=TsgmTuning)
    """The hierarchical matcher."""
    speckles: SpeckleTuning = Field(default_factory=SpeckleTuning)
    """What both matchers drop."""
    rays: RayTuning = Field(default_factory=RayTuning)
    """From disparities to depths that stand."""
    normals: NormalTuning = Field(default_factory=NormalTuning)
    """Surface normals."""
