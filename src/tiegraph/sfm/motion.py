"""The time at which each image and each of its rows was seen: the path of every camera, and key points moved to one
instant.

A frame has one pose, of one instant. A camera that fires late, and every row of a rolling shutter except the middle
one, is at another place of the path by then. The path is a cubic spline through the poses of the camera's own images
in a pass (a separate velocity for every image lets the scene collapse where all images are read alike: Albl et al.
2016). So late firing needs no residual of its own in the bundle adjustment: key points are moved to where the pose of
the frame's instant sees their points, everything is adjusted again, and the remaining residuals determine the next
step.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap
import scipy
from scipy.spatial.transform import Rotation, RotationSpline

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.scene.colmapmodel import registered_images, rigid3d, sensor_id
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class Lateness:
    """Delays in seconds (frame intervals if there are no times): from the frame's instant to the firing of each
    camera, by COLMAP's id, and from the first row of an image to the last."""

    cameras: Mapping[int, float]
    readout_s: float = 0.0

    def of(self, camera: pycolmap.Camera, row: np.ndarray) -> np.ndarray:
        """(K,) delay of pixels with this ``row`` (K,); the middle row has that of the camera."""
        return self.cameras.get(camera.camera_id, 0.0) + self.readout_s * (row / camera.height - 0.5)


class Motion:
    """The paths of a model's images by image id; an image without a neighbour in its pass has none.

    ``timed``: by the times of the scene; otherwise by the numbers in a pass, and a second is a frame interval.
    ``gaps`` (K,) between the images of a path.
    """

    def __init__(self, model: pycolmap.Reconstruction, scene: Scene, max_gap_s: float) -> None:
        """``max_gap_s``: a path ends where two images with times are farther apart."""
        self.timed = bool(scene.frames and np.isfinite(scene.time_s).all() and np.ptp(scene.time_s) > 0)
        time = (scene.time_s if self.timed else scene.sequence_index.astype(float))[scene.frame]
        ids = {k: image.image_id for k, image in registered_images(model, scene)}
        rows, track = np.array(sorted(ids), int), scene.sequence[scene.frame]
        rows = rows[track[rows] >= 0]
        rows = rows[np.lexsort((time[rows], scene.sensor_key[rows], track[rows]))]
        steps = np.diff(time[rows])
        other = np.any(np.diff([track[rows], scene.sensor_key[rows]], axis=1) != 0, axis=0)
        cut = other | (steps <= 0) | (steps > (max_gap_s if self.timed else 1))
        self.gaps, self._ways = steps[~cut], {}
        for way in np.split(rows, np.flatnonzero(cut) + 1):
            if len(way) > 1:
                poses = [model.image(ids[k]).cam_from_world().inverse() for k in way.tolist()]
                at = time[way] - time[way[0]]
                place = scipy.interpolate.CubicSpline(at, np.array([p.translation for p in poses]))
                turn = RotationSpline(at, Rotation.from_matrix(np.array([p.rotation.matrix() for p in poses])))
                self._ways |= {ids[k]: (place, turn, float(t)) for k, t in zip(way.tolist(), at)}

    def __contains__(self, image_id: int) -> bool:
        return image_id in self._ways

    def rate(self, image_id: int) -> np.ndarray:
        """(6,) velocity, model units a second, and rotation rate, rad a second, along the model's axes; zeros without
        a path."""
        if image_id not in self._ways:
            return np.zeros(6)
        place, turn, at = self._ways[image_id]
        return np.concatenate([place(at, 1), turn(at).apply(turn(at, 1))])  # scipy's rate is along the camera's axes

    def seen(self, image_id: int, xyz: np.ndarray, late_s: np.ndarray) -> np.ndarray:
        """(K, 3) points (K, 3) of the model in the frame of the image's camera at these delays (K,)."""
        place, turn, at = self._ways[image_id]
        return np.asarray(turn(at + late_s).apply(xyz - place(at + late_s), inverse=True))

    def pose(self, image_id: int, late_s: float) -> np.ndarray:
        """cam_from_world (4, 4) at this delay."""
        place, turn, at = self._ways[image_id]
        return transforms.invert(transforms.rigid(turn(at + late_s).as_matrix(), place(at + late_s)))


