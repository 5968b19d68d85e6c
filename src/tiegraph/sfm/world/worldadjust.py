"""The bundle adjustment in the world: images, positions and control points together, against drift and bending."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyceres
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity, umeyama
from tiegraph.geometry.gravity import Up
from tiegraph.scene.colmapmodel import image_poses, matrix
from tiegraph.scene.control import Control, Marks, ScaleBars
from tiegraph.scene.scene import Scene
from tiegraph.scene.solver import all_images, factorised, options_of, undamped
from tiegraph.sfm.adjustment.adjust import free_cameras, solve_points
from tiegraph.sfm.adjustment.constraints import RelativePosePrior, add_priors
from tiegraph.sfm.adjustment.costs import PriorCost
from tiegraph.sfm.adjustment.rigpriors import relaxed_frames, rig_priors
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.tuning import AdjustTuning, Tuning
from tiegraph.sfm.tuning.world import AdjustmentTuning
from tiegraph.sfm.world import costs, positionerrors
from tiegraph.sfm.world.fixes import Fixes
from tiegraph.sfm.world.marks import Target, mark_sigma


@dataclass(frozen=True)
class ConstantParameters:
    """What an adjustment must leave as it is: COLMAP ids of rigs with calibrated extrinsics, and of such cameras;
    ``soft``: indices in the scene of rigs whose extrinsics are known with a sigma."""

    rigs: Collection[int] = ()
    cameras: Collection[int] = ()
    soft: Collection[int] = ()


@dataclass(frozen=True)
class Receiver:
    """Where the antenna is in the rig frame and how far its clock is behind the cameras', and which are unknowns."""

    antenna: np.ndarray  # (3,)
    offset_s: float
    free_antenna: bool
    free_offset: bool


@dataclass(frozen=True)
class Lengths:
    """Scale bars and their ends in the model; ``used`` (B,) those that are believed."""

    bars: ScaleBars
    ends: Sequence[Target]
    used: np.ndarray


@dataclass(frozen=True)
class Constraints:
    """What holds a model in the world besides its images; lengths in metres."""

    fixes: Fixes  # sigmas as stated
    factor: np.ndarray  # (K,) by which they are believed to be too small
    receiver: Receiver
    held: ConstantParameters
    tuning: Tuning
    control: Control | None = None
    targets: Sequence[Target] = ()
    point_factor: float = 1.0
    up: Up | None = None  # in the world: holds the tilt where positions do not
    lengths: Lengths | None = None


@dataclass(frozen=True)
class AdjustmentResult:
    """The model after it, lever arm, clock, residuals (K, 3) of the fixes (metres), factors, and pixel errors."""

    model: pycolmap.Reconstruction
    antenna: np.ndarray
    offset_s: float
    residual: np.ndarray
    factor: np.ndarray
    before_px: float
    after_px: float


def adjust_in_world(
    world: pycolmap.Reconstruction, scene: Scene, given: Constraints, rounds: int, filtered: bool = True
) -> AdjustmentResult:
    """Adjust a model that stands in the world by images, positions and control points; its points are where its rays
    meet (``settled``).

    Positions have a Cauchy loss over the vector, reprojections one of their own. Both weigh by their
    sigmas: that of a pixel comes from the residuals before. Between rounds, the factors of the positions' sigmas are
    estimated anew: where the images allow the model to follow the positions, they shrink; where they do not, they stay,
    and there is no further round.
    ``filtered``: without the points that fit no more; to go on from it they stay, for the rest rests on them.
    """
    model = pycolmap.Reconstruction(world)
    before = float(model.compute_mean_reprojection_error())
    factor, arm, clock = given.factor, np.array(given.receiver.antenna, float), np.array([given.receiver.offset_s])
    residual = residuals(model, scene, given.fixes, arm, float(clock[0]))
    ties = relaxed_frames(world, scene, given.tuning.rig.time_calibration)
    for _ in range(rounds):
        _solve(model, scene, replace(given, factor=factor), ties, (arm, clock))
        residual = residuals(model, scene, given.fixes, arm, float(clock[0]))
        last, factor = factor, factors(residual, given)
        if len(given.fixes) and np.all(np.abs(factor / last - 1) <= given.tuning.world.adjustment.same_factor):
            break
    if filtered:
        manager = pycolmap.ObservationManager(model)
        manager.filter_observations_with_negative_depth()
        manager.filter_all_points3D(given.tuning.adjust.filter_px, given.tuning.adjust.filter_angle_deg)
        model.update_point_3d_errors()
    after = float(model.compute_mean_reprojection_error())
    return AdjustmentResult(
        model=model,
        antenna=arm,
        offset_s=float(clock[0]),
        residual=residual,
        factor=factor,
        before_px=before,
        after_px=after,
    )


