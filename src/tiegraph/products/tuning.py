"""Constants of products, each with its unit, its meaning and the source of its value."""

from pydantic import Field

from tiegraph.settings import Section


class ChooseTuning(Section):
    """The reference surfaces of a survey (`surface.py`)."""

    down: float = Field(0.5, ge=0, le=1)
    """Cameras look down if the mean of their view directions points down by this much at least: 60 deg off the
    vertical, or half of them straight down."""
    sideways_deg: float = Field(45.0, gt=0, le=90)
    """A camera looks sideways if it is at most this far off the horizon."""
    least_sideways: float = Field(0.25, ge=0, le=1)
    """Share of the cameras that must look sideways for a search of walls."""
    walls: int = Field(3, ge=1)
    """Largest number of elevations."""
    least_share: float = Field(0.1, gt=0, le=1)
    """Least share of the cloud's points on a wall: the third side of a lock has as much."""
    reach: float = Field(0.25, gt=0, le=1)
    """Largest distance of a wall's surface from its plane, as a share of the distance from which it was taken:
    balconies belong to it, the other bank does not."""
    flatness: float = Field(0.05, gt=0, le=1)
    """Points this near to a plane, as the same share, count for it."""
    upright_deg: float = Field(20.0, gt=0, le=90)
    """Normals of a wall's points deviate from that of its plane by at most this."""
    smooth: float = Field(4.0, gt=0)
    """Pieces of the alignment of an unrolled surface are as long as so many diameters of the tube or heights of the
    wall: arcs and clothoids of roads and railways are longer, settlements and bulges are shorter."""
    a_median: int = Field(30, gt=0)
    """Points for each median of a tube's profile: a bulge in fewer than half of its length does not count. With 30 of
    5000 points half of the errors of a box culvert are below 1.2 times the noise."""
    coarsest: float = Field(3.0, ge=1)
    """A raster reaches as far as images resolve the surface by this many of its pixels."""


class HeightTuning(Section):
    """From points to a surface (`heights.py`)."""

    shared: float = Field(10.0, ge=1)
    """Points of a cell with a common error, by the matcher's windows: on the walls of
    `canal_demo` points up to 5 spacings apart differ by 0.5 to 0.7 of their sigmas."""
    backward: float = Field(0.3, ge=0, le=1)
    """Points whose normals point this far away from w are not seen from outside: the underside of a bridge. The points
    of an underside itself point towards w by this much: the fronts of houses above the cameras do not belong to it."""
    hole_px: int = Field(5, ge=1, le=50)
    """Holes of up to about twice this width are interpolated, in pixels."""
    lone: int = Field(4, ge=1)
    """A pixel with fewer known ones within that distance is a stray."""


class TerrainTuning(Section):
    """The terrain below what stands on it (`terrain.py`): cell, slope and height above ground are those of PDAL's
    filters.smrf, the same filter."""

    lowest: float = Field(0.1, ge=0, le=0.5)
    """Height of a cell: the quantile of its pixels. Their minimum would be a stray or the noise; a tenth of a cell is a
    gap between leaves."""
    slope: float = Field(0.15, gt=0)
    """What an opening by a disc takes off in one step is an object if it is higher than this share of its radius."""
    above_m: float = Field(0.5, gt=0)
    """A pixel this high above the cells of the ground, and more on slopes, is not ground."""
    rim_px: int = Field(5, ge=0)
    """Pixels around an object that its edge may raise: the matcher's windows blur edges over a few."""


class ContourTuning(Section):
    """Contour lines (`terrain.py`)."""

    most_lines: float = Field(40.0, ge=1)
    """Lines between the lowest and the highest height at most: of 1, 2, 5, 10 ... one gives 16 to 40."""
    smooth_cells: float = Field(2.0, gt=0)
    """Lines are drawn on heights smoothed by a Gaussian of so many of their cells, half a terrain cell each: a metre at
    most, the width of the pen on a plan at 1:2000."""
    shortest_cells: float = Field(16.0, ge=0)
    """Lines shorter than so many cells are left out."""


class VolumeTuning(Section):
    """Volumes and their sigma (`volumes.py`)."""

    sectors: int = Field(16, ge=8)
    """Parts of that ring whose errors are taken as independent: enough for the sigma of a plane's three parameters to
    be good to a fifth, few enough for each to be longer than the errors of neighbours reach."""
    lowest: float = Field(0.01, ge=0, le=0.5)
    """The lowest ground is this quantile of the ring: the least of a thousand pixels is noise."""
    local_px: int = Field(10, ge=3)
    """Heights are compared with planes by a Gaussian of so many pixels, and the ground around a polygon is that far
    outside of it: twice as far as the matcher's windows share errors, and short enough for a heap to be a plane."""
    least_shared: float = Field(0.2, ge=0, lt=1)
    """A share of the variance that does not show as scatter counts from this on: less is the error of finding it."""


class OrthoTuning(Section):
    """True orthophoto (`ortho.py`)."""

    coarsest: float = Field(4.0, ge=1)
    """Images whose pixels are this many times larger than the raster's, or more, are not taken there."""
    angle_power: float = Field(2.0, ge=0)
    """The score of an image falls with the cosine of its angle to w to this power, ..."""
    border: float = Field(0.15, gt=0, lt=0.5)
    """... and nearer to the image border or mask than this share of the image size, in proportion."""
    unconfirmed: float = Field(0.01, ge=0, le=1)
    """Score of an image whose own depth map has no depth there, beside one that has the surface's: it may see something
    else, such as a bridge in front of a wall."""
    bands: int = Field(4, ge=0, le=8)
    """Bands of the blending of seams: colours are blended over 2^bands pixels, edges over few."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    choose: ChooseTuning = Field(default_factory=ChooseTuning)
    heights: HeightTuning = Field(default_factory=HeightTuning)
    terrain: TerrainTuning = Field(default_factory=TerrainTuning)
    contours: ContourTuning = Field(default_factory=ContourTuning)
    volumes: VolumeTuning = Field(default_factory=VolumeTuning)
    ortho: OrthoTuning = Field(default_factory=OrthoTuning)
