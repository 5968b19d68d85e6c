"""The map: keyframes with what they see, and points with their places; adjusted together by pycolmap's bundle
adjustment, cameras and rig held."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.odometry.cameras import Cameras
from tiegraph.odometry.follow import Tracks
from tiegraph.odometry.resect import errors_px
from tiegraph.odometry.tuning import MapTuning
from tiegraph.scene.colmapmodel import add_rig, all_images, matrix, options_of, rigid3d
from tiegraph.scene.sorting import Columns

_RIG = 1


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


def adjust(
    world: WorldMap, numbers: Sequence[int], held: Collection[int], tuning: MapTuning, loss_px: float, iterations: int
) -> None:
    """Adjust keyframes but those held, with all points that two observations of them see; forget what then is off."""
    seen = world.observations(numbers)
    points, row, count = np.unique(seen.point, return_inverse=True, return_counts=True)
    usable = ~np.isnan(world.xyz[seen.point, 0]) & (count[row] >= 2)
    free = [k for k in numbers if k not in held]
    if not usable.any() or not free:
        return
    model, ids = _build(world, numbers, seen.where(usable))
    _solve(model, [k + 1 for k in numbers if k in held], loss_px, iterations)
    for k in free:
        pose = model.frame(k + 1).rig_from_world
        assert pose is not None
        world.move(k, matrix(pose))
    world.xyz[list(ids)] = [model.point3D(number).xyz for number in ids.values()]
    world.forget(seen, usable & (world.errors_px(seen) > tuning.outlier_px))


def _build(
    world: WorldMap, numbers: Sequence[int], seen: Observations
) -> tuple[pycolmap.Reconstruction, dict[int, int]]:
    """COLMAP's model, in which a keyframe's number + 1 is its frame's; number of a point in the map -> in the model."""
    model = pycolmap.Reconstruction()
    add_rig(model, world.cameras.models, world.cameras.rigid)
    image_of: dict[tuple[int, int], int] = {}
    row = np.zeros(len(seen.point), int)
    for number in numbers:
        frame = pycolmap.Frame(frame_id=number + 1, rig_id=_RIG)
        frame.rig_from_world = rigid3d(world.keyframes[number].rig_from_world)
        images = []
        for camera in np.unique(seen.camera[seen.keyframe == number]).tolist():
            at = np.flatnonzero((seen.keyframe == number) & (seen.camera == camera))
            row[at] = np.arange(len(at))
            key = image_of[number, camera] = len(image_of) + 1
            image = pycolmap.Image(name=str(key), keypoints=seen.xy[at], camera_id=camera + 1, image_id=key)
            image.frame_id = number + 1
            frame.add_data_id(image.data_id)
            images.append(image)
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
        model.register_frame(number + 1)
    order = np.argsort(seen.point, kind="stable")
    images_of = [image_of[k, c] for k, c in zip(seen.keyframe[order].tolist(), seen.camera[order].tolist())]
    elements = [pycolmap.TrackElement(i, r) for i, r in zip(images_of, row[order].tolist())]
    points, first = np.unique(seen.point[order], return_index=True)
    ends = [*first[1:].tolist(), len(elements)]
    ids = {
        point: model.add_point3D(world.xyz[point], pycolmap.Track(elements[a:b]), np.zeros(3, np.uint8))
        for point, a, b in zip(points.tolist(), first.tolist(), ends)
    }
    return model, ids


def _solve(model: pycolmap.Reconstruction, held: Collection[int], loss_px: float, iterations: int) -> None:
    options = options_of(
        iterations,
        1e-4,  # relative change of the cost at which Ceres stops: the next keyframe adjusts the same again
        loss_px,
        refine_focal_length=False,
        refine_extra_params=False,
        refine_principal_point=False,
        refine_sensor_from_rig=False,
    )
    config = all_images(model)
    for frame in held:
        config.set_constant_rig_from_world_pose(frame)
    pycolmap.create_default_ceres_bundle_adjuster(options, config, model).solve()
