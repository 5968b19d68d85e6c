"""The final bundle adjustment: robust, with free principal points, which COLMAP's mappers hold fixed."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.scene.colmapmodel import all_images, factorised, options_of, undamped
from tiegraph.sfm.adjustment import lens, leverarmprior
from tiegraph.sfm.adjustment.constraints import NOTHING, PoseConstraints, add_priors
from tiegraph.sfm.tuning import AdjustTuning, FewPointsTuning

Cameras = dict[int, pycolmap.Camera] | pycolmap.CameraMap
_AT_LENS = 1e-3  # of the median distance of a point: what is nearer stood still in the images while the camera did


@dataclass(frozen=True)
class Adjustment:
    """The outcome of the final adjustment."""

    model: pycolmap.Reconstruction
    note: str


def final_adjustment(
    model: pycolmap.Reconstruction,
    fixed_rigs: Collection[int] = (),
    constant_cameras: Collection[int] = (),
    soft: PoseConstraints = NOTHING,
    doubted: Collection[int] = (),
    *,
    tuning: AdjustTuning,
) -> Adjustment:
    """Adjust poses, points, rig and intrinsics with principal points: once plainly, then twice robustly (Cauchy scale
    0.5 px) after points above 2 px were removed.

    All adjustments but the last use few points where there are many: the longest tracks, spread over each image. They
    need poses good to a tenth of a pixel, not the best possible ones, and their time grows with the number of
    observations. COLMAP's mappers do the same (github.com/colmap/colmap/pull/3650).

    ``fixed_rigs``: COLMAP ids of rigs whose extrinsics are held. ``constant_cameras``, and cameras with fewer than 10
    images, keep their intrinsics (KITTI, driving straight on: free principal points run off by 30 px); free radial
    cameras become OPENCV (``lens``). ``soft``: poses that are known with a sigma. ``doubted``: constant cameras whose
    calibration is released if that explains the images clearly better. A camera whose adjusted intrinsics are
    impossible for a lens keeps its own, and a note says so.
    """
    free = free_cameras(model, tuning) - set(constant_cameras)
    adjusted = lens.extended(model, lens.extensible(model, free))
    if leverarmprior.bring_back(adjusted, fixed_rigs, soft.nominal, tuning):
        solve_points(adjusted, tuning)
    drop_momentary(adjusted, tuning.enough_seen)
    few, last = thinned(adjusted, tuning.few_points), tuning.model_copy(update={"iterations": tuning.last_iterations})
    _solve(few, fixed_rigs, free, False, soft, tuning)
    for _ in range(tuning.robust_rounds - 1):
        pycolmap.ObservationManager(few).filter_all_points3D(tuning.filter_px, tuning.filter_angle_deg)
        _solve(few, fixed_rigs, free, True, soft, tuning)
    if few is not adjusted:
        take_poses(adjusted, few)
        solve_points(adjusted, tuning)
    if few is not adjusted or tuning.robust_rounds:
        pycolmap.ObservationManager(adjusted).filter_all_points3D(tuning.filter_px, tuning.filter_angle_deg)
        _solve(adjusted, fixed_rigs, free, tuning.robust_rounds > 0, soft, last)
    asked = free_cameras(adjusted, tuning) & set(doubted)
    adjusted, lenses = _with_doubted(adjusted, fixed_rigs, free, asked, soft, last)
    without_outliers(adjusted, tuning)
    bad = impossible_camera(model.cameras, adjusted.cameras, free, tuning)
    if bad:
        held = final_adjustment(model, fixed_rigs, {*constant_cameras, bad}, soft, doubted, tuning=tuning)
        note = f"camera {bad} keeps its intrinsics, because the adjusted ones are impossible for a lens; {held.note}"
        return Adjustment(held.model, note)
    before, after = model.compute_mean_reprojection_error(), adjusted.compute_mean_reprojection_error()
    moved = [_centre_shift(model.cameras[c], adjusted.cameras[c]) for c in free]
    note = f"final robust adjustment: mean reprojection error {before:.3f} -> {after:.3f} px"
    if moved:
        note += f", principal points moved by up to {max(moved):.1f} px"
    return Adjustment(adjusted, note + lenses)


def adjusted_to(
    model: pycolmap.Reconstruction,
    fixed_rigs: Collection[int],
    constant_cameras: Collection[int],
    soft: PoseConstraints,
    *,
    tuning: AdjustTuning,
) -> pycolmap.Reconstruction:
    """A copy of an adjusted model whose frames are moved to the given ``places``, if there are any; everything else
    follows as the images determine it. This is the last step of ``final_adjustment``.

    The points are first moved to where their rays meet. Points far out in the robust loss slide for tens of steps,
    and an adjustment that waits for them does not stop when everything else has converged.
    """
    out = pycolmap.Reconstruction(model)
    solve_points(out, tuning)
    free, last = free_cameras(out, tuning) - set(constant_cameras), {"iterations": tuning.last_iterations}
    _solve(out, fixed_rigs, free, True, soft, tuning.model_copy(update=last))
    without_outliers(out, tuning)
    return out


def without_outliers(model: pycolmap.Reconstruction, tuning: AdjustTuning) -> None:
    """Remove the points that the robust loss gave up; points that went behind a camera have an infinite error.

    Dirt on a lens, or the pattern of a lamp's light, stands still in the images. While the camera stands too, such a
    point moves into the lens without any error: one at 9 micrometres made the normal equations of a whole rig void.
    """
    manager = pycolmap.ObservationManager(model)
    manager.filter_observations_with_negative_depth()
    manager.filter_all_points3D(tuning.filter_px, tuning.filter_angle_deg)
    ids = np.array(sorted(model.point3D_ids()), int)
    xyz = np.array([model.point3D(k).xyz for k in ids.tolist()]).reshape(-1, 3)
    nearest = np.full(len(ids), np.inf)
    for image in (model.image(i) for i in model.reg_image_ids()):
        at = np.searchsorted(ids, np.array([p.point3D_id for p in image.get_observation_points2D()], int))
        np.minimum.at(nearest, at, np.linalg.norm(xyz[at] - image.projection_center(), axis=1))
    for key in ids[nearest < _AT_LENS * np.median(nearest)].tolist() if len(ids) else ():
        model.delete_point3D(key)
    model.update_point_3d_errors()


def _with_doubted(
    model: pycolmap.Reconstruction,
    fixed_rigs: Collection[int],
    free: set[int],
    doubted: set[int],
    soft: PoseConstraints,
    tuning: AdjustTuning,
) -> tuple[pycolmap.Reconstruction, str]:
    """The model adjusted with free distortion of these calibrated cameras, if that explains the images better, and a
    note."""
    names = lens.extensible(model, doubted, lens.UNDISTORTED)
    if not names:
        return model, ""
    trial = lens.extended(model, names)
    given = {k: model.camera(k) for k in names}
    _solve(trial, fixed_rigs, free | set(names), True, soft, tuning, given)
    gain = 1 - robust_cost(trial, tuning.robust_px) / max(robust_cost(model, tuning.robust_px), 1e-12)
    if gain < tuning.used_gain:
        return model, ""
    most = max(lens.difference_px(model.camera(k), trial.camera(k)) for k in names)
    return trial, (
        "; the lenses differ from their calibration: distortion and small changes of the other parameters were "
        f"estimated, up to {most:.1f} px (median over the image), and the robust sum of squares fell by "
        f"{100 * gain:.0f} %"
    )


def drop_momentary(model: pycolmap.Reconstruction, enough: int) -> int:
    """Delete points seen only by cameras of one shot, where their frames see enough other points; returns their
    number.

    The cameras of a rig are centimetres apart: any match between two of them in one shot, right or wrong, intersects
    somewhere on an epipolar line. Wrong matches intersect close to the rig, where a point has a large weight; points
    of right matches are seen again by other shots. On canal 21 of 42 000 points, 0.2 to 0.9 m away in empty water,
    bent the path by 4 mm.
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
    gone = [key for f, keys in momentary.items() if others[f] >= enough for key in keys]
    for key in gone:
        model.delete_point3D(key)
    return len(gone)


