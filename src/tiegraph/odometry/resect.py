"""The pose of a frame by points of the map: pycolmap's generalised absolute pose, for rigs of one camera too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.odometry.cameras import Cameras
from tiegraph.odometry.tuning import PoseTuning
from tiegraph.scene.colmapmodel import matrix, rigid3d

_SEED = 0


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
    found = None
    if guess is not None:
        found = _refined(cameras, camera, xy, points, guess, tuning)
    if (found is None or found.inlier.mean() < tuning.share) and len(xy) >= tuning.least_points:
        pose = _ransac(cameras, camera, xy, points, tuning)
        other = None if pose is None else _refined(cameras, camera, xy, points, pose, tuning)
        if other is not None and (found is None or other.inlier.sum() > found.inlier.sum()):
            found = other
    good = found is not None and found.inlier.sum() >= tuning.least_points and found.inlier.mean() >= tuning.least_share
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


def _ransac(
    cameras: Cameras, camera: np.ndarray, xy: np.ndarray, points: np.ndarray, tuning: PoseTuning
) -> np.ndarray | None:
    low, high = tuning.trials
    options = pycolmap.RANSACOptions(
        max_error=tuning.inlier_px, min_num_trials=low, max_num_trials=high, random_seed=_SEED
    )
    made = pycolmap.estimate_generalized_absolute_pose(
        xy, points, camera.tolist(), cameras.rigid, list(cameras.models), options
    )
    return None if made is None else matrix(made["rig_from_world"])
