"""Where a frame should stand that no match has placed: by the coarse model, or by its neighbours on the pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from tiegraph.geometry import transforms
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.placement import PredictTuning


@dataclass(frozen=True)
class PredictedPose:
    """world_from_rig (4, 4), how far off its sights may be (radians), and by what it was predicted."""

    pose: np.ndarray
    slack_rad: float
    by: str


def predicted_pose(
    frame: int, poses: np.ndarray, preview: np.ndarray | None, scene: Scene, tuning: PredictTuning
) -> PredictedPose | None:
    """The pose of a frame from those (F, 4, 4) of the others, NaN = not placed; ``preview`` (F, 4, 4) in units of its
    own. None where neither tells."""
    known = np.isfinite(poses).all(axis=(1, 2))
    known[frame] = False
    if preview is not None and np.isfinite(preview[frame]).all():
        found = _by_preview(frame, poses, preview, known, tuning)
        if found is not None:
            return PredictedPose(found, tuning.by_preview_rad, "poses of the coarse model")
    found = _by_pass(frame, poses, scene, known, tuning.away_steps)
    return None if found is None else PredictedPose(found, tuning.by_pass_rad, "its neighbours on the pass")


def _by_preview(
    frame: int, poses: np.ndarray, preview: np.ndarray, known: np.ndarray, tuning: PredictTuning
) -> np.ndarray | None:
    both = np.flatnonzero(known & np.isfinite(preview).all(axis=(1, 2)))
    if len(both) < tuning.least_frames:
        return None
    distance = np.linalg.norm(preview[both, :3, 3] - preview[frame, :3, 3], axis=1)
    near = both[np.argsort(distance, kind="stable")[: tuning.neighbours]]
    # The turn by the frames' own rotations: the positions of a straight pass leave the one about it open.
    turn = Rotation.from_matrix(poses[near, :3, :3] @ np.swapaxes(preview[near, :3, :3], 1, 2)).mean().as_matrix()
    source = preview[near, :3, 3] @ turn.T
    target = poses[near, :3, 3]
    spread = source - source.mean(axis=0)
    length = float(np.sum(spread**2))
    if length == 0:
        return None
    scale = float(np.sum(spread * (target - target.mean(axis=0)))) / length
    place = target.mean(axis=0) + scale * (turn @ preview[frame, :3, 3] - source.mean(axis=0))
    return transforms.rigid(turn @ preview[frame, :3, :3], place) if scale > 0 else None


def _by_pass(frame: int, poses: np.ndarray, scene: Scene, known: np.ndarray, away: int) -> np.ndarray | None:
    """Between the nearest frames before and after, ``away`` steps at most."""
    if scene.sequence[frame] < 0:
        return None
    steps = scene.sequence_index - scene.sequence_index[frame]
    same = known & (scene.sequence == scene.sequence[frame]) & (scene.rig == scene.rig[frame]) & (np.abs(steps) <= away)
    before, after = np.flatnonzero(same & (steps < 0)), np.flatnonzero(same & (steps > 0))
    if not len(before) or not len(after):
        return None
    a, b = before[np.argmax(steps[before])], after[np.argmin(steps[after])]
    part = -steps[a] / (steps[b] - steps[a])
    turn = Slerp([0.0, 1.0], Rotation.from_matrix(poses[[a, b], :3, :3]))(part).as_matrix()
    return transforms.rigid(turn, (1 - part) * poses[a, :3, 3] + part * poses[b, :3, 3])
