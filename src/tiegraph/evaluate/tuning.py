"""What evaluate decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.geometry.coarse import CoarseTuning
from tiegraph.settings import Section


class TrajectoryTuning(Section):
    """Poses against reference poses (`trajectory.py`, `reference.py`)."""

    max_gap_s: float = Field(2.0, gt=0)
    """A reference with a gap wider than this is not interpolated across it."""
    within_m: float = Field(0.3, gt=0)
    """An image nearer than this to its true place, after a robust alignment, is called right."""
    max_stretch: float = Field(1.5, ge=1)
    """Pairs of poses of the relative error are farther apart than the distance wanted by at most this factor."""
    relative_m: tuple[float, ...] = (1.0, 10.0, 100.0)
    """Travelled distances of the relative pose error."""


class CloudTuning(Section):
    """A cloud against a reference cloud (`clouds/`)."""

    tile_points: int = Field(2_000_000, gt=0)
    """Of both clouds in a tile, at most: with halo and search trees about 0.7 GiB."""


class M3c2Tuning(Section):
    """Differences along the normal (`clouds/m3c2.py`); Lague, Brodu, Leroux 2013."""

    normal_radii: float = Field(2.0, ge=1)
    """Radius in which the normal is found, in radii of the cylinder."""
    least_points: int = Field(10, ge=2)
    """Of each cloud in a cylinder: with fewer the spread does not tell the level of detection."""


class RegistrationTuning(Section):
    """A cloud laid on another by ICP (`clouds/register.py`)."""

    coarse: CoarseTuning = Field(default_factory=CoarseTuning)
    """A start by the clouds' shapes."""
    points: int = Field(200_000, gt=0)
    """Of either cloud that take part, at most."""
    least_points: int = Field(100, ge=7)
    """Pairs of points, to go on."""


class PassesTuning(Section):
    """The clouds of two passes of one run against each other (`clouds/judge.py`)."""

    maps: int = Field(40, gt=0)
    """Depth maps of either pass that the stage `cloud` compares, at most, which bounds its time; `compare --passes`
    takes all of them."""
    places: int = Field(5, gt=0)
    """Of more, those near so many places, spread evenly along the way."""
    cores: int = Field(5000, gt=0)
    """Core points, about: median and spread of so many are known to a fiftieth of the spread."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    points_tried: int = Field(100_000, gt=0)
    """Points of the cloud projected back in each view; others in the next, so that the whole cloud takes part."""
    min_checks: int = Field(3, gt=0)
    """Check points that may hold a tolerance: fewer say hardly anything of a survey (ASPRS asks for 30)."""
    trajectory: TrajectoryTuning = Field(default_factory=TrajectoryTuning)
    cloud: CloudTuning = Field(default_factory=CloudTuning)
    m3c2: M3c2Tuning = Field(default_factory=M3c2Tuning)
    registration: RegistrationTuning = Field(default_factory=RegistrationTuning)
    passes: PassesTuning = Field(default_factory=PassesTuning)
