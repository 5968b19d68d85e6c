"""Trajectory of a scanner by kiss-icp, one scan after another."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.errors import EngineMissing, InputError, ReconstructionError
from tiegraph.lidar.scans import Scan, first_of_voxels
from tiegraph.lidar.tuning import Tuning


@dataclass(frozen=True)
class ThinScan:
    """What is kept of a scan: the time of its pose, which is that of its last point; the pose by odometry (4, 4);
    points (N, 3) f4 as they were measured, and how long before the pose (N,) f4 s, <= 0, None = not known."""

    time_s: float
    pose: np.ndarray
    xyz_m: np.ndarray
    before_s: np.ndarray | None


def before_pose(scan: Scan) -> tuple[float, np.ndarray | None]:
    """Time of a scan's pose, and of its points from it (N,) <= 0."""
    if scan.offset_s is None or not np.ptp(scan.offset_s) > 0:
        return scan.stamp_s, None
    last = float(scan.offset_s.max())
    return scan.stamp_s + last, scan.offset_s - last


def odometry(scans: Iterator[Scan], near_m: float, far_m: float, tuning: Tuning) -> Iterator[ThinScan]:
    """Each scan with its pose in the frame of the first one.

    kiss-icp (Vizzo et al. 2023), on one thread, so that equal scans make equal poses. Raises EngineMissing without it,
    InputError for scans without points between the ranges, ReconstructionError where it loses its way.
    """
    engine = _engine(far_m, tuning)
    for scan in scans:
        reach = np.linalg.norm(scan.xyz_m, axis=1)
        seen = (reach >= near_m) & (reach <= far_m)
        if seen.sum() < tuning.scan.least_points:
            raise InputError(
                f"{scan.name}: {int(seen.sum())} points between {near_m:g} and {far_m:g} m (--near-m, --far-m), "
                f"{tuning.scan.least_points} are needed; the nearest is {reach.min():.3g} m away, the furthest "
                f"{reach.max():.3g} m"
            )
        time_s, before = before_pose(scan)
        xyz, before = scan.xyz_m[seen], None if before is None else before[seen]
        engine.register_frame(xyz, np.zeros(0) if before is None else before)
        pose = np.array(engine.last_pose)
        if not np.isfinite(pose).all():
            raise ReconstructionError(f"{scan.name}: kiss-icp lost its way here: are the scans of one place, in order?")
        close = np.flatnonzero(reach[seen] <= tuning.adjust.range_m)
        kept = close[first_of_voxels(xyz[close], tuning.adjust.thin_m)] if len(close) else close
        yield ThinScan(
            time_s=time_s,
            pose=pose,
            xyz_m=xyz[kept].astype(np.float32),
            before_s=None if before is None else before[kept].astype(np.float32),
        )


def _engine(far_m: float, tuning: Tuning) -> Any:
    try:
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP
    except ImportError:
        raise EngineMissing(
            "LiDAR odometry is made by kiss-icp, which is not installed: pip install 'tiegraph[lidar]'"
        ) from None
    config = KISSConfig()
    config.data.max_range, config.data.min_range, config.data.deskew = far_m, 0.0, True
    config.mapping.voxel_size = far_m * tuning.scan.voxel_share
    config.registration.max_num_threads = 1
    return KissICP(config)
