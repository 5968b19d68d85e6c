"""Where a scanner was while it turned: points of one scan brought to the instant of its pose."""

import numpy as np
from scipy.spatial.transform import Rotation


def deskew(xyz: np.ndarray, before_s: np.ndarray | None, velocity: np.ndarray) -> np.ndarray:
    """Points (N, 3) as the scanner sees them at the instant of the pose; ``before_s`` (N,) <= 0 from it, None: as they
    are. ``velocity`` (6,) in the scanner's axes: turn (rad/s), then m/s, constant over the scan."""
    if before_s is None:
        return xyz
    turned = Rotation.from_rotvec(before_s[:, None] * velocity[:3]).apply(xyz)
    return turned + before_s[:, None] * velocity[3:]


def velocities(time_s: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """(T, 6) of poses (T, 4, 4) at growing times, from the one before; of the first from the one behind."""
    step = np.linalg.inv(poses[:-1]) @ poses[1:]
    rate = np.hstack([Rotation.from_matrix(step[:, :3, :3]).as_rotvec(), step[:, :3, 3]])
    rate /= np.diff(time_s)[:, None]
    return np.vstack([rate[:1], rate])


def first_of_voxels(xyz: np.ndarray, size: float) -> np.ndarray:
    """Rows of the first point in each voxel, in order."""
    return np.sort(np.unique(voxel_keys(xyz, size), return_index=True)[1])


def voxel_keys(xyz: np.ndarray, size: float) -> np.ndarray:
    """(N,) i8: equal for points (N, 3) in one voxel of this side."""
    cell = np.floor(xyz / size).astype(np.int64)
    cell -= cell.min(axis=0)
    extent = cell.max(axis=0) + 1
    return (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
