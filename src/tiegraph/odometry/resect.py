"""The pose of a frame by points of the map: pycolmap's generalised absolute pose, for rigs of one camera too."""

from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.odometry.cameras import Cameras
from tiegraph.odometry.follow import Tracks
from tiegraph.odometry.tuning import PoseTuning
from tiegraph.scene.colmapmodel import matrix, rigid3d


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
    sides = np.array([cameras.side_px(c) for c in range(len(cameras))])[before.camera]
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
