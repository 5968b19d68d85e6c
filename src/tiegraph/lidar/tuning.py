"""What LiDAR odometry and the hand-eye calibration decide by: each constant with unit, meaning and origin."""

from pydantic import Field

from tiegraph.settings import Section


class AdjustTuning(Section):
    """The adjustment of scans by planes (`adjust.py`). Measured on `canal` and `pandaset` (docs/lidar.md)."""

    window: int = Field(40, ge=4)
    """Scans adjusted together; the first half of a later window is held: 4 s at 10 Hz."""
    stages: tuple[tuple[float, float], ...] = ((2.0, 0.3), (2.0, 0.2), (1.0, 0.15), (1.0, 0.1), (1.0, 0.06),
                                               (0.5, 0.05), (0.5, 0.05), (0.5, 0.05))  # fmt: skip
    """Side of the voxels and the most that their points may scatter about a plane, m: from what odometry leaves to
    twice the noise of a scanner."""
    sigma_m: float = Field(0.02, gt=0)
    """Noise of a range: of Velodyne's and Hesai's data sheets."""


class HandEyeTuning(Section):
    """Clock offset and place of the LiDAR on the rig (`handeye.py`)."""

    search_s: float = Field(2.0, gt=0)
    """Clock offsets tried, on both sides of the start."""
    least_frames: int = Field(4, ge=3)
    """Frames within the LiDAR's times: fewer hold no place."""
    span_frames: tuple[int, ...] = (1, 2, 4, 8)
    """Motions between frames so many apart: drift of either side matters little over them."""
    sigma_deg: float = Field(0.05, gt=0)
    """First guess of the sigma of a relative turn ..."""
    sigma_m: float = Field(0.01, gt=0)
    """... and of a relative step; then they are measured by the residuals."""
    prior_place_m: float = Field(2.0, gt=0)
    """Sigma of the lever arm before anything is measured: LiDAR and cameras stand on one boat, car or person. It keeps
    what the motion leaves open near zero."""
    agree_sigmas: float = Field(4.0, gt=0)
    """The lever arm by points may differ by so many sigmas from that by the motion."""


class TieTuning(Section):
    """The run's points against the LiDAR's map (`pointtie.py`)."""

    reaches_m: tuple[float, ...] = (1.0, 0.5, 0.3, 0.15, 0.1)
    """Points that are nearer to a surface take part, in turn; at last within four sigmas of both sides' points."""
    least_sigma_m: float = Field(0.005, gt=0)
    """Lower bound of the sigma of a distance."""
    least_points: int = Field(200, ge=10)
    """Points that must be near a surface."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    adjust: AdjustTuning = Field(default_factory=AdjustTuning)
    hand_eye: HandEyeTuning = Field(default_factory=HandEyeTuning)
    tie: TieTuning = Field(default_factory=TieTuning)
