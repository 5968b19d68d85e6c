"""Settings of the verb `tiegraph lidar`; there is no stage of it."""

from pathlib import Path

from pydantic import Field

from tiegraph.settings import Section


class LidarSettings(Section):
    """How scans are read, what is made of them, and what is known of the LiDAR's place on the rig."""

    columns: tuple[str, ...] = Field(("x", "y", "z", "intensity"), min_length=3)
    """Columns of a .bin, float32: x, y, z, and t for the time of a point (s); other names are passed over."""

    times: Path | None = None
    """Times of the scans, if not beside them: a number a line, a table with the column time, a list in a .json."""

    rate_hz: float | None = Field(None, gt=0, le=1000)
    """Scans a second, where nothing tells their times."""

    poses: Path | None = None
    """The scans are in the world of these poses (PandaSet's poses.json, TUM, KITTI), which are undone first."""

    near_m: float = Field(1.0, ge=0, le=1000)
    """Nearer points are of the vehicle itself."""

    far_m: float = Field(100.0, gt=0, le=10_000)
    """Further points are not used."""

    voxel_m: float = Field(0.1, gt=0, le=100)
    """One point of the map a voxel of this size."""

    adjust: bool = True
    """Adjust the scans by the planes that they share; without it the poses are kiss-icp's."""

    run: Path | None = None
    """A run folder of the same survey, to be compared with the LiDAR."""

    place: Path | None = None
    """Place of the LiDAR on the rig and clock offset: lidar.json of an earlier call; not estimated then."""

    clock_s: float | None = Field(None, ge=-1e11, le=1e11)
    """LiDAR time minus frame time (s); not estimated then."""
