"""From roughly known poses to a model: points, then rounds of adjustment that free more each time.

The rounds take few points (``adjustment.fewpoints``); all are triangulated anew from what they found.
"""

from collections.abc import Callable, Collection, Mapping
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.scene.colmapmodel import observations
from tiegraph.scene.colmaprows import read_cache
from tiegraph.scene.scene import Scene
from tiegraph.scene.solver import factorised
from tiegraph.sfm.adjustment.adjust import free_cameras, impossible_camera
from tiegraph.sfm.adjustment.fewpoints import points_that_can_wait
from tiegraph.sfm.start.poses import Start, place_frames
from tiegraph.sfm.tuning import FewPointsTuning, Tuning
from tiegraph.sfm.verified import VerifiedMatches, image_observations, rays_meet

# What is adjusted beside poses and points: at first nothing, because lens and rig would soak up what is wrong with the
# poses; then both; then principal points too, because the final adjustment alone does not get there: after it canal's
# frames are 12 mm off with these held so long, else as the mapper's.
STEPS = ("poses", "lens", "centre")

Options = pycolmap.IncrementalPipelineOptions
Anew = Callable[[pycolmap.Reconstruction], tuple[Mapping[int, pycolmap.Rigid3d], Collection[int]]]
"""Of the frames of a model whose verified matches contradict their place, by COLMAP's ids, new poses of those that
move, and those that are taken out."""


def model_from(
    database: Path,
    scene: Scene,
    start: Start,
    options: Callable[[bool], Options],
    tuning: Tuning,
    send: Callable[[int], None],
    anew: Anew,
) -> pycolmap.Reconstruction:
    """Triangulate the verified matches of the mapper's ``database`` from the poses of ``start``, and adjust.

    ``options(free)``: the pipeline's options with intrinsics and extrinsics free or held. Frames without a pose, and
    those in doubt (``anew``), are placed by their matches after an adjustment. ``send`` is told how many are placed.
    """
    cache = read_cache(database, options(False).min_num_matches)
    model = pycolmap.Reconstruction()
    model.load(cache)
    place_frames(model, scene, start)
    send(model.num_reg_frames())
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    _triangulate(mapper, options(False))
    for stage in STEPS:
        _thin(mapper, tuning.adjust.few_points)
        _round(mapper, options(stage != "poses"), tuning, stage == "centre")
        moved, out = anew(model) if stage != "centre" else ({}, ())
        if stage == "poses" or moved or out:
            _place(mapper, moved, out)
            _triangulate(mapper, options(False))
            _register(mapper, options(False), tuning.start.staged.register_rounds)
            send(model.num_reg_frames())
    _triangulate(mapper, options(True))
    mapper.filter_points(options(True).get_mapper())
    mapper.filter_frames(options(True).get_mapper())
    mapper.end_reconstruction(False)
    model.update_point_3d_errors()
    return model


def _round(mapper: pycolmap.IncrementalMapper, options: Options, tuning: Tuning, centre: bool) -> None:
    held = options.get_mapper()
    adjustment = options.get_global_bundle_adjustment()
    adjustment.print_summary = False
    adjustment.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    adjustment.ceres.loss_function_scale = tuning.start.staged.soft_l1_px
    solver = adjustment.ceres.solver_options
    solver.max_num_iterations = tuning.start.staged.iterations
    solver.function_tolerance = tuning.start.staged.tolerance
    adjustment.ceres.solver_options = solver
    factorised(adjustment, mapper.reconstruction.num_reg_frames(), mapper.reconstruction.num_reg_images())
    if centre:
        adjustment.refine_principal_point = True
        free = free_cameras(mapper.reconstruction, tuning.adjust)
        held.constant_cameras |= set(mapper.reconstruction.cameras) - free
    mapper.adjust_global_bundle(held, adjustment)
    mapper.filter_points(options.get_mapper())


