"""The path that comes out: a pose a frame with its covariance, by segments."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.odometry.covariance import keyframe_covariances, resection_covariance
from tiegraph.odometry.odometry import Odometry
from tiegraph.odometry.tuning import MapTuning


@dataclass(frozen=True)
class OdometryPath:
    """F frames in their order: world_from_rig (F, 4, 4), NaN = no pose; segment (F,), -1 = none, else 0, 1, ... in
    order of their first frames, each in a world of its own; keyframe (F,) bool; covariance (F, 6, 6) of position (units
    of the path) and turn (rad), both along the axes of the world, zero of the first; ``metric``: lengths are metres.

    ``loops``: known places that were seen again and tied (loops, joined segments).
    """

    world_from_rig: np.ndarray
    segment: np.ndarray
    keyframe: np.ndarray
    covariance: np.ndarray
    metric: bool
    loops: int

    def main(self) -> int:
        """The segment with the most frames; -1 if there is none."""
        there = self.segment[self.segment >= 0]
        return int(np.argmax(np.bincount(there))) if len(there) else -1

    def sigmas(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the position (F, 3), units of the path, and of the turn (F, 3), degrees; NaN = no pose."""
        sigma = np.sqrt(np.einsum("kii->ki", self.covariance))
        return sigma[:, :3], np.degrees(sigma[:, 3:])


def path_of(odometry: Odometry, frames: Sequence[int], tuning: MapTuning) -> OdometryPath:
    """The path of frames that were added to an odometry, which is finished."""
    world, count = odometry.world, len(frames)
    poses, covariance = np.full((count, 4, 4), np.nan), np.full((count, 6, 6), np.nan)
    segment, keyframe = np.full(count, -1), np.zeros(count, bool)
    of_keyframe = np.full((len(world.keyframes), 6, 6), np.nan)
    for number in {k.segment for k in world.keyframes}:
        own = [n for n, k in enumerate(world.keyframes) if k.segment == number]
        of_keyframe[own] = keyframe_covariances(world, own, tuning.loss_px, odometry.metric)
    for row, frame in enumerate(frames):
        posed = odometry.posed.get(frame)
        if posed is None:
            continue
        at = world.keyframes[posed.keyframe]
        pose = posed.rig_from_keyframe @ at.rig_from_world
        poses[row], segment[row], keyframe[row] = transforms.invert(pose), at.segment, at.frame == frame
        step = np.eye(6)  # the frame hangs on its keyframe rigidly: a turn of the one moves the other
        step[:3, 3:] = -transforms.skew(transforms.centre(pose) - transforms.centre(at.rig_from_world))
        carried = step @ of_keyframe[posed.keyframe] @ step.T
        if at.frame != frame:
            seen = posed.seen.where(~np.isnan(world.xyz[posed.seen.point, 0]))
            carried = carried + resection_covariance(world.cameras, pose, seen, world.xyz[seen.point], tuning.loss_px)
        covariance[row] = tuning.shared**2 * carried
    order = {old: new for new, old in enumerate(dict.fromkeys(segment[segment >= 0].tolist()))}
    named = np.array([order.get(s, -1) for s in segment.tolist()], int)
    return OdometryPath(
        world_from_rig=poses, segment=named, keyframe=keyframe, covariance=covariance,
        metric=odometry.metric, loops=odometry.loops,
    )  # fmt: skip
