"""The final bundle adjustment: robust, with principal points, which COLMAP's mappers hold fixed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.sfm import lens
from tiegraph.sfm.model import MIN_OBSERVATIONS
from tiegraph.sfm.priors import add_priors
from tiegraph.sfm.rig.soft import Soft
from tiegraph.sfm.solver import factorised

# A principal point 6 px off in a 232 px lens turns its camera by 1.5 degrees against the rig and bends the model: on
# canal_demo (nominal rig, guessed intrinsics) this step brings the trajectory error from 0.06-0.09 m to 0.01-0.03 m.
MIN_IMAGES = 10  # of a camera, to adjust its intrinsics once more with the principal point
ROBUST_PX = 0.5  # Cauchy scale: about the sigma of a SIFT key point
FILTER_PX = 2.0  # observations worse than this after the first pass go
FILTER_ANGLE_DEG = 1.0
FIRST_ITERATIONS, ROBUST_ITERATIONS = 30, 10
# The first plain solution is bent by what is filtered after it, and what the robust one shows to be wrong pulls on it
# still: once more without that, canal_demo is 4.7 mm off for 6.5 and canal 6.8 for 12.4, in the same time.
ROBUST_ROUNDS = 2
ENOUGH_SEEN = 50  # points of a frame that other frames see too: its place needs no others
TOLERANCE = 1e-6  # of the cost: canal_demo's trajectory is the same to 0.001 mm, in three quarters of the time
MAX_CENTRE_SHIFT = 0.1  # of the image size; more is a bent model, not a lens
LENS_GAIN = 0.03  # of the robust cost: what distortion must gain over a calibration to be believed against it
FOCAL_RANGE = (0.2, 5.0)  # times the longer image side: outside, no lens of a survey camera

Cameras = dict[int, pycolmap.Camera] | pycolmap.CameraMap


@dataclass(frozen=True)
class Adjustment:
    """The outcome of the final adjustment; ``model`` is the input itself if the result was refused."""

    model: pycolmap.Reconstruction
    accepted: bool
    note: str


def final_adjustment(
    model: pycolmap.Reconstruction,
    fixed_rigs: Collection[int] = (),
    constant_cameras: Collection[int] = (),
    soft: Soft | None = None,
    doubted: Collection[int] = (),
) -> Adjustment:
    """Adjust poses, points, rig, intrinsics with principal points: plain, then twice cut at 2 px and Cauchy at 0.5 px.

    ``fixed_rigs``: COLMAP rig ids whose extrinsics stay. ``constant_cameras``, and those with fewer than 10 images,
    keep their intrinsics (KITTI, driving straight on: free principal points run off by 30 px); free RADIAL ones become
    OPENCV (``lens``). ``soft``: what is known of poses with a sigma. ``doubted``: constant cameras whose calibration
    gives way if that explains the images clearly better. Impossible intrinsics are refused and said so.
    """
    free = free_cameras(model) - set(constant_cameras)
    adjusted = lens.extended(model, lens.extensible(model, free))
    drop_momentary(adjusted)
    _solve(adjusted, fixed_rigs, free, False, soft)
    for _ in range(ROBUST_ROUNDS):
        pycolmap.ObservationManager(adjusted).filter_all_points3D(FILTER_PX, FILTER_ANGLE_DEG)
        _solve(adjusted, fixed_rigs, free, True, soft)
    adjusted, lenses = _with_doubted(adjusted, fixed_rigs, free, free_cameras(adjusted) & set(doubted), soft)
    # The robust loss lets go of some points; those that went behind a camera have an infinite error.
    manager = pycolmap.ObservationManager(adjusted)
    manager.filter_observations_with_negative_depth()
    manager.filter_all_points3D(FILTER_PX, FILTER_ANGLE_DEG)
    adjusted.update_point_3d_errors()
    bad = impossible_camera(model.cameras, adjusted.cameras, free)
    if bad:
        note = f"the final adjustment with principal points was refused: impossible intrinsics of camera {bad}"
        return Adjustment(model, False, note)
    before, after = model.compute_mean_reprojection_error(), adjusted.compute_mean_reprojection_error()
    moved = [_centre_shift(model.cameras[c], adjusted.cameras[c]) for c in free]
    note = f"final robust adjustment: mean reprojection error {before:.3f} -> {after:.3f} px"
    if moved:
        note += f", principal points moved by up to {max(moved):.1f} px"
    return Adjustment(adjusted, True, note + lenses)


def _with_doubted(
    model: pycolmap.Reconstruction, fixed_rigs: Collection[int], free: set[int], doubted: set[int], soft: Soft | None
) -> tuple[pycolmap.Reconstruction, str]:
    """The model adjusted with distortion of these calibrated cameras, if that explains the images better; a note."""
    names = lens.extensible(model, doubted, lens.UNDISTORTED)
    if not names:
        return model, ""
    trial = lens.extended(model, names)
    given = {k: model.camera(k) for k in names}
    _solve(trial, fixed_rigs, free | set(names), True, soft, given)
    gain = 1 - robust_cost(trial) / max(robust_cost(model), 1e-12)
    if gain < LENS_GAIN:
        return model, ""
    most = max(lens.difference_px(model.camera(k), trial.camera(k)) for k in names)
    return trial, (
        f"; the lenses are not as calibrated: distortion and small changes of the rest were estimated, up to "
        f"{most:.1f} px (median over the image), and the robust sum of squares fell by {100 * gain:.0f} %"
    )


def drop_momentary(model: pycolmap.Reconstruction) -> int:
    """Delete the points that only cameras of one shot see, where their frames see enough others; how many went.

    The cameras of a rig stand centimetres apart: what two of them match in one shot, right or wrong, meets somewhere on
    an epipolar line, near by if it is wrong, and a point near by weighs much. Right ones are seen again. On canal 21 of
    42 000 points, 0.2 to 0.9 m away where nothing is, bent the path by 4 mm.
    """
    frame = {i: model.image(i).frame_id for i in model.reg_image_ids()}
    others = dict.fromkeys(model.reg_frame_ids(), 0)
    momentary: dict[int, list[int]] = {}
    for key, point in model.points3D.items():
        frames = {frame[e.image_id] for e in point.track.elements}
        if len(frames) == 1:
            momentary.setdefault(frames.pop(), []).append(key)
        else:
            for f in frames:
                others[f] += 1
    gone = [key for f, keys in momentary.items() if others[f] >= ENOUGH_SEEN for key in keys]
    for key in gone:
        model.delete_point3D(key)
    return len(gone)


def robust_cost(model: pycolmap.Reconstruction) -> float:
    """Mean Cauchy cost of an observation, px2: the measure of the robust adjustment."""
    total, count = 0.0, 0
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        seen = image.get_observation_points2D()
        if not seen or image.camera is None:
            continue
        world = np.stack([model.point3D(p.point3D_id).xyz for p in seen])
        pose = image.cam_from_world().matrix()
        projected = np.asarray(image.camera.img_from_cam(world @ pose[:, :3].T + pose[:, 3]), float)
        error = projected - np.stack([p.xy for p in seen])
        square = np.sum(error[np.isfinite(error).all(axis=1)] ** 2, axis=1)
        total += float(np.sum(ROBUST_PX**2 * np.log1p(square / ROBUST_PX**2)))
        count += len(seen)
    return total / max(count, 1)


def free_cameras(model: pycolmap.Reconstruction) -> set[int]:
    """COLMAP ids of the cameras with at least 10 images that see points: the others keep their intrinsics."""
    images = [model.image(i) for i in model.reg_image_ids()]
    cameras = [i.camera_id for i in images if i.num_points3D >= MIN_OBSERVATIONS]
    return {c for c in set(cameras) if cameras.count(c) >= MIN_IMAGES}


def _solve(
    model: pycolmap.Reconstruction,
    fixed_rigs: Collection[int],
    free: set[int],
    robust: bool,
    soft: Soft | None,
    given: Mapping[int, pycolmap.Camera] | None = None,
) -> None:
    options = pycolmap.BundleAdjustmentOptions(print_summary=False, refine_principal_point=True)
    if robust:
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = ROBUST_PX
    solver = options.ceres.solver_options
    solver.max_num_iterations = ROBUST_ITERATIONS if robust else FIRST_ITERATIONS
    solver.function_tolerance = TOLERANCE
    options.ceres.solver_options = solver
    factorised(options, model.num_reg_frames(), model.num_reg_images())
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    for camera_id in model.cameras:
        if camera_id not in free:
            config.set_constant_cam_intrinsics(camera_id)
    held = False
    for rig_id in fixed_rigs:
        for sensor in model.rigs[rig_id].non_ref_sensors if rig_id in model.rigs else ():
            config.set_constant_sensor_from_rig_pose(sensor)
            held = True
    if soft:  # lengths are among what is known: only place and attitude are free
        config.set_constant_rig_from_world_pose(_anchor(model))
    elif not held:  # a rig of fixed size fixes the scale; two fixed cameras would fix it once more
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, model)
    kept = add_priors(adjuster, model, soft, given)
    adjuster.solve()
    del kept


def _anchor(model: pycolmap.Reconstruction) -> int:
    """A frame to hold still: the one that sees most points."""
    seen = dict.fromkeys(model.reg_frame_ids(), 0)
    for i in model.reg_image_ids():
        image = model.image(i)
        seen[image.frame_id] += image.num_points3D
    return max(seen, key=lambda f: (seen[f], -f))


def _centre_shift(a: pycolmap.Camera, b: pycolmap.Camera) -> float:
    return float(np.hypot(a.principal_point_x - b.principal_point_x, a.principal_point_y - b.principal_point_y))


def impossible_camera(before: Cameras, after: Cameras, cameras: Collection[int]) -> int | None:
    """The first of ``cameras`` (COLMAP ids) whose adjusted intrinsics no lens has, or None."""
    for camera_id in sorted(cameras):
        camera = after[camera_id]
        size = max(camera.width, camera.height)
        was = before[camera_id].mean_focal_length() / size
        ratio = camera.mean_focal_length() / size
        plausible = FOCAL_RANGE[0] <= ratio <= FOCAL_RANGE[1] or not FOCAL_RANGE[0] <= was <= FOCAL_RANGE[1]
        if not plausible or not np.isfinite(camera.params).all():
            return camera_id
        if _centre_shift(before[camera_id], camera) > MAX_CENTRE_SHIFT * size:
            return camera_id
    return None
