"""One run of a COLMAP mapper, inside a child process: working copy of the database, mapping, models to disk.

From approximate poses (``start``) a model is made by three rounds of adjustment that free more unknowns each time:
poses; then rig, focal length and distortion; then principal points. After the first two rounds, frames without a
pose, or with a place that their matches contradict, are placed by their matches. The rounds use few points
(``adjust.points_that_can_wait``) and triangulate all points again from the new poses. The acceptance test (``refusal``)
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
from tiegraph.scene.colmaprows import read_cache, sizes, write_working_copy
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import free_cameras, impossible_camera, points_that_can_wait
from tiegraph.sfm.model import held_out_frames
from tiegraph.sfm.placement import placed_anew
from tiegraph.sfm.start import Start, largest_component, place_frames, start_from
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.world import FixTuning
from tiegraph.sfm.verified import MatchSource, VerifiedMatches, image_observations, rays_meet

Options = pycolmap.IncrementalPipelineOptions


@dataclass(frozen=True)
class Method:
    """How a model is made."""

    mapper: str  # incremental, global, or preview: from the poses of the coarse model
    seed: int = 0  # of every random choice: the same input gives the same model
    rough: bool = False  # few tracks, none found later
    positions: bool = False  # the mapper uses prior positions
    poses: np.ndarray | None = None  # (N, 4, 4) cam_from_world to start from (mapper "preview"); NaN = unknown


@dataclass(frozen=True)
class RigsUsed:
    """The rigs (scene indices) that a mapper is given, those whose extrinsics it keeps, and the cameras (COLMAP ids)
    whose calibration it keeps."""

    given: Collection[int] = ()
    held: Collection[int] = ()
    cameras: Collection[int] = ()


@dataclass(frozen=True)
class Request:
    """The input of one run."""

    method: Method
    matches: MatchSource
    rigs: RigsUsed
    images: Path | None  # for colours; None = none are wanted
    folder: Path  # scratch; models go to folder/0, folder/1, ...
    scene: Scene
    tuning: Tuning

    @property
    def free_lenses(self) -> bool:
        """Whether a camera's intrinsics are adjusted."""
        return len(self.rigs.cameras) < len(self.scene.all_sensors)

    @property
    def free_rigs(self) -> bool:
        """Whether a rig's extrinsics are adjusted."""
        return len(self.rigs.held) < len(self.rigs.given)


@dataclass(frozen=True)
class MappingResult:
    """Folders of the models of one run, most registered images first; remarks; why there are none, if it is known, or
    why the model is in doubt."""

    folders: list[Path]
    notes: tuple[str, ...] = ()
    refused: str = ""


def run_mapper(request: Request, send: Callable[[Any], None]) -> MappingResult:
    """Run one mapper. Sends the frames done so far."""
    shutil.rmtree(request.folder, ignore_errors=True)
    request.folder.mkdir(parents=True)
    working = request.folder / "working.db"
    scene, method = request.scene, request.method
    if method.mapper == "preview":
        return _from_poses(request, working, send)
    rigs = {k: scene.rigs[k] for k in request.rigs.given}
    positions = _positions(scene, request.tuning.world.fixes) if method.positions else None
    seen = request.matches
    write_working_copy(seen.database, working, scene, rigs, positions, seen.refused, seen.only)
    raw = request.folder / "raw"
    raw.mkdir()
    models = (
        _incremental(request, working, raw, send) if method.mapper == "incremental" else _global(request, working, raw)
    )
    ordered = sorted(models.values(), key=lambda m: (-m.num_reg_images(), -m.num_points3D()))
    if ordered and not method.rough and request.tuning.adjust.iterations:
        place_anew(ordered[0], working, request, seen.read(scene))
    shutil.rmtree(raw)
    working.unlink()
    return MappingResult(
        [_written(m, request.folder / str(n)) for n, m in enumerate(ordered) if m.num_reg_images() > 1]
    )


def _written(model: pycolmap.Reconstruction, folder: Path) -> Path:
    folder.mkdir()
    model.write(folder)
    return folder


def _from_poses(request: Request, working: Path, send: Callable[[Any], None]) -> MappingResult:
    """One model from approximate poses, if it passes the acceptance test."""
    seen, scene, poses = request.matches, request.scene, request.method.poses
    assert poses is not None
    verified = seen.read(scene)
    piece = largest_component(poses, scene, request.rigs.given, verified.pairs)
    poses = np.where(piece[:, None, None], poses, np.nan)
    placed = np.isfinite(poses).all(axis=(1, 2))
    if placed.sum() < request.tuning.mapping.clearly_fewer * piece.sum():
        return MappingResult([], refused=f"it places {placed.sum()} of {piece.sum()} connected images")
    start = start_from(poses, scene, request.rigs.given, request.rigs.held, verified, request.tuning)
    if start is None:
        return MappingResult(
            [], refused="neither matches nor positions determine the length of its path relative to the rig"
        )
    write_working_copy(seen.database, working, scene, start.rigs, None, seen.refused, seen.only)
    model = model_from(working, request, start, verified, send)
    working.unlink()
    refused = refusal(model, scene, verified, piece, request.tuning)
    if refused:
        return MappingResult([], start.notes, refused)
    doubted = contradicted(model, scene, verified, request.tuning)
    return MappingResult([_written(model, request.folder / "0")], start.notes, doubted)


