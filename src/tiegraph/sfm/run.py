"""One run of a COLMAP mapper, inside a child process: working copy of the database, mapping, models to disk.

From approximate poses (``start``) a model is made by three rounds of adjustment that free more unknowns each time:
poses; then rig, focal length and distortion; then principal points. After the first two rounds, frames without a
pose, or with a place that their matches contradict, are placed by their matches. The rounds use few points
(``adjustment.fewpoints``) and triangulate all points again from the new poses. The acceptance test (``refusal``)
requires that tied images see points, that verified pairs agree with the model, and that lenses are plausible.
"""

import shutil
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.scene.colmapmodel import THREADS, factorised, observations
from tiegraph.scene.colmaprows import read_cache, sizes
from tiegraph.scene.rig import Rig, rig_from_dict, rig_to_dict
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import free_cameras, impossible_camera
from tiegraph.sfm.adjustment.fewpoints import points_that_can_wait
from tiegraph.sfm.database import write_working_copy
from tiegraph.sfm.placement import placed_anew
from tiegraph.sfm.start import Start, largest_component, place_frames, start_from
from tiegraph.sfm.tuning import FewPointsTuning, Tuning
from tiegraph.sfm.verified import VerifiedMatches, image_observations, rays_meet, read_verified

Options = pycolmap.IncrementalPipelineOptions
Anew = Callable[[pycolmap.Reconstruction], tuple[Mapping[int, pycolmap.Rigid3d], Collection[int]]]
"""For the frames of a model whose verified matches contradict their place, by COLMAP's ids: new poses of those that
move, and those that are removed."""


@dataclass(frozen=True)
class Method:
    """How a model is made."""

    mapper: str  # incremental, global, or preview: from the poses of the coarse model
    seed: int = 0  # of every random choice: the same input gives the same model
    rough: bool = False  # few tracks, none found later


@dataclass(frozen=True)
class Matches:
    """The verified matches that a mapper is given."""

    database: Path
    least: int  # smallest number of a pair
    refused: tuple[tuple[int, int], ...] = ()  # scene indices of pairs it must not see
    only: np.ndarray | None = None  # scene indices of the images to map, None = all


@dataclass(frozen=True)
class Fixed:
    """What must not move: rigs (indices) with fixed extrinsics, and cameras (COLMAP ids) whose calibration is
    trusted."""

    rigs: tuple[int, ...] = ()
    cameras: tuple[int, ...] = ()
    all_cameras: bool = False


@dataclass(frozen=True)
class Request:
    """The input of one run, in picklable form."""

    method: Method
    matches: Matches
    fixed: Fixed
    images: Path | None  # for colours; None = none are wanted
    folder: Path  # scratch; models go to folder/0, folder/1, ...
    scene: str  # JSON
    rigs: dict[int, dict]  # rig index -> rig with all extrinsics, as a dict
    positions: bool
    tuning: Tuning
    poses: np.ndarray | None = None  # (N, 4, 4) cam_from_world to start from (mapper "preview"); NaN = unknown

    @staticmethod
    def rigs_of(rigs: Mapping[int, Rig]) -> dict[int, dict]:
        """Rigs in picklable form."""
        return {k: rig_to_dict(r) for k, r in rigs.items()}


@dataclass(frozen=True)
class MappingResult:
    """Folders of the models of one run, most registered images first; remarks; why there are none, if it is known."""

    folders: list[Path]
    notes: tuple[str, ...] = ()
    refused: str = ""


