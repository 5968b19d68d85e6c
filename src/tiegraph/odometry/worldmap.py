"""The map: keyframes with what they see, and points with their places, adjusted together by pycolmap's bundle
adjustment, cameras and rig held; and the pose of a frame by its points, for rigs of one camera too."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.odometry.cameras import Cameras, Tracks
from tiegraph.odometry.tuning import MapTuning, PoseTuning
from tiegraph.scene.colmapmodel import add_rig, all_images, matrix, options_of, rigid3d
from tiegraph.scene.sorting import Columns


@dataclass(frozen=True)
class Resection:
    """rig_from_world (4, 4), and which of the points (K,) agree with it."""

    rig_from_world: np.ndarray
    inlier: np.ndarray


def errors_px(
    cameras: Cameras, rig_from_world: np.ndarray, camera: np.ndarray, xy: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """(K,) distances of observations from where a pose sees the points; infinite behind a camera or without place."""
    off = xy - cameras.project(camera, transforms.apply(rig_from_world, points))
    return np.nan_to_num(np.linalg.norm(off, axis=1), nan=np.inf)


def resect(
    cameras: Cameras,
    camera: np.ndarray,
    xy: np.ndarray,
    points: np.ndarray,
    guess: np.ndarray | None,
    tuning: PoseTuning,
) -> Resection | None:
    """The pose that K observations (camera (K,), xy (K, 2)) of points (K, 3) with places give; None if they give none.

    ``guess``: the predicted pose, which is refined; RANSAC is asked where that explains too few.
    """
    found = None if guess is None else _refined(cameras, camera, xy, points, guess, tuning)
    if (found is None or found.inlier.mean() < 0.5) and len(xy) >= tuning.least_points:
        options = _ransac_options(tuning.inlier_px, 50, 2000)
        known = camera.tolist(), cameras.rigid, list(cameras.models)
        made = pycolmap.estimate_generalized_absolute_pose(xy, points, *known, options)
        pose = None if made is None else matrix(made["rig_from_world"])
        other = None if pose is None else _refined(cameras, camera, xy, points, pose, tuning)
        if other is not None and (found is None or other.inlier.sum() > found.inlier.sum()):
            found = other
    good = found is not None and found.inlier.sum() >= tuning.least_points and found.inlier.mean() >= 0.3
    return found if good else None


def _refined(
    cameras: Cameras, camera: np.ndarray, xy: np.ndarray, points: np.ndarray, guess: np.ndarray, tuning: PoseTuning
) -> Resection | None:
    pose = guess
    for limit in (tuning.first_px, tuning.inlier_px):
        inlier = errors_px(cameras, pose, camera, xy, points) < limit
        if inlier.sum() < tuning.least_points:
            return None
        made = pycolmap.refine_generalized_absolute_pose(
            rigid3d(pose), xy, points, inlier, camera.tolist(), cameras.rigid, list(cameras.models)
        )
        if made is None:
            return None
        pose = matrix(made["rig_from_world"])
    return Resection(pose, errors_px(cameras, pose, camera, xy, points) < tuning.inlier_px)


def moved_share(cameras: Cameras, before: Tracks, after: Tracks) -> float:
    """Median shift of the same corners in longer sides of their images; 0 for none."""
    if not len(before):
        return 0.0
    sides = np.array([max(m.width, m.height) for m in cameras.models])[before.camera]
    return float(np.median(np.linalg.norm(after.xy - before.xy, axis=1) / sides))


def _ransac_options(inlier_px: float, least: int, most: int) -> pycolmap.RANSACOptions:
    return pycolmap.RANSACOptions(max_error=inlier_px, min_num_trials=least, max_num_trials=most, random_seed=0)


def relative_pose(cameras: Cameras, before: Tracks, after: Tracks) -> np.ndarray | None:
    """after_from_before (4, 4) of the rig by the same corners in two frames; None if they do not tell it.

    The base line of a single camera has length one; that of a rig is in metres, by its own size: hardly where that is
    small (``scaled``).
    """
    options = _ransac_options(2.0, 100, 3000)
    if len(cameras) == 1:
        model = cameras.models[0]
        made = pycolmap.estimate_relative_pose(model, before.xy, model, after.xy, options)
        pose = None if made is None else matrix(made["cam2_from_cam1"])
    else:
        camera = before.camera.tolist()
        made = pycolmap.estimate_generalized_relative_pose(
            before.xy, after.xy, camera, camera, cameras.rigid, list(cameras.models), options
        )
        pose = None if made is None or "rig2_from_rig1" not in made else matrix(made["rig2_from_rig1"])
    if made is None or pose is None or np.mean(made["inlier_mask"]) < 0.6:
        return None
    good = np.asarray(made["inlier_mask"], bool)
    rays = [cameras.rays(t.camera[good], t.xy[good]) for t in (before, after)]
    turned = rays[1] @ transforms.invert(pose)[:3, :3].T
    angle = np.degrees(np.arccos(np.clip(np.sum(rays[0] * turned, axis=1), -1, 1)))
    return pose if np.median(angle) >= 0.6 else None  # less tells no depth


def scaled(cameras: Cameras, pose: np.ndarray, after: Tracks, known: np.ndarray) -> np.ndarray:
    """A pose of ``relative_pose`` with the length of its base line by points (K, 3) whose places in the first frame the
    cameras tell, NaN = they do not; as it was where they are too few.

    A point X that lies along the ray r from the centre c says s of r x (R X + s t - c) = 0; the median counts.
    """
    there = ~np.isnan(known[:, 0])
    if there.sum() < 8:
        return pose
    camera = after.camera[there]
    ray = cameras.rays(camera, after.xy[there])
    offset = known[there] @ pose[:3, :3].T - cameras.rig_from_sensor[camera, :3, 3]
    across, moved = np.cross(ray, offset), np.cross(ray, pose[:3, 3])
    lengths = -np.sum(across * moved, axis=1) / np.maximum(np.sum(moved**2, axis=1), 1e-30)
    length = float(np.median(lengths))
    out = pose.copy()
    out[:3, 3] *= length if length > 0 else 1.0
    return out


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
    for k in (k for k in numbers if k in held):
        config.set_constant_rig_from_world_pose(k + 1)
    pycolmap.create_default_ceres_bundle_adjuster(options, config, model).solve()
    for k in free:
        pose = model.frame(k + 1).rig_from_world
        assert pose is not None
        world.keyframes[k] = replace(world.keyframes[k], rig_from_world=matrix(pose))
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
        frame = pycolmap.Frame(frame_id=number + 1, rig_id=1)
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