def _triangulate(mapper: pycolmap.IncrementalMapper, options: Options) -> None:
    """All points anew, from the poses as they are."""
    for point_id in list(mapper.reconstruction.point3D_ids()):
        mapper.observation_manager.delete_point3D(point_id)
    for image_id in sorted(mapper.reconstruction.reg_image_ids()):
        mapper.triangulate_image(options.get_triangulation(), image_id)
    mapper.complete_and_merge_tracks(options.get_triangulation())


def _thin(mapper: pycolmap.IncrementalMapper, tuning: FewPointsTuning) -> None:
    """Leave the points that tell most."""
    for point_id in points_that_can_wait(mapper.reconstruction, tuning):
        mapper.observation_manager.delete_point3D(point_id)


def place_anew(model: pycolmap.Reconstruction, database: Path, options: Options, tuning: Tuning, anew: Anew) -> None:
    """Place the frames of a mapper's model that are in doubt by their matches, and those that have no place yet."""
    moved, out = anew(model)
    if not moved and not out:
        return
    mapper = pycolmap.IncrementalMapper(read_cache(database, options.min_num_matches))
    mapper.begin_reconstruction(model)
    _place(mapper, moved, out)
    if moved:
        _triangulate(mapper, options)
    _register(mapper, options, tuning.start.staged.register_rounds)
    mapper.end_reconstruction(False)
    model.update_point_3d_errors()


def _place(mapper: pycolmap.IncrementalMapper, moved: Mapping[int, pycolmap.Rigid3d], out: Collection[int]) -> None:
    for frame_id, pose in moved.items():
        mapper.reconstruction.frame(frame_id).rig_from_world = pose
    for frame_id in out:
        mapper.observation_manager.deregister_frame(frame_id)


def _register(mapper: pycolmap.IncrementalMapper, options: Options, rounds: int) -> None:
    """Frames without a pose, by the points that their matches belong to."""
    for _ in range(rounds):
        placed = 0
        for image_id in mapper.find_next_images(options.get_mapper(), structure_less=False):
            if mapper.reconstruction.image(image_id).has_pose:
                continue  # with another image of its frame
            if mapper.register_next_image(options.get_mapper(), image_id):
                frame = mapper.reconstruction.frame(mapper.reconstruction.image(image_id).frame_id)
                for k in frame.image_ids:
                    mapper.triangulate_image(options.get_triangulation(), k.id)
                placed += 1
        if not placed:
            break


def refusal(
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, piece: np.ndarray, tuning: Tuning
) -> str:
    """Why the model of a ``piece`` (N,) bool of the images is not good enough; "" if it is."""
    gate = tuning.start.staged
    own = {k + 1: s.camera for k, s in enumerate(scene.all_sensors) if s.camera is not None}
    lens = impossible_camera(own, model.cameras, set(own) & set(model.cameras), tuning.adjust)
    if lens is not None:
        return f"no lens is like what became of camera {scene.all_sensors[lens - 1].name}"
    degree = np.bincount(verified.pairs.ravel(), minlength=len(scene))
    tied = piece & (degree >= gate.tied_pairs)
    seeing = observations(model, scene) >= tuning.adjust.min_points
    share = float(np.mean(seeing[tied])) if tied.any() else 0.0
    if share < gate.min_seeing:
        return f"only {seeing[tied].sum()} of {tied.sum()} tied images see {tuning.adjust.min_points} of its points"
    agreed = rays_meet(verified, image_observations(model, scene, tuning.placement.agreement))
    judged = agreed[:, 1] > 0
    good = agreed[judged, 0] >= tuning.placement.consistency.agrees * agreed[judged, 1]
    if not judged.any() or good.mean() < gate.min_agreeing:
        return f"it contradicts {np.sum(~good)} of {len(good)} verified pairs of images"
    error = float(model.compute_mean_reprojection_error())
    return f"its reprojection error is {error:.1f} px" if error > gate.max_error_px else ""
