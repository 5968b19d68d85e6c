"""Do the cameras of a rig fire at one instant? Time offsets from how far each stands off its place as the rig moves.

A camera that fires dt late stands dt times the velocity ahead of its place, and is turned by dt times the turn rate. A
constant error of the extrinsics does the same at constant speed, so both are estimated, and the offset is only believed
when changes of speed tell them apart.

The mounting of the cameras of a relaxed rig is what is left without the motion: a camera that fires dt late is where
the rig has moved to by then, its pose against the reference is its mounting after the motion of dt, at constant speed.
The average over the frames is robust; how they scatter about it is a sigma of the mounting, not of the average, for
what they share (the time, the speed) does not average out.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.align import l1_mean_rotation, robust_sigma
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.rig import RigTuning

_FEW, _ROUNDS = 8, 15  # frames; of the robust fit


@dataclass(frozen=True)
class Motion:
    """Velocity (F, 3) m/s and turn rate (F, 3) rad/s of the rig in its own frame; NaN where neighbours are missing.

    ``timed``: by times of the scene; else by steps of the pass, and a second is a frame interval.
    """

    velocity: np.ndarray
    rate: np.ndarray
    timed: bool

    def columns(self, frames: np.ndarray) -> np.ndarray:
        """(K, 6) change of place (m) and attitude (rad) per second."""
        return np.concatenate([self.velocity[frames], self.rate[frames]], axis=1)


def rig_motion(world_from_rig: np.ndarray, scene: Scene) -> Motion:
    """Differences between the neighbours in each pass, (F, 4, 4) poses in metres."""
    timed = bool(np.isfinite(scene.time_s).all()) and float(np.ptp(scene.time_s)) > 0 if scene.frames else False
    time = scene.time_s if timed else scene.sequence_index.astype(float)
    velocity, rate = np.full((scene.frames, 3), np.nan), np.full((scene.frames, 3), np.nan)
    known = np.isfinite(world_from_rig).all(axis=(1, 2))
    for track in np.unique(scene.sequence[scene.sequence >= 0]):
        members = scene.in_order((scene.sequence == track) & known)
        for k, frame in enumerate(members):
            a, b = members[max(k - 1, 0)], members[min(k + 1, len(members) - 1)]
            gap = time[b] - time[a]
            if gap <= 0:
                continue
            body = world_from_rig[frame, :3, :3].T
            velocity[frame] = body @ (world_from_rig[b, :3, 3] - world_from_rig[a, :3, 3]) / gap
            turn = Rotation.from_matrix(world_from_rig[a, :3, :3].T @ world_from_rig[b, :3, :3]).as_rotvec()
            rate[frame] = turn / gap
    return Motion(velocity, rate, timed)


@dataclass(frozen=True)
class TimeOffset:
    """When a camera fires against the rig's instant."""

    offset_s: float
    moves_m: float  # how far the offset moves the camera at the highest speed seen


def moved_in_time(residual: np.ndarray, covariance: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(K, 6) what the motion does to a camera: offset * columns (K, 6) of the best fit of constant + offset * columns
    to its residuals (K, 6), robust (Cauchy), weights from covariance (K, 6, 6); nothing where too little is known."""
    rows = np.isfinite(columns).all(axis=1)
    if rows.sum() < _FEW:
        return np.zeros_like(columns)
    design = np.concatenate([np.tile(np.eye(6), (int(rows.sum()), 1, 1)), columns[rows][:, :, None]], axis=2)
    root = np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariance[rows])), 1, 2)
    design, off = root @ design, np.einsum("kij,kj->ki", root, residual[rows])
    found, weight = np.zeros(7), np.ones(len(off))
    for _ in range(_ROUNDS):
        sides = [np.sqrt(weight)[:, None] * v.reshape(len(off), -1) for v in (design, off)]
        found = np.linalg.lstsq(sides[0].reshape(-1, 7), sides[1].ravel(), rcond=None)[0]
        chi = np.sum((off - design @ found) ** 2, axis=1)
        weight = 1 / (1 + chi / max(float(np.median(chi)), 1e-12))
    return np.asarray(found[6] * np.nan_to_num(columns))


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
            sigma_deg=max(float(np.degrees(robust_sigma(turned))), known.loose_deg),
            sigma=max(robust_sigma(centres - centre), known.nominal_m),
        )
    return out


def _after(columns: np.ndarray, late_s: float) -> np.ndarray:
    """(K, 4, 4) the rig's own motion in ``late_s`` seconds, of (K, 6) change of place and attitude a second."""
    turn = np.full((len(columns), 3, 3), np.nan)
    good = np.isfinite(columns).all(axis=1)
    turn[good] = Rotation.from_rotvec(late_s * columns[good, 3:]).as_matrix()
    return np.asarray(transforms.rigid(turn, late_s * columns[:, :3]))