def robust_cost(model: pycolmap.Reconstruction, scale_px: float) -> float:
    """Mean Cauchy cost of an observation, px2: the cost function of the robust adjustment."""
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
        total += float(np.sum(scale_px**2 * np.log1p(square / scale_px**2)))
        count += len(seen)
    return total / max(count, 1)


def free_cameras(model: pycolmap.Reconstruction, tuning: AdjustTuning) -> set[int]:
    """COLMAP ids of the cameras with enough images that see points; all other cameras keep their intrinsics."""
    images = [model.image(i) for i in model.reg_image_ids()]
    cameras = [i.camera_id for i in images if i.num_points3D >= tuning.min_points]
    return {c for c in set(cameras) if cameras.count(c) >= tuning.min_images}


def _solve(
    model: pycolmap.Reconstruction,
    fixed_rigs: Collection[int],
    free: set[int],
    robust: bool,
    soft: PoseConstraints,
    tuning: AdjustTuning,
    given: Mapping[int, pycolmap.Camera] | None = None,
) -> None:
    options = options_of(
        tuning.iterations, tuning.tolerance, tuning.robust_px if robust else None, refine_principal_point=True
    )
    factorised(options, model.num_reg_frames(), model.num_reg_images())
    config = all_images(model)
    for camera_id in model.cameras:
        if camera_id not in free:
            config.set_constant_cam_intrinsics(camera_id)
    held = False
    for rig_id in fixed_rigs:
        for sensor in model.rigs[rig_id].non_ref_sensors if rig_id in model.rigs else ():
            config.set_constant_sensor_from_rig_pose(sensor)
            held = True
    if soft.places:  # nothing is free, and the model is near its end
        undamped(options)
    elif soft:  # lengths are among what is known: only place and attitude are free
        config.set_constant_rig_from_world_pose(_anchor(model))
    elif not held:  # a rig of fixed size fixes the scale; two fixed cameras would fix it once more
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, model)
    kept = add_priors(adjuster, model, soft, tuning, given)
    adjuster.solve()
    del kept