def factors(residual: np.ndarray, given: Constraints) -> np.ndarray:
    """(K,) of the fixes' sigmas, by residuals (K, 3), metres; those given where there is no fix."""
    if not len(given.fixes):
        return given.factor
    known, fixes = given.tuning.world.noise, given.fixes
    return positionerrors.factors(residual / fixes.sigma, fixes.level, fixes.time_s, known)


def settled(world: pycolmap.Reconstruction, tuning: AdjustTuning) -> pycolmap.Reconstruction:
    """A copy whose points are where their rays meet.

    Points far out in the robust loss slide for tens of steps, and an adjustment that waits for them does not stop when
    all else has: on canal_demo two steps after this end nearer to the minimum than 14 without it.
    """
    out = pycolmap.Reconstruction(world)
    solve_points(out, tuning)
    return out


def residuals(
    model: pycolmap.Reconstruction, scene: Scene, fixes: Fixes, antenna: np.ndarray, offset_s: float
) -> np.ndarray:
    """(K, 3) metres: antenna by a model in the world minus the measured positions."""
    pose, speed = fixes.blend(frame_poses(image_poses(model, scene), scene))
    moved = pose + offset_s * speed
    return moved[:, :3, 3] + moved[:, :3, :3] @ antenna - fixes.position


def pixel_sigma(model: pycolmap.Reconstruction, tuning: AdjustmentTuning) -> float:
    """Standard deviation of an image coordinate, robust, from the mean errors of the points."""
    errors = np.array([p.error for p in model.points3D.values()], float)
    errors = errors[np.isfinite(errors) & (errors >= 0)]
    # A Rayleigh variable's median is 1.177 sigma; a point's error is the mean over its images.
    if not len(errors):
        return tuning.unknown_pixel_sigma_px
    return max(float(np.median(errors)) / 1.253, tuning.min_pixel_sigma_px)


def _solve(
    model: pycolmap.Reconstruction,
    scene: Scene,
    given: Constraints,
    ties: Sequence[RelativePosePrior],
    receiver: tuple[np.ndarray, np.ndarray],
) -> None:
    """One adjustment; changes the model and the ``receiver``: lever arm (3,) and clock (1,)."""
    own = given.tuning.world.adjustment
    options = options_of(own.iterations, own.tolerance, given.tuning.adjust.robust_px, refine_principal_point=True)
    factorised(options, model.num_reg_frames(), model.num_reg_images())
    undamped(options)
    config = all_images(model)
    free = free_cameras(model, given.tuning.adjust) - set(given.held.cameras)
    for camera_id in model.cameras:
        if camera_id not in free:
            config.set_constant_cam_intrinsics(camera_id)
    for rig_id in given.held.rigs:
        for sensor in model.rigs[rig_id].non_ref_sensors if rig_id in model.rigs else ():
            config.set_constant_sensor_from_rig_pose(sensor)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, model)
    sigma_px = pixel_sigma(model, given.tuning.world.adjustment)
    kept = _add_positions(adjuster.problem, model, scene, given, (*receiver, sigma_px))
    kept += _add_points(adjuster.problem, model, scene, given, sigma_px)
    kept += _add_up(adjuster.problem, model, scene, given, sigma_px)
    known = rig_priors(model, scene, given.held.soft, given.tuning.rig.priors)
    kept += add_priors(adjuster, model, replace(known, relative_poses=ties), given.tuning.adjust)
    adjuster.solve()
    del kept  # the problem only borrows the residuals written in Python


def _frames_of(model: pycolmap.Reconstruction, scene: Scene) -> dict[int, tuple[Any, np.ndarray]]:
    """The model's pose block of each scene frame, and frame_from_rig: the scene's rig frame in the model's frame."""
    rigs = frame_poses(image_poses(model, scene), scene)
    out: dict[int, tuple[Any, np.ndarray]] = {}
    order = np.argsort(-scene.sensor.astype(int), kind="stable")  # the reference's image is looked at last
    for k in order:
        image = model.find_image_with_name(scene.names[k])
        if image is None or not image.has_pose or not np.isfinite(rigs[scene.frame[k]]).all():
            continue
        block = _pose(model, image)
        out[int(scene.frame[k])] = block, matrix(block) @ rigs[scene.frame[k]]
    return out


