"""What evaluate decides by: each constant with its unit, its meaning and where its value comes from."""

from __future__ import annotations

from pydantic import Field

from tiegraph.settings import Section


class TrajectoryTuning(Section):
    """Poses against reference poses (`trajectory.py`, `reference.py`)."""

    max_gap_s: float = Field(2.0, gt=0)
    """A reference with a gap wider than this is not interpolated across it."""
    within_m: float = Field(0.3, gt=0)
    """An image nearer than this to its true place, after a robust alignment, is called right."""
    max_stretch: float = Field(1.5, ge=1)
    """Pairs of poses of the relative error are farther apart than the distance wanted by at most this factor."""
    between_poses: int = Field(1500, gt=1)
    """Of more, an even part tells the error of what lies between two: a million pairs."""
    relative_m: tuple[float, ...] = (1.0, 10.0, 100.0)
    """Travelled distances of the relative pose error."""
    min_drift_m: float = Field(5.0, gt=0)
    """Below this travelled distance a drift per 100 m means nothing."""


class CloudTuning(Section):
    """A cloud against a reference cloud (`cloud.py`)."""

    ghost_m: float = Field(0.5, gt=0)
    """A ghost is further than this from the reference: five times 0.10 m; the outline is widened by as much."""
    max_points: int = Field(12_000_000, gt=0)
    """Of a thinned cloud: a k-d tree of this many points takes about 1 GiB."""
    voxel_growth: float = Field(1.5, gt=1)
    """Factor by which the voxel grows until at most so many points are left."""
    read_points: int = Field(20_000_000, gt=0)
    """Points of a reference cloud that are taken, every n-th."""


class JudgeTuning(Section):
    """References against what was predicted (`contradictions.py`)."""

    beyond_sigmas: float = Field(3.0, gt=0)
    """An error beyond so many of its predicted sigmas contradicts."""
    explained: float = Field(3.0, ge=1)
    """Times smaller an error is under what explains it."""
    axis_decades: float = Field(4.0, gt=0)
    """By which an axis may differ in scale."""
    axis_starts: int = Field(33, gt=1)
    """Scales of an axis tried over these decades, up and down."""
    axis_bracket_decades: float = Field(0.3, gt=0)
    """On both sides of the best start, where the scale is sought: a little more than between two starts."""
    lag_rounds: int = Field(3, gt=0)
    """Rounds of alignment and lag in turn."""
    spacing_samples: int = Field(2000, gt=0)
    """Points of a reference cloud that tell its spacing."""


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
    trajectory: TrajectoryTuning = TrajectoryTuning()
    """Reference poses."""
    cloud: CloudTuning = CloudTuning()
    """Reference clouds."""
    judge: JudgeTuning = JudgeTuning()
    """What contradicts."""