def solve_points(model: pycolmap.Reconstruction, tuning: AdjustTuning) -> None:
    """Move each point to where its rays meet; everything else is held."""
    options = options_of(
        tuning.last_iterations,
        tuning.tolerance,
        tuning.robust_px,
        refine_focal_length=False,
        refine_principal_point=False,
        refine_extra_params=False,
        refine_sensor_from_rig=False,
        refine_rig_from_world=False,
    )
    pycolmap.create_default_ceres_bundle_adjuster(options, all_images(model), model).solve()


def _anchor(model: pycolmap.Reconstruction) -> int:
    """A frame to hold fixed: the one that sees most points."""
    seen = dict.fromkeys(model.reg_frame_ids(), 0)
    for i in model.reg_image_ids():
        image = model.image(i)
        seen[image.frame_id] += image.num_points3D
    return max(seen, key=lambda f: (seen[f], -f))


def _centre_shift(a: pycolmap.Camera, b: pycolmap.Camera) -> float:
    return float(np.hypot(a.principal_point_x - b.principal_point_x, a.principal_point_y - b.principal_point_y))


def impossible_camera(before: Cameras, after: Cameras, cameras: Collection[int], tuning: AdjustTuning) -> int | None:
    """The first of ``cameras`` (COLMAP ids) whose adjusted intrinsics are impossible for a lens, or None."""
    least, most = tuning.focal_range
    for camera_id in sorted(cameras):
        camera = after[camera_id]
        size = max(camera.width, camera.height)
        was = before[camera_id].mean_focal_length() / size
        ratio = camera.mean_focal_length() / size
        plausible = least <= ratio <= most or not least <= was <= most
        if not plausible or not np.isfinite(camera.params).all():
            return camera_id
        if _centre_shift(before[camera_id], camera) > tuning.max_centre_shift * size:
            return camera_id
    return None