def _add_positions(
    problem: Any, model: pycolmap.Reconstruction, scene: Scene, given: Constraints, unknown: tuple
) -> list:
    """Residuals of the positions. A scene frame's pose must move with its images: lengths of the rig are metres now."""
    arm, clock, sigma_px = unknown
    fixes, kept, known = given.fixes, [], given.tuning.world.fit
    blocks = _frames_of(model, scene)
    for k in range(len(fixes)):
        use = [n for n in range(fixes.weights.shape[1]) if fixes.weights[k, n] or fixes.rates[k, n]]
        poses = [blocks[int(fixes.frames[k, n])] for n in use]
        sigma = fixes.sigma[k] * given.factor[k] / sigma_px
        cost = costs.PositionCost(
            fixes.weights[k, use], fixes.rates[k, use], np.stack([t for _, t in poses]), fixes.position[k], sigma
        )
        loss = pyceres.CauchyLoss(known.inlier_sigmas * sigma_px)
        _add(problem, cost, loss, [p.params for p, _ in poses], [arm, clock])
        kept += [cost, loss]
    if not len(fixes):
        return kept
    there = given.receiver  # what nothing tells stays as the similarity has it: a ring's scale and its lever arm, say
    weak = (
        (arm, there.antenna, there.free_antenna, known.antenna_sigma_m),
        (clock, np.array([there.offset_s]), there.free_offset, known.offset_sigma_s),
    )
    for block, value, free, sigma in weak:
        if free:
            prior = PriorCost(value, sigma / sigma_px)
            problem.add_residual_block(prior, None, [block])
            kept.append(prior)
        else:
            problem.set_parameter_block_constant(block)
    return kept + _not_with_points(problem, model, [block for block, _, free, _ in weak if free])


def _not_with_points(problem: Any, model: pycolmap.Reconstruction, shared: list[np.ndarray]) -> list:
    """Keep Ceres from eliminating unknowns that all frames share together with the points: a neighbour among these.

    It eliminates blocks of which no two are neighbours, those with few neighbours first, and a lever arm has none but
    poses. That coupled the poses of all positions (a full matrix), and summed rows of any size one by one.
    """
    few = min(model.points3D.values(), key=lambda p: p.track.length(), default=None)
    if few is None or not shared or not problem.has_parameter_block(few.xyz):
        return []
    cost = costs.ZeroCost([3, *map(len, shared)])
    problem.add_residual_block(cost, None, [few.xyz, *shared])
    return [cost]


def _add(problem: Any, cost: Any, loss: Any, old: list, new: list, new_first: bool = False) -> None:
    """Add a residual over blocks of COLMAP's and new ones. What COLMAP left out (held, unobserved) is held here too."""
    held = [b for b in old if not problem.has_parameter_block(b)]
    problem.add_residual_block(cost, loss, [*new, *old] if new_first else [*old, *new])
    for block in held:
        problem.set_parameter_block_constant(block)


def _add_points(
    problem: Any, model: pycolmap.Reconstruction, scene: Scene, given: Constraints, sigma_px: float
) -> list:
    """Marks of the control points (check points never), each point held at its survey, and of the ends of scale bars,
    held at their distance. An end that is a control point too is one point."""
    control, kept, places = given.control, [], {}
    for row, target in enumerate(given.targets):
        if control is None or control.check[row] or target.why_not:
            continue
        place = places[control.names[row]] = np.array(control.world_m[row], float)
        seen = _Sighting(place=place, marks=control.marks, rows=target.marks, sigma_px=sigma_px)
        kept += _add_marks(problem, model, scene, given, seen)
        prior = PriorCost(place, control.sigma_m[row] * given.point_factor / sigma_px)
        problem.add_residual_block(prior, None, [place])
        kept += [prior, place]
    if given.lengths is None:
        return kept
    bars = given.lengths.bars
    for bar in np.flatnonzero(given.lengths.used):
        for row in bars.ends[bar]:
            name, target = bars.names[row], given.lengths.ends[row]
            if name not in places:
                place = places[name] = np.array(target.place, float)
                seen = _Sighting(place=place, marks=bars.marks, rows=target.marks, sigma_px=sigma_px)
                kept += [place, *_add_marks(problem, model, scene, given, seen)]
        length = costs.LengthCost(float(bars.length_m[bar]), float(bars.sigma_m[bar]) / sigma_px)
        problem.add_residual_block(length, None, [places[bars.names[row]] for row in bars.ends[bar]])
        kept.append(length)
    return kept


