"""The accuracy of a pair by itself as paper 002 has it: how far a bundle adjustment of two images moves their base."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.sfm.model import rigid3d
from tiegraph.sfm.solver import repeatable
from tiegraph.sfm.tuning import TwoViewTuning


@dataclass(frozen=True)
class TwoView:
    """``moved``: |T - T'| of unit bases, T of the reconstruction from the essential matrix, T' after the adjustment
    (paper 002, section 2.4); ``range``: distance of the points from the first image, in bases (its equation 1, but the
    median: at a short base a few points come out so far away that they alone make the mean)."""

    moved: float
    range: float


def two_view(
    xy_a: np.ndarray,
    xy_b: np.ndarray,
    camera_a: pycolmap.Camera,
    camera_b: pycolmap.Camera,
    tuning: TwoViewTuning,
    pixel: float = 1.0,
) -> TwoView | None:
    """Reconstruct two images from matches xy_a, xy_b (K, 2) pixels and adjust them; None where no geometry is found.

    ``pixel``: size of a pixel of the matches in those of the cameras (previews are reduced images).
    """
    if len(xy_a) < tuning.min_points:
        return None
    rays_a, rays_b = (np.asarray(c.cam_from_img(np.asarray(x, float))) for c, x in ((camera_a, xy_a), (camera_b, xy_b)))
    good = np.isfinite(rays_a).all(axis=1) & np.isfinite(rays_b).all(axis=1)
    if good.sum() < tuning.min_points:
        return None
    focal = 0.5 * (camera_a.mean_focal_length() + camera_b.mean_focal_length())
    eye = np.eye(3)
    bound = tuning.max_error_px * pixel / focal
    essential, mask = cv2.findEssentialMat(
        rays_a[good], rays_b[good], eye, cv2.RANSAC, tuning.confidence, bound, tuning.trials
    )
    if essential is None or essential.shape != (3, 3):
        return None
    _, rotation, base, front, points = cv2.recoverPose(
        essential, rays_a[good], rays_b[good], eye, distanceThresh=tuning.farthest, mask=mask.copy()
    )
    ahead = np.asarray(front).ravel() > 0
    if ahead.sum() < tuning.min_points:
        return None
    xyz = (points[:3] / points[3]).T[ahead]
    b_from_a = transforms.rigid(rotation, base.ravel())
    moved = _adjusted((xy_a[good][ahead], xy_b[good][ahead]), (camera_a, camera_b), b_from_a, xyz, tuning.iterations)
    before = b_from_a[:3, 3] / np.linalg.norm(b_from_a[:3, 3])
    after = moved / max(float(np.linalg.norm(moved)), 1e-12)
    distance = float(np.median(np.linalg.norm(xyz, axis=1)))
    return TwoView(float(np.linalg.norm(before - after)), distance)


def _adjusted(
    xy: tuple[np.ndarray, np.ndarray],
    cameras: tuple[pycolmap.Camera, ...],
    b_from_a: np.ndarray,
    xyz: np.ndarray,
    iterations: int,
) -> np.ndarray:
    """Translation (3,) of the second image after a bundle adjustment with fixed intrinsics."""
    model = pycolmap.Reconstruction()
    for k, (camera, pose) in enumerate(zip(cameras, (np.eye(4), b_from_a)), 1):
        own = pycolmap.Camera(model=camera.model, width=camera.width, height=camera.height, params=camera.params)
        own.camera_id = k
        model.add_camera_with_trivial_rig(own)
        image = pycolmap.Image(name=str(k), keypoints=np.asarray(xy[k - 1], float), camera_id=k, image_id=k)
        model.add_image_with_trivial_frame(image, rigid3d(pose))
    for n, point in enumerate(xyz):
        track = pycolmap.Track([pycolmap.TrackElement(1, n), pycolmap.TrackElement(2, n)])
        model.add_point3D(point, track)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    solver = options.ceres.solver_options
    solver.max_num_iterations = iterations
    options.ceres.solver_options = solver
    repeatable(options)
    config = pycolmap.BundleAdjustmentConfig()
    for k in (1, 2):
        config.add_image(k)
        config.set_constant_cam_intrinsics(k)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    level, pycolmap.logging.minloglevel = pycolmap.logging.minloglevel, 2  # pairs without a base make it complain
    try:
        pycolmap.create_default_ceres_bundle_adjuster(options, config, model).solve()
    finally:
        pycolmap.logging.minloglevel = level
    return np.asarray(model.image(2).cam_from_world().translation, float)
