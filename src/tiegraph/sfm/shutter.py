"""Rolling shutters: the rows of an image are read one after another while the camera moves on.

A row is seen ``readout`` x (row / height - 1/2) later than the middle one, whose time the pose is of. Velocity and
turn at an image are those of cubic splines through the poses of its pass (velocities of their own for every image let
the scene collapse where all images are read alike: Albl et al. 2016). So one number is unknown, and the bundle
adjustment needs no other residual: key points are moved to where the middle row's pose sees their points, and all is
adjusted again. The number is one more unknown of the normal equations, poses, points and all lenses eliminated.

Distortion that a lens model leaves out looks alike where a vehicle drives straight on (KITTI, a global shutter: 3 ms
with a sigma of 0.3), so what is too short for a real shutter or explains next to nothing is not believed. What is not
seen here: motion faster than the frames of a pass, and images that were turned on their side (rows are then columns).
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap
import scipy
from scipy import sparse
from scipy.spatial.transform import Rotation, RotationSpline

from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment import lens
from tiegraph.sfm.adjustment.adjust import free_cameras
from tiegraph.sfm.adjustment.jacobians import Layout, System
from tiegraph.sfm.covariance import Linearised
from tiegraph.sfm.tuning import ShutterTuning, Tuning


@dataclass(frozen=True)
class Readout:
    """Seconds from the first row of an image to the last (negative: from the last), and their sigma; ``gain``: by which
    share it lowers the robust cost; ``step``: seconds that may be gone at once, for far from its minimum the robust
    cost is less curved than there; ``gap_s``: between the images whose poses tell the motion, median."""

    seconds: float
    sigma: float
    gain: float
    step: float
    gap_s: float

    def there(self, tuning: ShutterTuning) -> bool:
        """Whether it is a shutter's and not noise or a lens."""
        least, most = tuning.range_s
        sure = abs(self.seconds) > tuning.sigmas * self.sigma and self.gain > tuning.told_gain
        return sure and least <= abs(self.seconds) <= most

    def clear(self, tuning: ShutterTuning) -> bool:
        """Whether it is used unasked."""
        return self.gain > tuning.used_gain and self.gap_s <= tuning.used_gap_s

    def __str__(self) -> str:
        """In milliseconds."""
        return f"{1000 * self.seconds:.1f} ms (sigma {1000 * self.sigma:.1f})"


def image_motion(model: pycolmap.Reconstruction, scene: Scene, tuning: ShutterTuning) -> dict[int, np.ndarray]:
    """(6,) velocity, model units a second, and turn, rad a second, along the model's axes, by image id.

    Of images whose neighbours of the same camera in the same pass are in the model; none where frames have no times.
    """
    world_from_cam, time = transforms.invert(image_poses(model, scene)), scene.time_s[scene.frame]
    out: dict[int, np.ndarray] = {}
    ids = {scene.image_index[model.image(i).name]: i for i in model.reg_image_ids()}
    for stretch in _stretches(np.array(sorted(ids), int), scene, tuning):
        at, pose = time[stretch] - time[stretch[0]], world_from_cam[stretch]
        velocity = scipy.interpolate.CubicSpline(at, pose[:, :3, 3])(at, 1)
        turned = Rotation.from_matrix(pose[:, :3, :3])
        rate = turned.apply(RotationSpline(at, turned)(at, 1))  # it gives the rate along the camera's own axes
        out |= {ids[int(k)]: v for k, v in zip(stretch, np.hstack([velocity, rate]))}
    return out


def _stretches(images: np.ndarray, scene: Scene, tuning: ShutterTuning) -> list[np.ndarray]:
    """Images (K,) of one camera that follow each other in a pass, two and more; none where frames have no times, and
    of views, whose rows are not those of the camera."""
    views = any(s.source is not None and s.source.rendered for s in scene.all_sensors)
    if views or not scene.frames or not np.isfinite(scene.time_s).all():
        return []
    time, track = scene.time_s[scene.frame], scene.sequence[scene.frame]
    rows = images[track[images] >= 0]
    rows = rows[np.lexsort((time[rows], scene.sensor_key[rows], track[rows]))]
    steps = np.diff(time[rows])
    other = np.any(np.diff([track[rows], scene.sensor_key[rows]], axis=1) != 0, axis=0)
    cut = other | (steps <= 0) | (steps > tuning.max_gap_s)
    return [stretch for stretch in np.split(rows, np.flatnonzero(cut) + 1) if len(stretch) > 1]