def run_mapper(request: Request, send: Callable[[Any], None]) -> MappingResult:
    """Run one mapper. Sends the frames done so far."""
    shutil.rmtree(request.folder, ignore_errors=True)
    request.folder.mkdir(parents=True)
    working = request.folder / "working.db"
    scene = Scene.from_json(request.scene)
    rigs = {k: rig_from_dict(r) for k, r in request.rigs.items()}
    if request.method.mapper == "preview":
        return _from_poses(request, working, scene, rigs, send)
    positions = request.tuning.world.fixes if request.positions else None
    seen = request.matches
    write_working_copy(seen.database, working, scene, rigs, positions, seen.refused, seen.only)
    raw = request.folder / "raw"
    raw.mkdir()
    models = (
        _incremental(request, working, raw, send)
        if request.method.mapper == "incremental"
        else _global(request, working, raw)
    )
    ordered = sorted(models.values(), key=lambda m: (-m.num_reg_images(), -m.num_points3D()))
    if ordered and not request.method.rough and request.tuning.adjust.iterations:
        verified = read_verified(seen.database, scene, seen.refused)
        place_anew(
            ordered[0], working, lambda free: _options(request, free), request.tuning, _anew(request, scene, verified)
        )
    folders = []
    for number, model in enumerate(m for m in ordered if m.num_reg_images() >= 2):
        folder = request.folder / str(number)
        folder.mkdir()
        model.write(folder)
        folders.append(folder)
    shutil.rmtree(raw)
    working.unlink()
    return MappingResult(folders)


def _from_poses(
    request: Request, working: Path, scene: Scene, rigs: dict[int, Rig], send: Callable[[Any], None]
) -> MappingResult:
    """One model from approximate poses, if it passes the acceptance test."""
    assert request.poses is not None
    seen = request.matches
    verified = read_verified(seen.database, scene, seen.refused)
    piece = largest_component(request.poses, scene, rigs, verified.pairs)
    poses = np.where(piece[:, None, None], request.poses, np.nan)
    placed = np.isfinite(poses).all(axis=(1, 2))
    if placed.sum() < request.tuning.start.min_share * piece.sum():
        return MappingResult([], refused=f"it places {placed.sum()} of {piece.sum()} connected images")
    start = start_from(poses, scene, rigs, request.fixed.rigs, verified, request.tuning.start)
    if start is None:
        return MappingResult(
            [], refused=("neither matches nor positions determine the length of its path relative to the rig")
        )
    write_working_copy(seen.database, working, scene, start.rigs, None, seen.refused, seen.only)
    anew = _anew(request, scene, verified)
    model = model_from(working, scene, start, lambda free: _options(request, free), request.tuning, send, anew)
    working.unlink()
    refused = refusal(model, scene, verified, piece, request.tuning)
    if refused:
        return MappingResult([], start.notes, refused)
    folder = request.folder / "0"
    folder.mkdir()
    model.write(folder)
    return MappingResult([folder], start.notes)


def _anew(request: Request, scene: Scene, verified: VerifiedMatches) -> Anew:
    """A function that finds the doubtful frames of a model."""
    return lambda model: placed_anew(model, scene, verified, request.tuning.placement)


def _options(request: Request, free: bool) -> pycolmap.IncrementalPipelineOptions:
    """``free``: intrinsics and extrinsics are adjusted where the request allows it."""
    lens = free and not request.fixed.all_cameras
    tolerance = request.tuning.start.staged.tolerance  # COLMAP's 0 would iterate on at points that are removed later
    return pycolmap.IncrementalPipelineOptions(
        ba_local_function_tolerance=tolerance,
        ba_global_function_tolerance=tolerance,
        # COLMAP registers no image by a camera with a distortion above 1. That is half a pixel of k2 for a narrow
        # lens.
        max_extra_param=float("inf"),
        random_seed=request.method.seed,
        num_threads=THREADS,
        ba_use_gpu=False,  # the same bits with and without one
        min_num_matches=request.matches.least,
        min_model_size=request.tuning.mapping.min_model_images,
        extract_colors=False,
        # Placing an image by its matches alone takes minutes for a rough model of weakly connected previews.
        structure_less_registration_fallback=not request.method.rough,
        ba_refine_focal_length=lens,
        ba_refine_extra_params=lens,
        constant_cameras=set(request.fixed.cameras),
        ba_refine_sensor_from_rig=free and len(request.fixed.rigs) < len(request.rigs),
        constant_rigs={k + 1 for k in request.fixed.rigs},
        use_prior_position=request.positions,
        use_robust_loss_on_prior_position=True,
        # As many as a pair needs: COLMAP's 30 leaves out photographs that a few sound ties hold.
        mapper=pycolmap.IncrementalMapperOptions(abs_pose_min_num_inliers=request.matches.least),
    )


