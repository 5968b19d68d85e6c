"""What stations are joined by: each constant with unit, meaning and origin. Measured on synthetic stations round an
object, `rgbd_250` and `pandaset` (docs/stations.md)."""

from pydantic import Field

from tiegraph.geometry.coarse import CoarseTuning
from tiegraph.settings import Section


class PairTuning(Section):
    """Two clouds laid on each other (`pairs.py`). Lengths are in sides of the coarse voxels."""

    levels: tuple[float, ...] = (1.0, 0.5, 0.25)
    """Voxels of the refinement, one after another: the last has some 40 000 points a cloud."""
    reach: float = Field(2.5, gt=0)
    """To the nearest point at most, in voxels of the level, while it is refined ..."""
    meet: float = Field(1.2, gt=0)
    """... and to be counted as overlap: the means of two grids on one surface are at most so far apart."""
    normal_deg: float = Field(30.0, gt=0, lt=90)
    """Between the normals of points that meet."""
    iterations: int = Field(40, ge=1)
    """Of GICP, a level."""
    least_overlap: float = Field(0.2, gt=0, lt=1)
    """Share of the points of the cloud that overlaps more. Stations are planned for 30 to 60 %."""
    least_points: int = Field(200, ge=20)
    """Of a thinned cloud that lie on the other, and of a cloud altogether."""
    residual: float = Field(2.0, gt=1)
    """Robust sigma of the distances between surfaces over their own roughness, at most."""
    systematic: float = Field(0.4, gt=0)
    """Sigma of the shift over that of a residual, at most: where surfaces are not the same, residuals of a whole cell
    have one sign, and tens of thousands of points hold no better than one."""
    open_share: float = Field(0.001, gt=0)
    """Smallest to largest eigenvalue of the equations at the coarse level, below which surfaces slide: a plane, a
    sphere, a cylinder and an edge have 0.00007 to 0.0004, a relief of 10 mm on 0.4 m has 0.0024, objects 0.007."""
    rival: float = Field(0.7, gt=0, le=1)
    """Share of the surface that agrees in the next best place over that in the best, beyond which a pair fits in
    two: a surface of eight equal waves, shifted by one, has 0.75 to 0.85, other places of bumpy objects 0.5."""
    cells: int = Field(6, ge=2)
    """Along the longest side of an overlap: points in one cell are taken to err together."""


class SightTuning(Section):
    """What one saw where another looked through (`pairs.py`): told of a pair, it refuses none. Lengths are in sides of
    the coarse voxels."""

    neighbours: int = Field(4, ge=1)
    """Own points about the direction of another's, all of which must be beyond it."""
    apart: float = Field(1.5, gt=0)
    """From that direction at most, at their distance: farther, it is not in view (the border, a gap)."""
    before: float = Field(3.0, gt=0)
    """By how much the other's point stands nearer than all of them: noise, and surfaces seen at a low angle."""
    least_points: int = Field(50, ge=10)
    """In view, for a share to be told."""


class LoopTuning(Section):
    """Pairs judged together and adjusted (`loops.py`, `adjust.py`)."""

    close: float = Field(1.0, gt=0)
    """Loops of three close to this many coarse voxels, as mean motion of the points of a cloud."""
    alone_overlap: float = Field(0.3, gt=0, lt=1)
    """Of a pair in no loop, at least."""
    sure_loops: int = Field(2, ge=1)
    """Of three, that a pair closes in a group that is sure: one more than two wrong pairs and a right one make."""
    robust: float = Field(3.0, gt=0)
    """Sigmas from which on residuals of pairs count less (Cauchy)."""
    rounds: int = Field(3, ge=1)
    """Of looking for further overlapping pairs by the poses."""


class PrecisionTuning(Section):
    """How far points lie from other stations' surfaces, by distance (`precision.py`)."""

    asked: int = Field(20_000, gt=0)
    """Points of a shot that are asked, as they were measured."""
    oblique_deg: float = Field(60.0, gt=0, lt=90)
    """Between line of sight and surface normal, at most."""
    bands: int = Field(6, ge=1)
    """Of distance, at most ..."""
    least_points: int = Field(200, ge=10)
    """... with so many points each."""


class SpacingTuning(Section):
    """How far the points of a shot stand apart (`station.py`)."""

    asked: int = Field(10_000, gt=0)
    """Points of a shot that are asked, ..."""
    bands: int = Field(20, ge=1)
    """... in so many bands of distance, with equally many points."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    coarse: CoarseTuning = Field(default_factory=CoarseTuning)
    """Starts."""
    pair: PairTuning = Field(default_factory=PairTuning)
    """Pairs."""
    sight: SightTuning = Field(default_factory=SightTuning)
    """Free space."""
    loops: LoopTuning = Field(default_factory=LoopTuning)
    """Loops."""
    precision: PrecisionTuning = Field(default_factory=PrecisionTuning)
    """Precision by distance."""
    spacing: SpacingTuning = Field(default_factory=SpacingTuning)
    """Spacing of points."""
    read: int = Field(400_000, ge=1000)
    """Points of a cloud that the poses are made of, at most: the finest voxels are 40 000."""
    all_pairs: int = Field(40, ge=2)
    """Clouds of which all pairs are tried; of more, those ..."""
    alike: int = Field(12, ge=1)
    """... with so many whose shapes are most alike, ..."""
    following: int = Field(3, ge=0)
    """... and so many that follow by name."""
