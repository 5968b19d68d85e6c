"""What the adjustment of scans decides by: each constant with unit, meaning and origin."""

from pydantic import Field

from tiegraph.settings import Section


class AdjustTuning(Section):
    """The adjustment of scans by planes (`odometry.py`). Measured on `canal` and `pandaset` (docs/lidar.md)."""

    window: int = Field(40, ge=4)
    """Scans adjusted together; the first half of a later window is held: 4 s at 10 Hz."""
    stages: tuple[tuple[float, float], ...] = ((2.0, 0.3), (2.0, 0.2), (1.0, 0.15), (1.0, 0.1), (1.0, 0.06),
                                               (0.5, 0.05), (0.5, 0.05), (0.5, 0.05))  # fmt: skip
    """Side of the voxels and the most that their points may scatter about a plane, m: from what odometry leaves to
    twice the noise of a scanner."""
    sigma_m: float = Field(0.02, gt=0)
    """Noise of a range: of Velodyne's and Hesai's data sheets."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    adjust: AdjustTuning = Field(default_factory=AdjustTuning)
