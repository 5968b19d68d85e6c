"""What stations are joined by: each constant with unit, meaning and origin. Measured on synthetic stations round an
object, `rgbd_250` and `pandaset` (docs/stations.md)."""

from pydantic import Field

from tiegraph.geometry.coarse import CoarseTuning
from tiegraph.settings import Section


class PairTuning(Section):
    """Two clouds laid on each other (`pairs.py`). Lengths are in sides of the coarse voxels."""

    levels: tuple[float, ...] = (1.0, 0.5, 0.25)
    """Voxels of the refinement, one after another: the last has some 40 000 points a cloud."""
    meet: float = Field(1.2, gt=0)
    """To the nearest point at most, in voxels of the level, to be counted as overlap: the means of two grids on one
    surface are at most so far apart."""
    least_overlap: float = Field(0.2, gt=0, lt=1)
    """Share of the points of the cloud that overlaps more. Stations are planned for 30 to 60 %."""
    least_points: int = Field(200, ge=20)
    """Of a thinned cloud that lie on the other, of a cloud altogether, and of a band of distances."""
    residual: float = Field(2.0, gt=1)
    """Robust sigma of the distances between surfaces over their own roughness, at most."""


class PrecisionTuning(Section):
    """How far points lie from other stations' surfaces, by distance (`joined.py`)."""

    bands: int = Field(6, ge=1)
    """Of distance, at most."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    coarse: CoarseTuning = Field(default_factory=CoarseTuning)
    """Starts."""
    pair: PairTuning = Field(default_factory=PairTuning)
    """Pairs."""
    precision: PrecisionTuning = Field(default_factory=PrecisionTuning)
    """Precision by distance."""
    all_pairs: int = Field(40, ge=2)
    """Clouds of which all pairs are tried; of more, those ..."""
    alike: int = Field(12, ge=1)
    """... with so many whose shapes are most alike, ..."""
    following: int = Field(3, ge=0)
    """... and so many that follow by name."""