def _incremental(
    request: Request, working: Path, raw: Path, send: Callable[[Any], None]
) -> dict[int, pycolmap.Reconstruction]:
    options = _options(request, True)
    done = [0]

    def count(new: int) -> None:
        done[0] += new
        send(done[0])

    return pycolmap.incremental_mapping(
        working, request.images or raw, raw, options,
        initial_image_pair_callback=lambda: count(2), next_image_callback=lambda: count(1),
    )  # fmt: skip


def _global(request: Request, working: Path, raw: Path) -> dict[int, pycolmap.Reconstruction]:
    refine_rig = len(request.fixed.rigs) < len(request.rigs)
    mapper = pycolmap.GlobalMapperOptions(refine_sensor_from_rig=refine_rig)
    mapper.global_positioning.use_gpu = False
    mapper.bundle_adjustment.refine_focal_length = not request.fixed.all_cameras  # it knows no single constant cameras
    mapper.bundle_adjustment.refine_extra_params = not request.fixed.all_cameras
    factorised(mapper.bundle_adjustment, *sizes(working))
    if request.method.rough:
        mapper.track_required_tracks_per_view = request.tuning.mapping.rough_tracks
        mapper.skip_retriangulation = True
    options = pycolmap.GlobalPipelineOptions(
        random_seed=request.method.seed,
        num_threads=THREADS,  # these two count, not the mapper's own
        min_num_matches=request.matches.least,
        min_model_size=request.tuning.mapping.min_model_images,
        mapper=mapper,
    )
    level = pycolmap.logging.minloglevel
    if request.images is None:  # it would warn of each image without colours: a hundred lines and more
        pycolmap.logging.minloglevel = 2
    try:
        return pycolmap.global_mapping(working, request.images or raw, raw, options)
    finally:
        pycolmap.logging.minloglevel = level


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
    doubtful frames (``anew``), are placed by their matches after an adjustment. ``send`` receives the number of
    placed images.

    Unknowns beside poses and points: none at first, because lens and rig would absorb the errors of the poses; then
    both; then principal points: with them held in all rounds canal's frames are 12 mm off after the final adjustment.
    """
    cache = read_cache(database, options(False).min_num_matches)
    model = pycolmap.Reconstruction()
    model.load(cache)
    place_frames(model, scene, start)
    send(model.num_reg_frames())
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    _triangulate(mapper, options(False))
    for stage in ("poses", "lens"):
        _thin(mapper, tuning.adjust.few_points)
        _round(mapper, options(stage != "poses"), tuning)
        moved, out = anew(model)
        if stage == "poses" or moved or out:
            _place(mapper, moved, out, options(False), tuning)
            send(model.num_reg_frames())
    _settle(mapper, options, tuning, anew)
    mapper.filter_points(options(True).get_mapper())
    mapper.filter_frames(options(True).get_mapper())
    mapper.end_reconstruction(False)
    model.update_point_3d_errors()
    return model


def _settle(mapper: pycolmap.IncrementalMapper, options: Callable[[bool], Options], tuning: Tuning, anew: Anew) -> None:
    """Adjust everything and triangulate all points; once more if frames are at doubtful places even then: before
    principal points are right (8 px are 26 mrad of a wide lens), matches hardly tell places apart."""
    for last in (False, True):
        _thin(mapper, tuning.adjust.few_points)
        _round(mapper, options(True), tuning, centre=True)
        _triangulate(mapper, options(True))
        moved, out = ({}, ()) if last else anew(mapper.reconstruction)
        if not moved and not out:
            return
        _place(mapper, moved, out, options(False), tuning)


def _round(mapper: pycolmap.IncrementalMapper, options: Options, tuning: Tuning, centre: bool = False) -> None:
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
    """Triangulate all points again from the present poses."""
    for point_id in list(mapper.reconstruction.point3D_ids()):
        mapper.observation_manager.delete_point3D(point_id)
    for image_id in sorted(mapper.reconstruction.reg_image_ids()):
        mapper.triangulate_image(options.get_triangulation(), image_id)
    mapper.complete_and_merge_tracks(options.get_triangulation())


def _thin(mapper: pycolmap.IncrementalMapper, tuning: FewPointsTuning) -> None:
    """Keep the most informative points."""
    for point_id in points_that_can_wait(mapper.reconstruction, tuning):
        mapper.observation_manager.delete_point3D(point_id)


def place_anew(
    model: pycolmap.Reconstruction, database: Path, options: Callable[[bool], Options], tuning: Tuning, anew: Anew
) -> None:
    """Place the doubtful frames of a mapper's model by their matches, and those without a place."""
    moved, out = anew(model)
    if not moved and not out:
        return
    mapper = pycolmap.IncrementalMapper(read_cache(database, options(False).min_num_matches))
    mapper.begin_reconstruction(model)
    _place(mapper, moved, out, options(False), tuning)
    _settle(mapper, options, tuning, anew)
    mapper.end_reconstruction(False)
    model.update_point_3d_errors()