def find_readout(
    model: pycolmap.Reconstruction, scene: Scene, fixed_rigs: Collection[int], tuning: Tuning
) -> Readout | None:
    """The readout of all cameras of a model by its residuals; None without times, motion or redundancy.

    All lenses are unknowns, calibrated ones too, and the frames of a relaxed rig are free of each other.
    """
    motion = image_motion(model, scene, tuning.shutter)
    if not motion:
        return None
    free = free_cameras(model, tuning.adjust)
    loose = lens.extended(model, lens.extensible(model, free, ("RADIAL", *lens.UNDISTORTED)))
    layout = Layout(loose, free, set(model.rigs) - set(fixed_rigs))
    try:
        found = Linearised(loose, layout, {}, tuning, tuning.shutter.most_points)
        told = found.weighed.score(_column(loose, found.weighed.seen, motion))
    except (ValueError, RuntimeError, np.linalg.LinAlgError):
        return None
    information = float(told.information[0, 0])
    if information <= 0:
        return None
    square = np.sum(found.weighed.seen.residual.reshape(-1, 2) ** 2, axis=1)
    cost = tuning.adjust.robust_px**2 * float(np.sum(np.log1p(square / tuning.adjust.robust_px**2)))
    score = float(told.score[0])
    first, second = found.weights
    images = np.array(sorted(scene.image_index[model.image(i).name] for i in motion), int)
    gaps = [np.diff(scene.time_s[scene.frame[s]]) for s in _stretches(images, scene, tuning.shutter)]
    return Readout(
        seconds=-score / information,
        step=-score / information * float(second.sum() / first.sum()),
        sigma=float(np.sqrt(max(told.noise[0, 0], 0.0))) / information,
        gain=score**2 / information / max(cost, 1e-12),
        gap_s=float(np.median(np.concatenate(gaps))),
    )


def _column(model: pycolmap.Reconstruction, seen: System, motion: Mapping[int, np.ndarray]) -> sparse.csr_matrix:
    """(2O, 1) derivative of the observations by the readout."""
    images, number = np.unique(seen.image, return_inverse=True)
    speed = np.stack([motion.get(i, np.zeros(6)) for i in images.tolist()])[number]
    height = np.array([model.camera(model.image(i).camera_id).height for i in images.tolist()])[number]
    late = seen.xy[:, 1] / height - 0.5
    moved = np.cross(speed[:, 3:], seen.lever) + speed[:, :3]
    values = -np.einsum("oij,oj->oi", seen.by_point, moved) * late[:, None]
    return sparse.csr_matrix(values.reshape(-1, 1))


def unrolled(
    mapped: pycolmap.Reconstruction, model: pycolmap.Reconstruction, scene: Scene, seconds: float, tuning: ShutterTuning
) -> pycolmap.Reconstruction:
    """A copy of ``mapped`` with its key points where the pose of the middle row would see them.

    Poses, motion and points are those of ``model``, which was made of it; points that it let go of stand where
    ``mapped`` has them.
    """
    out, motion = pycolmap.Reconstruction(mapped), image_motion(model, scene, tuning)
    both = sorted(set(mapped.reg_image_ids()) & set(model.reg_image_ids()))
    before, after = (np.array([m.image(i).projection_center() for i in both]) for m in (mapped, model))
    fit = umeyama(before, after)
    for image_id in both:
        image, now = out.image(image_id), model.image(image_id)
        camera = model.camera(now.camera_id)
        points = [image.points2D[k] for k in image.get_observation_point2D_idxs()]
        if image_id not in motion or not points:
            continue
        keys = [p.point3D_id for p in points]
        xyz = np.array([model.point3D(k).xyz if model.exists_point3D(k) else fit(mapped.point3D(k).xyz) for k in keys])
        late = seconds * (np.array([p.xy[1] for p in points]) / camera.height - 0.5)[:, None]
        velocity, rate = np.split(motion[image_id], 2)
        lever = xyz - now.projection_center()
        then = Rotation.from_rotvec(-late * rate).apply(lever - late * velocity)
        turn = now.cam_from_world().rotation.matrix().T
        shift = camera.img_from_cam(then @ turn) - camera.img_from_cam(lever @ turn)
        for point, moved in zip(points, shift):
            if np.isfinite(moved).all():
                point.xy = point.xy - moved
    return out