def at_one_instant(
    mapped: pycolmap.Reconstruction, model: pycolmap.Reconstruction, motion: Motion, late: Lateness
) -> pycolmap.Reconstruction:
    """A copy of ``mapped`` with its key points moved to where the poses of their frames' instants see them.

    Poses, ``motion`` and points are those of ``model``, which was made from ``mapped``; points that ``model`` lost
    keep the places they have in ``mapped``.
    """
    out = pycolmap.Reconstruction(mapped)
    both = sorted(set(mapped.reg_image_ids()) & set(model.reg_image_ids()))
    before, after = (np.array([m.image(i).projection_center() for i in both]) for m in (mapped, model))
    fit = umeyama(before, after)
    for image_id in both:
        image, camera = out.image(image_id), model.camera(model.image(image_id).camera_id)
        points = [image.points2D[k] for k in image.get_observation_point2D_idxs()]
        if image_id not in motion or not points:
            continue
        keys = [p.point3D_id for p in points]
        xyz = np.array([model.point3D(k).xyz if model.exists_point3D(k) else fit(mapped.point3D(k).xyz) for k in keys])
        late_s = late.of(camera, np.array([p.xy[1] for p in points]))
        then, now = (np.asarray(camera.img_from_cam(motion.seen(image_id, xyz, s))) for s in (late_s, 0 * late_s))
        for point, moved in zip(points, then - now):
            if np.isfinite(moved).all():
                point.xy = point.xy - moved
    return out


def in_their_time(
    model: pycolmap.Reconstruction, motion: Motion, late: Lateness, scene: Scene
) -> pycolmap.Reconstruction:
    """A copy of a model adjusted at one instant, with the images of late cameras at the places where they fired: as
    frames of their own of the same rig, with ids beyond those of the scene."""

    def own(frame: pycolmap.Frame, data: pycolmap.data_t) -> tuple[int, pycolmap.Rigid3d | None] | None:
        if data.id not in motion or not late.cameras.get(data.sensor_id.id):
            return None
        pose = rigid3d(motion.pose(data.id, late.cameras[data.sensor_id.id]))
        assert frame.rig_from_world is not None
        return frame.rig_id, frame.rig_from_world * model.image(data.id).cam_from_world().inverse() * pose

    return _with_own_frames(model, scene, [_copied(rig) for rig in model.rigs.values()], own)


def let_go(model: pycolmap.Reconstruction, cameras: set[int], scene: Scene) -> pycolmap.Reconstruction:
    """A copy of a model in which the images of these cameras (COLMAP ids) leave the rig and keep their places."""
    rigs = [_copied(rig, cameras) for rig in model.rigs.values()]
    for camera in sorted(cameras):
        rigs.append(pycolmap.Rig(rig_id=len(scene.rigs) + camera))
        rigs[-1].add_ref_sensor(sensor_id(camera))

    def own(frame: pycolmap.Frame, data: pycolmap.data_t) -> tuple[int, pycolmap.Rigid3d | None] | None:
        if data.sensor_id.id not in cameras:
            return None
        pose = model.image(data.id).cam_from_world() if frame.has_pose() else None
        return len(scene.rigs) + data.sensor_id.id, pose

    return _with_own_frames(model, scene, rigs, own)


Own = Callable[[pycolmap.Frame, pycolmap.data_t], tuple[int, pycolmap.Rigid3d | None] | None]
"""Rig and pose of the own frame of an image; None: it stays in its frame."""


def _with_own_frames(
    model: pycolmap.Reconstruction, scene: Scene, rigs: list[pycolmap.Rig], own: Own
) -> pycolmap.Reconstruction:
    frames = []
    for frame in model.frames.values():
        each = [(data, own(frame, data)) for data in frame.data_ids]
        pose = frame.rig_from_world if frame.has_pose() else None
        frames.append(_frame(frame.frame_id, frame.rig_id, [data for data, found in each if found is None], pose))
        frames += [_frame(scene.frames + data.id, found[0], [data], found[1]) for data, found in each if found]
    out = pycolmap.Reconstruction(model)
    out.set_rigs_and_frames(rigs, [f for f in frames if f.data_ids])
    return out


def _frame(frame_id: int, rig_id: int, data: list[pycolmap.data_t], pose: pycolmap.Rigid3d | None) -> pycolmap.Frame:
    out = pycolmap.Frame(frame_id=frame_id, rig_id=rig_id)
    for one in data:
        out.add_data_id(one)
    if pose is not None:
        out.rig_from_world = pose
    return out


def _copied(rig: pycolmap.Rig, without: Collection[int] = ()) -> pycolmap.Rig:
    out = pycolmap.Rig(rig_id=rig.rig_id)
    out.add_ref_sensor(rig.ref_sensor_id)
    for sensor, pose in rig.non_ref_sensors.items():
        if sensor.id not in without:
            out.add_sensor(sensor, pose)
    return out