def take_possible(model: pycolmap.Reconstruction, given: Cameras, tuning: AdjustTuning) -> list[int]:
    """Give the cameras that too few images support for an adjustment, and whose intrinsics ran off, the
    ``given`` ones, and remove their observations, which those do not explain; returns their ids."""
    out, asked = [], set(given) & set(model.cameras) - free_cameras(model, tuning)
    while (key := impossible_camera(given, model.cameras, asked, tuning)) is not None:
        model.camera(key).model, model.camera(key).params = given[key].model, given[key].params.tolist()
        for image in [i for i in model.images.values() if i.camera_id == key]:
            for row in image.get_observation_point2D_idxs():
                if image.point2D(row).has_point3D():  # else the point went with its last but one observation
                    model.delete_observation(image.image_id, row)
        out.append(key)
        asked.discard(key)
    return out


def thinned(model: pycolmap.Reconstruction, tuning: FewPointsTuning) -> pycolmap.Reconstruction:
    """A copy without the points that are not needed yet; the model itself where too few could be left out."""
    waiting = points_that_can_wait(model, tuning)
    if not waiting:
        return model
    out = pycolmap.Reconstruction(model)
    for point_id in waiting:
        out.delete_point3D(point_id)
    return out


def take_poses(model: pycolmap.Reconstruction, few: pycolmap.Reconstruction) -> None:
    """Give ``model`` the intrinsics, rigs and poses of its copy that was adjusted with fewer points; its points
    follow the images that see them."""
    _take_points_along(model, few)
    lens.take_cameras(model, few)
    for key, rig in few.rigs.items():
        for sensor, extrinsics in rig.non_ref_sensors.items():
            if extrinsics is not None:
                model.rig(key).set_sensor_from_rig(sensor, extrinsics)
    for key in few.reg_frame_ids():
        model.frame(key).rig_from_world = few.frame(key).rig_from_world


def _take_points_along(model: pycolmap.Reconstruction, few: pycolmap.Reconstruction) -> None:
    """Move each point to the mean of the places that follow from the new poses in ``few`` of the images that see it.

    A model of thousands of images straightens by metres in its first adjustment. Points that were not moved along
    exceeded the limits in pixels and were lost (479 of 599 thousand of 4020 images), and the rigs looked torn.
    """
    ids = np.array(sorted(model.point3D_ids()), int)
    place = np.stack([model.point3D(k).xyz for k in ids.tolist()]) if len(ids) else np.zeros((0, 3))
    total, count = np.zeros_like(place), np.zeros(len(ids))
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        at = np.searchsorted(ids, np.array([p.point3D_id for p in image.get_observation_points2D()], int))
        moved = (few.image(image_id).cam_from_world().inverse() * image.cam_from_world()).matrix()
        np.add.at(total, at, place[at] @ moved[:, :3].T + moved[:, 3])
        np.add.at(count, at, 1)
    for k, xyz in zip(ids[count > 0].tolist(), total[count > 0] / count[count > 0, None]):
        model.point3D(k).xyz = xyz


def points_that_can_wait(model: pycolmap.Reconstruction, tuning: FewPointsTuning) -> list[int]:
    """Ids, in order, of the points that are not among the longest tracks of any cell of any image; none if more than
    the worthwhile share of the observations would stay."""
    cell, point = _sightings(model, tuning.cells)
    length = dict(zip(*(v.tolist() for v in np.unique(point, return_counts=True))))
    order = np.lexsort((point, -np.array([length[p] for p in point.tolist()], int), cell))
    _, start, count = np.unique(cell[order], return_index=True, return_counts=True)
    rank = np.arange(len(order)) - np.repeat(start, count)
    telling = np.unique(point[order][rank < tuning.in_a_cell])
    if np.isin(point, telling).sum() > tuning.worth * len(point):
        return []
    return np.setdiff1d(np.array(sorted(model.point3D_ids()), int), telling).tolist()


def _sightings(model: pycolmap.Reconstruction, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """(O,) number of the image's cell and (O,) id of the point, for every observation."""
    cell, point = [np.zeros(0, int)], [np.zeros(0, int)]
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        seen = image.get_observation_points2D()
        if not seen or image.camera is None:
            continue
        size = np.array([image.camera.width, image.camera.height])
        column, row = (np.clip(np.stack([p.xy for p in seen]) / size, 0, 1 - 1e-9) * cells).astype(int).T
        cell.append((image_id * cells + row) * cells + column)
        point.append(np.array([p.point3D_id for p in seen]))
    return np.concatenate(cell), np.concatenate(point)
