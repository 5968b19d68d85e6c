"""The map: keyframes with what they see, and points with their places."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.odometry.cameras import Cameras
from tiegraph.odometry.follow import Tracks
from tiegraph.odometry.resect import errors_px
from tiegraph.scene.sorting import Columns


@dataclass(frozen=True)
class Keyframe:
    """A frame that holds the map up: its number in the survey, segment, rig_from_world (4, 4), what it sees (a point
    may be seen by several cameras), thumbnails by camera."""

    frame: int
    segment: int
    rig_from_world: np.ndarray
    seen: Tracks
    thumbnails: dict[int, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Observations(Columns):
    """M observations: keyframe (M,) its number in the map, point (M,), camera (M,), xy (M, 2) pixels."""

    keyframe: np.ndarray
    point: np.ndarray
    camera: np.ndarray
    xy: np.ndarray


class WorldMap:
    """Keyframes in the order they were made, and the places (P, 3) of all points, NaN = not known (yet)."""

    def __init__(self, cameras: Cameras) -> None:
        self.cameras = cameras
        self.keyframes: list[Keyframe] = []
        self._xyz = np.full((1024, 3), np.nan)
        self._count = 0

    @property
    def xyz(self) -> np.ndarray:
        """(P, 3)."""
        return self._xyz[: self._count]

    def new_points(self, count: int) -> np.ndarray:
        """Numbers (count,) of new points without place."""
        first, self._count = self._count, self._count + count
        while self._count > len(self._xyz):
            self._xyz = np.concatenate([self._xyz, np.full_like(self._xyz, np.nan)])
        return np.arange(first, self._count)

    def move(self, number: int, rig_from_world: np.ndarray) -> None:
        """Give a keyframe another pose."""
        self.keyframes[number] = replace(self.keyframes[number], rig_from_world=rig_from_world)

    def observations(self, numbers: Sequence[int]) -> Observations:
        """What some keyframes see."""
        seen = [self.keyframes[k].seen for k in numbers] or [Tracks.none()]
        return Observations(
            keyframe=np.repeat(np.asarray([*numbers] or [0], int), [len(s) for s in seen]),
            point=np.concatenate([s.point for s in seen]),
            camera=np.concatenate([s.camera for s in seen]),
            xy=np.concatenate([s.xy for s in seen]),
        )

    def errors_px(self, seen: Observations) -> np.ndarray:
        """(M,) distances of observations from where their points are seen; infinite for those without place."""
        out = np.full(len(seen.point), np.inf)
        for number in np.unique(seen.keyframe):
            at, pose = seen.keyframe == number, self.keyframes[number].rig_from_world
            out[at] = errors_px(self.cameras, pose, seen.camera[at], seen.xy[at], self.xyz[seen.point[at]])
        return out

    def forget(self, seen: Observations, bad: np.ndarray) -> None:
        """Take observations (M,) bool of what keyframes see away; a point that has lost some, with fewer than two left,
        has no place any more."""
        for number in np.unique(seen.keyframe[bad]):
            frame, own = self.keyframes[number], seen.keyframe == number
            self.keyframes[number] = replace(frame, seen=frame.seen.where(~bad[own]))
        left = np.bincount(seen.point[~bad], minlength=len(self.xyz))
        hit = np.unique(seen.point[bad])
        self.xyz[hit[left[hit] < 2]] = np.nan

    def triangulate(self, numbers: Sequence[int], outlier_px: float) -> None:
        """Give places to points without, by all that some keyframes see of them.

        The place is where the squared distances to the rays are least; it is taken if the rays are not parallel and
        all of them see it within ``outlier_px``.
        """
        seen = self.observations(numbers)
        seen = seen.where(np.isnan(self.xyz[seen.point, 0]))
        points, row, count = np.unique(seen.point, return_inverse=True, return_counts=True)
        if not len(points) or count.max() < 2:
            return
        world_from_rig = transforms.invert(np.stack([self.keyframes[k].rig_from_world for k in seen.keyframe]))
        mounted = self.cameras.rig_from_sensor[seen.camera, :3, 3]
        centre = np.einsum("kij,kj->ki", world_from_rig, np.insert(mounted, 3, 1, 1))[:, :3]
        ray = np.einsum("kij,kj->ki", world_from_rig[:, :3, :3], self.cameras.rays(seen.camera, seen.xy))
        across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
        matrix, side = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        np.add.at(matrix, row, across)
        np.add.at(side, row, np.einsum("kij,kj->ki", across, centre))
        least = np.linalg.eigvalsh(matrix)[:, 0] / count  # of two rays: 1 - cos of half the angle between them, twice
        wide = (count >= 2) & (np.sqrt(np.maximum(4 * least, 0)) > np.radians(0.2))
        place = np.full((len(points), 3), np.nan)
        place[wide] = np.linalg.solve(matrix[wide], side[wide][:, :, None])[:, :, 0]
        self.xyz[points] = place
        off = self.errors_px(seen)
        self.xyz[np.unique(seen.point[off > outlier_px])] = np.nan