def _positions(scene: Scene, tuning: FixTuning) -> tuple[np.ndarray, np.ndarray]:
    """Prior positions (F, 3) of the frames but the held-out ones, NaN = none, and variances (F, 3); world metres.

    COLMAP has no lever arm: its length increases the sigma instead.
    """
    positions = np.where(held_out_frames(scene, tuning)[:, None], np.nan, scene.world_from_rig[:, :3, 3])
    sigma = np.where(np.isfinite(scene.position_sigma_m), scene.position_sigma_m, tuning.unknown_sigma_m)
    antennas = [None if scene.prior == "trajectory" else r.antenna_m for r in scene.rigs]
    arm2 = np.array([0.0 if a is None else float(np.linalg.norm(a)) ** 2 for a in antennas])
    return positions, sigma**2 + arm2[scene.rig][:, None]


def _options(request: Request, free: bool) -> pycolmap.IncrementalPipelineOptions:
    """``free``: intrinsics and extrinsics are adjusted where the request allows it."""
    lens = free and request.free_lenses
    tolerance = request.tuning.adjust.rough_tolerance  # COLMAP's 0 would iterate on at points that are removed later
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
        constant_cameras=set(request.rigs.cameras),
        ba_refine_sensor_from_rig=free and request.free_rigs,
        constant_rigs={k + 1 for k in request.rigs.held},
        use_prior_position=request.method.positions,
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
    mapper = pycolmap.GlobalMapperOptions(refine_sensor_from_rig=request.free_rigs)
    mapper.global_positioning.use_gpu = False
    mapper.bundle_adjustment.refine_focal_length = request.free_lenses  # it knows no single constant cameras
    mapper.bundle_adjustment.refine_extra_params = request.free_lenses
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
    database: Path, request: Request, start: Start, verified: VerifiedMatches, send: Callable[[int], None]
) -> pycolmap.Reconstruction:
    """Triangulate the verified matches of the mapper's ``database`` from the poses of ``start``, and adjust.

    Frames without a pose, and doubtful frames, are placed by their matches after an adjustment. ``send`` receives the
    number of placed images.

    Unknowns beside poses and points: none at first, because lens and rig would absorb the errors of the poses; then
    both; then principal points: with them held in all rounds canal's frames are 12 mm off after the final adjustment.
    """
    cache = read_cache(database, request.matches.least)
    model = pycolmap.Reconstruction()
    model.load(cache)
    place_frames(model, request.scene, start)
    send(model.num_reg_frames())
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    _triangulate(mapper, _options(request, False))
    for free in (False, True):
        _round(mapper, request, free)
        moved, out = placed_anew(model, request.scene, verified, request.tuning.placement)
        if not free or moved or out:
            _place(mapper, request, moved, out)
            send(model.num_reg_frames())
    _settle(mapper, request, verified)
    mapper.filter_points(_options(request, True).get_mapper())
    mapper.filter_frames(_options(request, True).get_mapper())
    mapper.end_reconstruction(False)
    model.update_point_3d_errors()
    return model


def _settle(mapper: pycolmap.IncrementalMapper, request: Request, verified: VerifiedMatches) -> None:
    """Adjust everything and triangulate all points; once more if frames are at doubtful places even then: before
    principal points are right (8 px are 26 mrad of a wide lens), matches hardly tell places apart."""
    for last in (False, True):
        _round(mapper, request, True, centre=True)
        _triangulate(mapper, _options(request, True))
        if last:
            return
        moved, out = placed_anew(mapper.reconstruction, request.scene, verified, request.tuning.placement)
        if not moved and not out:
            return
        _place(mapper, request, moved, out)


