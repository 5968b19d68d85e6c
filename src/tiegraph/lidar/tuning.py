"""What LiDAR odometry and the hand-eye calibration decide by: each constant with unit, meaning and origin."""

from pydantic import Field

from tiegraph.settings import Section


class ScanTuning(Section):
    """What a scan can be (`scans.py`), and odometry by kiss-icp (`odometry.py`)."""

    least_scans: int = Field(2, ge=2)
    """Scans of a trajectory."""
    least_points: int = Field(50, gt=5)
    """Points of a scan at a place."""
    most_sweep_s: float = Field(2.0, gt=0)
    """A turn takes 0.05 to 0.2 s; more is another unit, or several scans."""
    voxel_share: float = Field(0.01, gt=0, lt=1)
    """Voxel of the local map, in the longest range: kiss-icp's own default."""
    gap_intervals: float = Field(5.0, gt=1)
    """A gap between scans of so many usual intervals is told: constant motion across it may not hold."""


class AdjustTuning(Section):
    """The adjustment of scans by planes (`adjust.py`). Measured on `canal` and `pandaset` (docs/lidar.md)."""

    window: int = Field(40, ge=4)
    """Scans adjusted together; the first half of a later window is held: 4 s at 10 Hz."""
    stages: tuple[tuple[float, float], ...] = ((2.0, 0.3), (2.0, 0.2), (1.0, 0.15), (1.0, 0.1), (1.0, 0.06),
                                               (0.5, 0.05), (0.5, 0.05), (0.5, 0.05))  # fmt: skip
    """Side of the voxels and the most that their points may scatter about a plane, m: from what odometry leaves to
    twice the noise of a scanner."""
    iterations: int = Field(2, ge=1)
    """Steps of Gauss-Newton with the voxels of a stage, at most; ..."""
    still: float = Field(1e-4, gt=0)
    """... fewer where no pose moves by more: 0.1 mm or 0.1 mrad."""
    thin_m: float = Field(0.1, gt=0)
    """One point a voxel of this size of each scan."""
    range_m: float = Field(60.0, gt=0)
    """Points further away are sparse and their spots wide."""
    sigma_m: float = Field(0.02, gt=0)
    """Noise of a range: of Velodyne's and Hesai's data sheets."""
    trim_sigmas: float = Field(3.0, gt=1)
    """A point further from its plane is none of it."""
    least_points: int = Field(12, ge=4)
    """Points of a plane."""
    flat: float = Field(0.04, gt=0, lt=1)
    """Smallest over middle eigenvalue of the scatter of a plane's points, at most."""
    wide: float = Field(0.08, gt=0, lt=1)
    """Scatter along the shorter direction of a plane in sides of its voxel, at least: a single ring is a line."""


class MapTuning(Section):
    """The map cloud (`odometry.py`)."""

    most_points: int = Field(20_000_000, gt=0)
    """Voxels held: 1 GiB. The voxel grows until there are fewer."""
    growth: float = Field(1.5, gt=1)
    """By this factor."""
    batch_points: int = Field(2_000_000, gt=0)
    """Points that are gathered before they are merged."""


class HandEyeTuning(Section):
    """Clock offset and place of the LiDAR on the rig (`handeye.py`)."""

    search_s: float = Field(2.0, gt=0)
    """Clock offsets tried, on both sides of the start ..."""
    search_step_s: float = Field(0.05, gt=0)
    """... in these steps; the best few are refined."""
    refined: int = Field(3, ge=1)
    """Starts that are refined."""
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
    least_sigma_deg: float = Field(0.002, gt=0)
    """Lower bounds of what is measured."""
    least_sigma_m: float = Field(0.0005, gt=0)
    """As above."""
    rounds: int = Field(4, ge=1)
    """Rounds of measuring the sigmas."""
    blocks: int = Field(6, ge=3)
    """Parts of the time, each left out once for the sigmas (jackknife)."""
    agree_sigmas: float = Field(4.0, gt=0)
    """The lever arm by points may differ by so many sigmas from that by the motion."""
    unlike_deg: float = Field(1.0, gt=0)
    """Turns of rig and LiDAR that differ by more (RMS) are hardly those of one survey."""
    open_time_s: float = Field(0.1, gt=0)
    """A sigma above these says that the data leave a parameter open: clock ..."""
    open_turn_deg: float = Field(2.0, gt=0)
    """... turn ..."""
    open_place_m: float = Field(0.5, gt=0)
    """... lever arm."""


class TieTuning(Section):
    """The run's points against the LiDAR's map (`pointtie.py`)."""

    thin_m: float = Field(0.2, gt=0)
    """Surfaces are sought about one point of the map a voxel of this size, ..."""
    neighbours: int = Field(24, ge=4)
    """... in so many neighbours ..."""
    radius_m: float = Field(0.8, gt=0)
    """... within this distance, ..."""
    thick_m: float = Field(0.05, gt=0)
    """... that scatter by no more about a plane, ..."""
    flat: float = Field(0.1, gt=0, lt=1)
    """... with a smallest eigenvalue of at most this share of the middle one, ..."""
    wide: float = Field(0.05, gt=0, lt=1)
    """... and a middle one of at least this share of the largest."""
    reaches_m: tuple[float, ...] = (1.0, 0.5, 0.3, 0.15, 0.1)
    """Points that are nearer to a surface take part, in turn; at last within four sigmas of both sides' points."""
    iterations: int = Field(10, ge=1)
    """Steps of each turn, at most; ..."""
    still: float = Field(1e-5, gt=0)
    """... fewer where one is smaller (m, rad)."""
    least_sigma_m: float = Field(0.005, gt=0)
    """Lower bound of the sigma of a distance."""
    least_points: int = Field(200, ge=10)
    """Points that must be near a surface."""
    least_facing: float = Field(0.002, gt=0, lt=1)
    """Mean square of the cosine between any direction and the normals, at least: below it normals face it by their
    noise only, such as along a bare tunnel."""
    cluster_m: float = Field(1.0, gt=0)
    """Points nearer to each other err together."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    scan: ScanTuning = Field(default_factory=ScanTuning)
    adjust: AdjustTuning = Field(default_factory=AdjustTuning)
    map: MapTuning = Field(default_factory=MapTuning)
    hand_eye: HandEyeTuning = Field(default_factory=HandEyeTuning)
    tie: TieTuning = Field(default_factory=TieTuning)
