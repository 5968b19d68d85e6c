"""Trajectory of a scanner by kiss-icp, one scan after another, and the map of its scans in bounded memory."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.errors import EngineMissing, InputError, ReconstructionError
from tiegraph.lidar.scans import LEAST_POINTS, Scan, first_of_voxels
from tiegraph.scene.results import Cloud


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


def odometry(scans: Iterator[Scan], near_m: float, far_m: float) -> Iterator[ThinScan]:
    """Each scan with its pose in the frame of the first one.

    kiss-icp (Vizzo et al. 2023), on one thread, so that equal scans make equal poses. Raises EngineMissing without it,
    InputError for scans without points between the ranges, ReconstructionError where it loses its way.
    """
    engine = _engine(far_m)
    for scan in scans:
        reach = np.linalg.norm(scan.xyz_m, axis=1)
        seen = (reach >= near_m) & (reach <= far_m)
        if seen.sum() < LEAST_POINTS:
            raise InputError(
                f"{scan.name}: {int(seen.sum())} points between {near_m:g} and {far_m:g} m (--near-m, --far-m), "
                f"{LEAST_POINTS} are needed; the nearest is {reach.min():.3g} m away, the furthest "
                f"{reach.max():.3g} m"
            )
        time_s, before = before_pose(scan)
        xyz, before = scan.xyz_m[seen], None if before is None else before[seen]
        engine.register_frame(xyz, np.zeros(0) if before is None else before)
        pose = np.array(engine.last_pose)
        if not np.isfinite(pose).all():
            raise ReconstructionError(f"{scan.name}: kiss-icp lost its way here: are the scans of one place, in order?")
        close = np.flatnonzero(reach[seen] <= 60.0)  # points further away are sparse, and their spots wide
        kept = close[first_of_voxels(xyz[close], 0.1)] if len(close) else close
        yield ThinScan(
            time_s=time_s,
            pose=pose,
            xyz_m=xyz[kept].astype(np.float32),
            before_s=None if before is None else before[kept].astype(np.float32),
        )


def _engine(far_m: float) -> Any:
    try:
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP
    except ImportError:
        raise EngineMissing(
            "LiDAR odometry is made by kiss-icp, which is not installed: pip install 'tiegraph[lidar]'"
        ) from None
    config = KISSConfig()
    config.data.max_range, config.data.min_range, config.data.deskew = far_m, 0.0, True
    config.mapping.voxel_size = far_m / 100  # kiss-icp's own default
    config.registration.max_num_threads = 1
    return KissICP(config)


_SPAN = 1 << 20  # cells to both sides of the first scan that a key has room for
_GREY, _MOST_VIEWS = 128, 255
_MOST_POINTS = 20_000_000  # voxels held: 1 GiB
_BATCH_POINTS = 2_000_000  # gathered before they are merged


class MapCloud:
    """Points are added scan by scan, and merged from time to time; the voxel grows where they become too many."""

    def __init__(self, voxel_m: float) -> None:
        self.voxel_m = voxel_m
        self._keys = np.zeros(0, np.int64)
        self._sums: np.ndarray = np.zeros((0, 4))  # x, y, z, number
        self._waiting: list[np.ndarray] = []
        self._count = 0

    def add(self, xyz: np.ndarray) -> None:
        """Points (N, 3) in the world."""
        self._waiting.append(np.column_stack([xyz, np.ones(len(xyz))]))
        self._count += len(xyz)
        if self._count > _BATCH_POINTS:
            self._merge()

    def cloud(self) -> Cloud:
        """The map, sorted by voxel; ``views``: points behind each, 255 at most."""
        self._merge()
        number = self._sums[:, 3:]
        missing = np.full((len(number), 3), np.nan, np.float32)
        return Cloud(
            xyz_m=self._sums[:, :3] / np.maximum(number, 1),
            rgb=np.full((len(number), 3), _GREY, np.uint8),
            normal=missing,
            sigma_m=missing[:, 0],
            views=np.minimum(number[:, 0], _MOST_VIEWS).astype(np.uint8),
        )

    def _merge(self) -> None:
        rows = np.concatenate([self._sums, *self._waiting])
        self._waiting, self._count = [], 0
        self._gather(rows)
        while len(self._keys) > _MOST_POINTS:
            self.voxel_m *= 1.5
            self._gather(self._sums)

    def _gather(self, rows: np.ndarray) -> None:
        cell = np.floor(rows[:, :3] / np.maximum(rows[:, 3:], 1) / self.voxel_m).astype(np.int64)
        cell = np.clip(cell, -_SPAN, _SPAN - 1) + _SPAN
        key = (cell[:, 0] * 2 * _SPAN + cell[:, 1]) * 2 * _SPAN + cell[:, 2]
        self._keys, group = np.unique(key, return_inverse=True)
        columns = [np.bincount(group, rows[:, k], len(self._keys)) for k in range(4)]
        self._sums = np.stack(columns, axis=1)
