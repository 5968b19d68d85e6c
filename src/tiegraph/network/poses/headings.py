"""Headings from the track of positions, where a prior has positions and no rotations (GNSS)."""

from collections.abc import Sequence

import numpy as np

from tiegraph.network.passes import Pass
from tiegraph.network.rig.axes import vertical
from tiegraph.network.tuning import Tuning
from tiegraph.scene.scene import Scene

_UP = np.array([0.0, 0.0, 1.0])


def with_headings(scene: Scene, passes: Sequence[Pass], tuning: Tuning) -> tuple[np.ndarray, np.ndarray]:
    """Poses (F, 4, 4) with unknown rotations of passes filled by the direction of travel, and where (F,) bool.

    Reference camera forward, rig upright: wrong by a constant turn about the vertical if it is mounted otherwise, which
    angles between axes do not notice.
    """
    poses = scene.world_from_rig.copy()
    filled = np.zeros(scene.frames, bool)
    for p in passes:
        unknown = np.isnan(poses[p.frames][:, :3, :3]).any(axis=(1, 2))
        where = poses[p.frames][:, :3, 3]
        if not unknown.any() or len(p) < 2:
            continue
        sigma = np.nan_to_num(np.nanmax(scene.position_sigma_m[p.frames], axis=1, initial=0.0))
        noise = tuning.poses.heading_sigmas * np.maximum(sigma, 1e-3)
        for k in np.flatnonzero(unknown):
            way = _direction(where, noise, int(k))
            if way is not None and np.isfinite(where[k]).all():
                up = vertical(p.rig, tuning.rig.axes) if p.rig.known() else -np.eye(3)[1]
                poses[p.frames[k], :3, :3] = _upright(way, up)
                poses[p.frames[k], 3] = (0, 0, 0, 1)
                filled[p.frames[k]] = True
    return poses, filled


def _direction(where: np.ndarray, noise: np.ndarray, k: int) -> np.ndarray | None:
    """Horizontal unit vector of travel at frame k over the shortest stretch that is longer than its noise."""
    for half in range(1, len(where)):
        a, b = max(0, k - half), min(len(where) - 1, k + half)
        step = (where[b] - where[a]) * (1, 1, 0)
        if np.isfinite(step).all() and np.linalg.norm(step) > max(noise[a], noise[b]):
            return step / np.linalg.norm(step)
        if a == 0 and b == len(where) - 1:
            return None
    return None


def _upright(way: np.ndarray, up_in_rig: np.ndarray) -> np.ndarray:
    """world_from_rig (3, 3) that takes the rig's vertical to the world's and the reference axis towards ``way``."""
    ahead = np.array([0.0, 0.0, 1.0])
    ahead = ahead - (ahead @ up_in_rig) * up_in_rig
    if np.linalg.norm(ahead) < 1e-3:  # the reference camera looks up: any direction in the plane serves
        ahead = np.cross(up_in_rig, [1.0, 0.0, 0.0])
    ahead /= np.linalg.norm(ahead)
    rig = np.stack([ahead, np.cross(up_in_rig, ahead), up_in_rig], axis=1)
    world = np.stack([way, np.cross(_UP, way), _UP], axis=1)
    return world @ rig.T