def _place(
    mapper: pycolmap.IncrementalMapper,
    moved: Mapping[int, pycolmap.Rigid3d],
    out: Collection[int],
    options: Options,
    tuning: Tuning,
) -> None:
    """Move frames, and place those without a place by their matches."""
    for frame_id, pose in moved.items():
        mapper.reconstruction.frame(frame_id).rig_from_world = pose
    for frame_id in out:
        mapper.observation_manager.deregister_frame(frame_id)
    _triangulate(mapper, options)
    _register(mapper, options, tuning.start.staged.register_rounds)


def _register(mapper: pycolmap.IncrementalMapper, options: Options, rounds: int) -> None:
    """Register frames without a pose by the points of their matches."""
    for _ in range(rounds):
        placed = 0
        for image_id in mapper.find_next_images(options.get_mapper(), structure_less=False):
            if mapper.reconstruction.image(image_id).has_pose:
                continue  # registered with another image of its frame
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
    """Why the model of a connected ``piece`` (N,) bool of the images is not good enough; "" if it is."""
    gate = tuning.start.staged
    own = {k + 1: s.camera for k, s in enumerate(scene.all_sensors) if s.camera is not None}
    lens = impossible_camera(own, model.cameras, set(own) & set(model.cameras), tuning.adjust)
    if lens is not None:
        return f"the adjusted intrinsics of camera {scene.all_sensors[lens - 1].name} are impossible for a lens"
    degree = np.bincount(verified.pairs.ravel(), minlength=len(scene))
    tied = piece & (degree >= gate.tied_pairs)
    seeing = observations(model, scene) >= tuning.adjust.min_points
    share = float(np.mean(seeing[tied])) if tied.any() else 0.0
    if share < gate.min_seeing:
        return (
            f"only {seeing[tied].sum()} of {tied.sum()} tied images see {tuning.adjust.min_points} or more of its "
            "points"
        )
    agreed = rays_meet(verified, image_observations(model, scene, tuning.placement.agreement))
    judged = agreed[:, 1] > 0
    good = agreed[judged, 0] >= tuning.placement.consistency.agrees * agreed[judged, 1]
    if not judged.any() or good.mean() < gate.min_agreeing:
        return f"it contradicts {np.sum(~good)} of {len(good)} verified pairs of images"
    error = float(model.compute_mean_reprojection_error())
    return f"its reprojection error is {error:.1f} px" if error > gate.max_error_px else ""