@dataclass(frozen=True)
class _Sighting:
    """A marked point: its place (3,), an unknown, all marks, the rows of its own, and the sigma of a pixel."""

    place: np.ndarray
    marks: Marks
    rows: np.ndarray
    sigma_px: float


def _add_marks(problem: Any, model: pycolmap.Reconstruction, scene: Scene, given: Constraints, seen: _Sighting) -> list:
    """Residuals of the marks of one point."""
    from pycolmap import cost_functions

    world, kept, marks, sigma_px = given.tuning.world, [], seen.marks, seen.sigma_px
    sigma = mark_sigma(marks, world.marks)
    for mark in seen.rows:
        image = model.find_image_with_name(scene.names[marks.image[mark]])
        blocks = _blocks_of(model, image)
        kind = cost_functions.ReprojErrorCost if len(blocks) == 2 else cost_functions.RigReprojErrorCost
        weight = (sigma[mark] / sigma_px) ** 2 * np.eye(2)
        cost = kind(model.cameras[image.camera_id].model, weight, marks.xy_px[mark])
        loss = pyceres.CauchyLoss(world.fit.inlier_sigmas * sigma_px)
        _add(problem, cost, loss, blocks, [seen.place], new_first=True)
        kept += [cost, loss]
    return kept


def _pose(model: pycolmap.Reconstruction, image: Any) -> pycolmap.Rigid3d:
    """rig_from_world of an image's frame, in COLMAP's memory."""
    pose = model.frame(image.frame_id).rig_from_world
    assert pose is not None  # only registered frames come here
    return pose


def _blocks_of(model: pycolmap.Reconstruction, image: Any) -> list[np.ndarray]:
    """Parameter blocks of an image after the point: [cam_from_rig,] rig_from_world, intrinsics, in COLMAP's memory."""
    pose = _pose(model, image).params
    params = model.cameras[image.camera_id].params
    rig = model.rigs[image.frame.rig_id]
    for sensor, extrinsics in rig.non_ref_sensors.items():  # the accessor by id hands out a copy
        if sensor == image.data_id.sensor_id and extrinsics is not None:
            return [extrinsics.params, pose, params]
    return [pose, params]


def _add_up(problem: Any, model: pycolmap.Reconstruction, scene: Scene, given: Constraints, sigma_px: float) -> list:
    """The upward direction of the cameras in the middle frame, where the positions leave the tilt open."""
    seeing = _frames_of(model, scene).items()
    blocks = {f: found for f, found in seeing if problem.has_parameter_block(found[0].params)}
    if given.up is None or not blocks:
        return []
    centres = {f: transforms.centre(matrix(b)) for f, (b, _) in blocks.items()}
    places = np.array(list(centres.values()))
    middle = list(centres)[int(np.argmin(np.linalg.norm(places - np.median(places, axis=0), axis=1)))]
    block = blocks[middle][0]
    upright = matrix(block)[:3, :3] @ given.up.direction
    axes = np.eye(3)[:2]
    if not given.up.tilt:  # only the roll about the track is held
        track = np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2][0]
        axes = np.cross([0.0, 0.0, 1.0], track)[None] / max(float(np.linalg.norm(track[:2])), 1e-9)
    cost = costs.UpCost(upright, axes, np.radians(given.up.sigma_deg) / sigma_px)
    problem.add_residual_block(cost, None, [block.params])
    return [cost]


def similarity_to(before: pycolmap.Reconstruction, after: pycolmap.Reconstruction, first: Similarity) -> Similarity:
    """The similarity from the model as mapped to the world that comes closest to the adjusted one."""
    names = [i for i in before.reg_image_ids() if i in after.images and after.image(i).has_pose]
    a = np.array([before.image(i).projection_center() for i in names])
    b = np.array([after.image(i).projection_center() for i in names])
    moved = umeyama(first(a), b)
    return Similarity(moved.scale * first.scale, moved.rotation @ first.rotation, moved(first.translation[None])[0])
