"""What stations are joined by: each constant with unit, meaning and origin. Measured on synthetic stations round an
object, `rgbd_250` and `pandaset` (docs/stations.md)."""

from pydantic import Field

from tiegraph.geometry.coarse import CoarseTuning
from tiegraph.settings import Section


class PrecisionTuning(Section):
    """How far points lie from other stations' surfaces, by distance (`joined.py`)."""

    bands: int = Field(6, ge=1)
    """Of distance, at most."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    coarse: CoarseTuning = Field(default_factory=CoarseTuning)
    precision: PrecisionTuning = Field(default_factory=PrecisionTuning)
    all_pairs: int = Field(40, ge=2)
    """Clouds of which all pairs are tried; of more, those ..."""
    alike: int = Field(12, ge=1)
    """... with so many whose shapes are most alike, ..."""
    following: int = Field(3, ge=0)
    """... and so many that follow by name."""
