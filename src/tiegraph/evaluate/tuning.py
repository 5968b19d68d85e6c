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
    min_drift_m: float = Field(5.0, gt=0)
    """Below this travelled distance a drift per 100 m means nothing."""


class CloudTuning(Section):
    """A cloud against a reference cloud (`clouds/`)."""

    tile_points: int = Field(2_000_000, gt=0)
    """Of both clouds in a tile, at most: with halo and search trees about 0.7 GiB."""
    steps: int = Field(4, gt=0)
    """Distances at which clouds are judged where none are given: so many of the series 1, 2, 5, 10, the first not
    below the ground sampling distance."""
    ghost_factor: float = Field(5.0, gt=0)
    """A ghost is further from the reference than this many times the least distance, as the tables of 3D benchmarks
    have it, and ..."""
    ghost_spacings: float = Field(3.0, gt=0)
    """... than so many of the reference's spacings, lest its gaps make ghosts."""
    observed_factor: float = Field(4.0, ge=1)
    """The reference observed where it has points within so many times that distance in plan: a smaller one would excuse
    walls in the wrong place, a larger one calls more of what lies beyond its border wrong."""
    search_factor: float = Field(10.0, ge=1)
    """Nearest points are looked for up to this many times the largest distance."""


class M3c2Tuning(Section):
    """Differences along the normal (`clouds/m3c2.py`); Lague, Brodu, Leroux 2013."""

    radius_spacings: float = Field(5.0, gt=0)
    """Radius of the cylinder in spacings of the thinner cloud: 20 points of a random cloud lie in it."""
    normal_radii: float = Field(2.0, ge=1)
    """Radius in which the normal is found, in radii of the cylinder."""
    depth_radii: float = Field(6.0, ge=1)
    """How far the cylinder reaches to either side, in its radii: larger differences are not found."""
    least_points: int = Field(10, ge=2)
    """Of each cloud in a cylinder: with fewer the spread does not tell the level of detection."""


class RegistrationTuning(Section):
    """A cloud laid on another by ICP (`clouds/register.py`)."""

    coarse: CoarseTuning = Field(default_factory=CoarseTuning)
    """A start by the clouds' shapes."""
    points: int = Field(200_000, gt=0)
    """Of either cloud that take part, at most."""
    normal_neighbours: int = Field(20, ge=3)
    """Points that tell the normal of a point of the reference."""
    reach_spacings: tuple[float, ...] = (40.0, 20.0, 10.0, 5.0)
    """To the nearest point at most, in spacings of what takes part, one after another."""
    least_points: int = Field(100, ge=7)
    """Pairs of points, to go on."""
    open_share: float = Field(0.005, gt=0)
    """Smallest to largest eigenvalue of the equations, all unknowns in metres of motion, below which surfaces slide:
    noise of the normals alone makes 0.0005 of a plane and 0.0024 of a corridor, a corner has 0.08."""


class ChangesTuning(Section):
    """What has changed between two epochs (`clouds/m3c2.py`)."""

    link_spacings: float = Field(2.0, gt=1)
    """Significant core points this near, in spacings of core points, are one change."""
    least_cores: int = Field(12, gt=0)
    """Of a change that is listed: fewer stand together by chance (5 % of unchanged ones are called significant)."""
    area_spacings: float = Field(3.0, gt=1)
    """Core points within so many spacings tell what area one stands for."""


class PassesTuning(Section):
    """The clouds of two passes of one run against each other (`clouds/judge.py`)."""

    maps: int = Field(40, gt=0)
    """Depth maps of either pass that the stage `cloud` compares, at most, which bounds its time; `compare --passes`
    takes all of them."""
    places: int = Field(5, gt=0)
    """Of more, those near so many places, spread evenly along the way."""
    cores: int = Field(5000, gt=0)
    """Core points, about: median and spread of so many are known to a fiftieth of the spread."""


class JudgeTuning(Section):
    """References against what was predicted (`survey.py`)."""

    beyond_sigmas: float = Field(3.0, gt=0)
    """An error beyond so many of its predicted sigmas contradicts."""
    counted: int = Field(6, gt=2)
    """Poses that count at most in the test of what explains an error: errors of neighbours are alike."""
    whole: float = Field(0.7, ge=0, le=1)
    """Share of the images that must be registered: a torn or thin model may be a mirror image itself."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    points_tried: int = Field(100_000, gt=0)
    """Points of the cloud projected back in each view; others in the next, so that the whole cloud takes part."""
    carrier_m: float = Field(0.1, gt=0)
    """Positions stated to this or better are of a carrier phase (RTK, PPK): code alone gives a metre."""
    min_checks: int = Field(3, gt=0)
    """Check points that may hold a tolerance: fewer say hardly anything of a survey (ASPRS asks for 30)."""
    unscaled_share: float = Field(0.1, ge=0)
    """A model whose scale is further off than this share was never metric."""
    trajectory: TrajectoryTuning = Field(default_factory=TrajectoryTuning)
    """Reference poses."""
    cloud: CloudTuning = Field(default_factory=CloudTuning)
    """Reference clouds."""
    m3c2: M3c2Tuning = Field(default_factory=M3c2Tuning)
    """Differences along the normal."""
    registration: RegistrationTuning = Field(default_factory=RegistrationTuning)
    """A cloud laid on another."""
    changes: ChangesTuning = Field(default_factory=ChangesTuning)
    """What has changed."""
    passes: PassesTuning = Field(default_factory=PassesTuning)
    """Two passes of one run."""
    judge: JudgeTuning = Field(default_factory=JudgeTuning)
    """What contradicts."""