def _round(mapper: pycolmap.IncrementalMapper, request: Request, free: bool, centre: bool = False) -> None:
    """Adjust the model with its most informative points; ``free``: as in ``_options``, ``centre``: with principal
    points."""
    options, tuning = _options(request, free), request.tuning.adjust
    for point_id in points_that_can_wait(mapper.reconstruction, tuning.few_points):
        mapper.observation_manager.delete_point3D(point_id)
    held = options.get_mapper()
    adjustment = options.get_global_bundle_adjustment()
    adjustment.print_summary = False
    adjustment.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    adjustment.ceres.loss_function_scale = 2 * tuning.robust_px  # half the first points have larger errors
    solver = adjustment.ceres.solver_options
    solver.max_num_iterations = tuning.iterations
    solver.function_tolerance = tuning.rough_tolerance
    adjustment.ceres.solver_options = solver
    factorised(adjustment, mapper.reconstruction.num_reg_frames(), mapper.reconstruction.num_reg_images())
    if centre:
        adjustment.refine_principal_point = True
        free_ids = free_cameras(mapper.reconstruction, tuning)
        held.constant_cameras |= set(mapper.reconstruction.cameras) - free_ids
    mapper.adjust_global_bundle(held, adjustment)
    mapper.filter_points(options.get_mapper())


def _triangulate(mapper: pycolmap.IncrementalMapper, options: Options) -> None:
    """Triangulate all points again from the present poses."""
    for point_id in list(mapper.reconstruction.point3D_ids()):
        mapper.observation_manager.delete_point3D(point_id)
    for image_id in sorted(mapper.reconstruction.reg_image_ids()):
        mapper.triangulate_image(options.get_triangulation(), image_id)
    mapper.complete_and_merge_tracks(options.get_triangulation())


def place_anew(model: pycolmap.Reconstruction, database: Path, request: Request, verified: VerifiedMatches) -> None:
    """Place the doubtful frames of a mapper's model by their matches, and those without a place."""
    moved, out = placed_anew(model, request.scene, verified, request.tuning.placement)
    if not moved and not out:
        return
    mapper = pycolmap.IncrementalMapper(read_cache(database, request.matches.least))
    mapper.begin_reconstruction(model)
    _place(mapper, request, moved, out)
    _settle(mapper, request, verified)
    mapper.end_reconstruction(False)
    model.update_point_3d_errors()


def _place(
    mapper: pycolmap.IncrementalMapper, request: Request, moved: Mapping[int, pycolmap.Rigid3d], out: Collection[int]
) -> None:
    """Move frames, and place those without a place by their matches."""
    for frame_id, pose in moved.items():
        mapper.reconstruction.frame(frame_id).rig_from_world = pose
    for frame_id in out:
        mapper.observation_manager.deregister_frame(frame_id)
    options = _options(request, False)
    _triangulate(mapper, options)
    for _ in range(request.tuning.start.register_rounds):
        if not _register(mapper, options):
            break


def _register(mapper: pycolmap.IncrementalMapper, options: Options) -> bool:
    """Register frames without a pose by the points of their matches; returns whether there were any."""
    placed = False
    for image_id in mapper.find_next_images(options.get_mapper(), structure_less=False):
        if mapper.reconstruction.image(image_id).has_pose:
            continue  # registered with another image of its frame
        if mapper.register_next_image(options.get_mapper(), image_id):
            frame = mapper.reconstruction.frame(mapper.reconstruction.image(image_id).frame_id)
            for k in frame.image_ids:
                mapper.triangulate_image(options.get_triangulation(), k.id)
            placed = True
    return placed


def refusal(
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, piece: np.ndarray, tuning: Tuning
) -> str:
    """Why the model of a connected ``piece`` (N,) bool of the images is not good enough; "" if it is."""
    own = {k + 1: s.camera for k, s in enumerate(scene.all_sensors) if s.camera is not None}
    lens = impossible_camera(own, model.cameras, set(own) & set(model.cameras), tuning.adjust)
    if lens is not None:
        return f"the adjusted intrinsics of camera {scene.all_sensors[lens - 1].name} are impossible for a lens"
    degree = np.bincount(verified.pairs.ravel(), minlength=len(scene))
    tied = piece & (degree >= tuning.rig.support.min_ties)
    seeing = observations(model, scene) >= tuning.adjust.min_points
    share = float(np.mean(seeing[tied])) if tied.any() else 0.0
    if share < tuning.start.least_share:
        return (
            f"only {seeing[tied].sum()} of {tied.sum()} tied images see {tuning.adjust.min_points} or more of its "
            "points"
        )
    error = float(model.compute_mean_reprojection_error())
    return f"its reprojection error is {error:.1f} px" if error > tuning.adjust.filter_px else ""


def contradicted(model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, tuning: Tuning) -> str:
    """How many verified pairs a model contradicts, if these are too many for it to be believed alone; else ""."""
    agreed = rays_meet(verified, image_observations(model, scene, tuning.placement.agreement))
    judged = agreed[:, 1] > 0
    good = agreed[judged, 0] >= tuning.placement.consistency.agrees * agreed[judged, 1]
    if not judged.any() or good.mean() < tuning.start.least_share:
        return f"it contradicts {np.sum(~good)} of {len(good)} verified pairs of images"
    return ""
