"""The mounting of the cameras of a relaxed rig, from the frames of its model: what is left without the motion.

A camera that fires dt late is where the rig has moved to by then: its pose against the reference is its mounting after
the motion of dt, at constant speed. The average over the frames is robust; how they scatter about it is a sigma of the
mounting, not of the average, for what they share (the time, the speed) does not average out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.align import l1_mean_rotation
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import image_poses
from tiegraph.sfm.rig.timeoffset import rig_motion
from tiegraph.sfm.tuning.rig import RigTuning

_NORMAL = 1.4826  # sigma over the median of absolute values


@dataclass(frozen=True)
class RelaxedMounting:
    """A camera in its rig: sensor_from_rig (4, 4) in units of the model; sigmas of an axis and of a coordinate."""

    sensor_from_rig: np.ndarray
    sigma_deg: float
    sigma: float


def relaxed_mountings(
    model: pycolmap.Reconstruction, scene: Scene, index: int, late_s: Mapping[str, float], tuning: RigTuning
) -> dict[str, RelaxedMounting]:
    """The mountings of the cameras of rig ``index`` in a metric model, by name; of those with too few frames, none.

    ``late_s``: when each fires against the reference. Never less sure than what held them in the adjustment.
    """
    poses, mine = image_poses(model, scene), scene.rig[scene.frame] == index
    world_from_rig = np.full((scene.frames, 4, 4), np.nan)
    first = np.flatnonzero(mine & (scene.sensor == 0) & np.isfinite(poses).all(axis=(1, 2)))
    world_from_rig[scene.frame[first]] = transforms.invert(poses[first])
    motion, out = rig_motion(world_from_rig, scene), {}
    known = tuning.time_calibration
    for place, sensor in enumerate(scene.rigs[index].sensors):
        rows = np.flatnonzero(mine & (scene.sensor == place))
        frames = scene.frame[rows]
        late = late_s.get(sensor.name, 0.0)
        after = _after(motion.columns(frames), late) if late else np.broadcast_to(np.eye(4), (len(rows), 4, 4))
        found = poses[rows] @ world_from_rig[frames] @ after
        found = found[np.isfinite(found).all(axis=(1, 2))]
        if place == 0 or len(found) < tuning.diagnostics.min_frames:
            continue
        turn = l1_mean_rotation(found[:, :3, :3])
        centres = transforms.centre(found)
        centre = np.median(centres, axis=0)
        turned = Rotation.from_matrix(found[:, :3, :3] @ turn.T).as_rotvec()
        out[sensor.name] = RelaxedMounting(
            sensor_from_rig=transforms.rigid(turn, -turn @ centre),
            sigma_deg=max(float(np.degrees(_NORMAL * np.median(np.abs(turned)))), known.loose_deg),
            sigma=max(float(_NORMAL * np.median(np.abs(centres - centre))), known.nominal_m),
        )
    return out


def _after(columns: np.ndarray, late_s: float) -> np.ndarray:
    """(K, 4, 4) the rig's own motion in ``late_s`` seconds, of (K, 6) change of place and attitude a second."""
    turn = np.full((len(columns), 3, 3), np.nan)
    good = np.isfinite(columns).all(axis=1)
    turn[good] = Rotation.from_rotvec(late_s * columns[good, 3:]).as_matrix()
    return np.asarray(transforms.rigid(turn, late_s * columns[:, :3]))
