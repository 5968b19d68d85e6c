"""From a model to the world: the similarity, then the adjustment with positions if it passes its check.

The model is bent so that its images, positions and control points fit best together, which corrects drift and
bending."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import LEAST_PLACES, Similarity, rms_length, umeyama
from tiegraph.scene.colmapmodel import MOST_FRAMES, image_poses, matrix, read_model
from tiegraph.scene.evidence import CHANCE, LIMIT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import adjusted_to, free_cameras
from tiegraph.sfm.adjustment.constraints import PlacePrior, nominal_geometry, of_one_shot, rig_priors
from tiegraph.sfm.covariance import position_sigma
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.ties import moved
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.world import WorldTuning
from tiegraph.sfm.verified import VerifiedMatches, read_verified
from tiegraph.sfm.world.fixes import Measurements
from tiegraph.sfm.world.georef import Georeference, PointsFound, georeference, residuals_of
from tiegraph.sfm.world.marks import Target, as_copy, by_chance, copy_of, point_table, targets
from tiegraph.sfm.world.oneworld import OneWorld, one_world
from tiegraph.sfm.world.scale import bars_in
from tiegraph.sfm.world.similarityfit import SimilarityFit
from tiegraph.sfm.world.statements import with_statements

_REFUSED = "the similarity is kept, because the bundle adjustment with the positions failed: {}"
_FIRM = 1e-6  # of the extent of the frames: places with a smaller sigma give no solvable sum of squares


@dataclass(frozen=True)
class ConstantParameters:
    """Parameters that an adjustment must not change: COLMAP ids of rigs with calibrated extrinsics, and of calibrated
    cameras; ``soft``: scene indices of rigs whose extrinsics are known with a sigma."""

    rigs: Collection[int] = ()
    cameras: Collection[int] = ()
    soft: Collection[int] = ()


def georeference_model(
    model: pycolmap.Reconstruction,
    scene: Scene,
    settings: GeorefSettings,
    tuning: Tuning,
    given: Measurements | None = None,
    held: ConstantParameters | None = None,
) -> tuple[Georeference, pycolmap.Reconstruction]:
    """The georeference of a model with its statements (``statements.py``), and the model in the world.

    First similarity and shape in one block (``georeference``). Then, if the frames move at all, a bundle adjustment
    moves them to the result of the block. It is kept only if the held-out positions (every fifth) fit at least as
    well as with the similarity, and the images no worse. The notes give the decision and its reason.
    """
    given, held = given or Measurements(), held or ConstantParameters()
    first = georeference(model, scene, settings, tuning.world, given)
    if first.placing is not None and given.shape is None and settings.adjust != "no":
        given = replace(given, shape=_shape(model, scene, held, tuning))
        first = georeference(model, scene, settings, tuning.world, given)
    found, world = first, first.apply(model)
    if first.placing is not None and settings.adjust != "no":
        found, world = _adjusted(first, first.placing, model, world, held, tuning)
    return with_statements(found, _points(world, scene, given, tuning.world)), world


def _adjusted(
    first: Georeference,
    placing: SimilarityFit,
    model: pycolmap.Reconstruction,
    world: pycolmap.Reconstruction,
    held: ConstantParameters,
    tuning: Tuning,
) -> tuple[Georeference, pycolmap.Reconstruction]:
    """The georeference and the model in the world after the bundle adjustment with the positions, or as they were."""
    scene, given, shape = placing.measured.scene, placing.measured.given, first.uncertainty.shape
    always, bounds = placing.measured.settings.adjust == "yes", tuning.world.fit
    if shape is None:
        why = f"the accuracy of its shape is unknown (few points, or more than {MOST_FRAMES} frames)"
        return first.noted(_REFUSED.format(why)), world
    good, why, blind = _check(placing)
    if not good and not always:
        return first.noted(_REFUSED.format(why)), world
    placed, bent = _bent(world, placing, shape, held, tuning)
    before, after = (m.compute_mean_reprojection_error() for m in (world, bent))
    lost = bent.num_points3D() < world.num_points3D() / 2
    if lost or (after > bounds.not_worse * before and not always):
        text = f"the images fit worse after it ({before:.3f} -> {after:.3f} px"
        text += f", {bent.num_points3D()} of {world.num_points3D()} points left)" if lost else ")"
        return first.noted(_REFUSED.format(text)), world
    step = np.linalg.norm(_frames(bent, scene)[:, :3, 3] - _frames(world, scene)[:, :3, 3], axis=1)
    notes = ["the model keeps its shape from the images: positions and control points would hardly change it"]
    if placed is not placing:
        notes = [
            f"adjusted with the positions: frames moved by {np.nanmedian(step):.3f} m (at most {np.nanmax(step):.3f} m)"
            f", reprojection {before:.3f} -> {after:.3f} px",
            f"check of this adjustment: {why}",
        ]
    assert placed.fit.bent is not None
    adjusted = replace(
        first,
        uncertainty=replace(first.uncertainty, shape=shape.told(*placed.fit.bent)),
        world_from_model=similarity_to(model, bent, first.world_from_model),
        residuals=residuals_of(placed, blind),
        fit=placed.fit,
        control=_control(first, bent, scene, given, tuning.world),
        adjusted=placed is not placing,
    )
    return adjusted.noted(*notes), bent


def _bent(
    world: pycolmap.Reconstruction, placing: SimilarityFit, shape: Shape, held: ConstantParameters, tuning: Tuning
) -> tuple[SimilarityFit, pycolmap.Reconstruction]:
    """The fit to the model after it was bent to the shape that its images and all other evidence give together, and
    that model in the world.

    The bend is linear in the unknowns, and control points are assumed to move with the frames that see them; hence
    the rounds.
    """
    measured = placing.measured
    scene, always = measured.scene, measured.settings.adjust == "yes"
    placed, bent, start = placing, world, _frames(world, scene)[:, :3, 3]
    least = tuning.world.fit.least_bend * rms_length(shape.sigma[:, None])
    for _ in range(3):  # at most: the model is bent, and fitted again
        assert placed.fit.bent is not None
        step, sigma = shape.step(np.arange(scene.frames), placed.fit.bent[0])
        if rms_length(step) < least and not (always and placed is placing):
            break
        bent = bent_by(bent, scene, (step, sigma), held, tuning)
        poses = _frames(bent, scene)
        places = [t.place for t in _points(bent, scene, measured.given, tuning.world)]
        done = shape.coefficients(poses[:, :3, 3] - start)
        placed = placing.of_bent(poses, np.reshape(places, (-1, 3))[measured.points], done)
    if placed is not placing:
        bent = moved(bent, placed.fit.similarity)
    return placed, bent


def _shape(model: pycolmap.Reconstruction, scene: Scene, held: ConstantParameters, tuning: Tuning) -> Shape | None:
    """How far a model may be bent, given its images, where that is not known yet; None where its points do not
    determine it, and for models that are too large."""
    if model.num_reg_frames() > MOST_FRAMES:
        return None
    free, rigs = free_cameras(model, tuning.adjust) - set(held.cameras), set(model.rigs) - set(held.rigs)
    try:
        sigma = position_sigma(model, free, rigs, nominal=nominal_geometry(model, scene), tuning=tuning)
        return Shape.of(model, sigma, scene)
    except (ValueError, RuntimeError):
        return None


@dataclass(frozen=True)
class GeorefRequest:
    """The input of a child process that brings the models on disk into one world; picklable."""

    folders: tuple[Path, ...]  # the first is the largest
    target: Path
    scene: str  # JSON
    settings: GeorefSettings
    measurements: Measurements
    constant: ConstantParameters
    tuning: Tuning
    database: Path


def georeference_folders(request: GeorefRequest, send: Callable[[Any], None]) -> OneWorld:
    """The models of ``folders`` in one world, as one model in ``target``; the model itself and the evidence that placed
    it are not returned."""
    scene, settings, tuning, held = Scene.from_json(request.scene), request.settings, request.tuning, request.constant
    models = [read_model(folder) for folder in request.folders]
    given, unfit = as_marked(models[0], scene, request.measurements, tuning.world)
    nothing = VerifiedMatches(np.zeros((0, 2), int), (), {})
    verified = read_verified(request.database, scene) if len(models) > 1 else nothing
    made = one_world(
        models, scene, verified,
        similarity=lambda model, given: georeference(model, scene, settings, tuning.world, given),
        whole=lambda model, given: georeference_model(model, scene, settings, tuning, given, held),
        given=given, tuning=tuning,
    )  # fmt: skip
    assert made.model is not None
    request.target.mkdir(parents=True, exist_ok=True)
    made.model.write(str(request.target))
    first = replace(made.first, placing=None)
    return replace(made, first=first, model=None, contradictions=(*made.contradictions, *unfit))


def as_marked(
    model: pycolmap.Reconstruction, scene: Scene, given: Measurements, tuning: WorldTuning
) -> tuple[Measurements, tuple[str, ...]]:
    """The measurements with the marks of control points converted to the images of the survey, if they were made in
    copies of these; without control points whose marks fit no better than random ones, and a note on that."""
    control, bars = given.control, given.bars
    if control is None:
        return given, ()
    copy, note = copy_of(model, scene, control.marks, tuning.marks)
    marks, notes = as_copy(control.marks, scene, copy, tuning.marks), (*control.notes, *([note] if note else []))
    bars = bars and replace(bars, marks=as_copy(bars.marks, scene, copy, tuning.marks))
    control = replace(control, marks=marks, notes=notes)
    chance = by_chance(targets(model, scene, marks, len(control), tuning.marks))
    if chance <= CHANCE:
        return replace(given, control=control, bars=bars), ()
    return replace(given, control=None, bars=bars), (
        f"no control point is used: randomly placed marks would fit as well (probability {chance:.2g}); are they "
        "pixels of other images, or were the images cropped?",
    )


def _points(model: pycolmap.Reconstruction, scene: Scene, given: Measurements, tuning: WorldTuning) -> list[Target]:
    """The control points in a model."""
    control = given.control
    return [] if control is None else targets(model, scene, control.marks, len(control), tuning.marks)


def _check(placing: SimilarityFit) -> tuple[bool, str, np.ndarray | None]:
    """Whether the held-out positions fit the bent model at least as well as the similarity, why, and their residuals
    (K, 3) metres."""
    fixes, bounds = placing.fixes, placing.tuning.fit
    plain, bends = placing.held_out(bends=False), placing.held_out(bends=True)
    if plain is None or bends is None or fixes.held.sum() < LEAST_PLACES:
        if len(placing.measured.points) and not len(fixes):
            return True, "there are only control points, and none was held out", None
        return False, "there are too few positions to hold some out as a check", None
    sigma = placing.evidence.sigma[: len(fixes)][fixes.held]
    a, b = (_score(off[fixes.held] / sigma) for off in (plain, bends))
    text = (
        f"{fixes.held.sum()} held-out positions differ by {b:.2f} of their sigmas (RMS), with the similarity alone by "
        f"{a:.2f}"
    )
    return b <= bounds.not_worse * a, text, bends


def _score(residual: np.ndarray) -> float:
    """Root mean square per axis in sigmas, single outliers clipped."""
    distance = np.minimum(np.linalg.norm(residual, axis=1), LIMIT * np.sqrt(3))
    return float(np.sqrt(np.mean(distance**2) / 3))


def _control(
    first: Georeference, world: pycolmap.Reconstruction, scene: Scene, given: Measurements, tuning: WorldTuning
) -> PointsFound:
    """Control points and scale bars in the adjusted model; blunders stay what they are."""
    control, bars = first.control, bars_in(world, scene, given.bars, tuning.marks)
    if given.control is not None:
        found = [
            replace(target, why_not=row["why_not"], blunder=True) if row["blunder"] else target
            for target, row in zip(_points(world, scene, given, tuning), control.rows)
        ]
        off = np.array([t.place for t in found]).reshape(-1, 3) - given.control.world_m
        rows, accuracy = point_table(given.control, found, off, scene.names)
        control = replace(control, rows=tuple(rows), accuracy=accuracy)
    return replace(control, bars=() if bars is None else bars.rows(1.0))


def _frames(model: pycolmap.Reconstruction, scene: Scene) -> np.ndarray:
    """(F, 4, 4) of the scene's frames in a metric model."""
    return frame_poses(image_poses(model, scene), scene)


def bent_by(
    world: pycolmap.Reconstruction,
    scene: Scene,
    steps: tuple[np.ndarray, np.ndarray],
    held: ConstantParameters,
    tuning: Tuning,
) -> pycolmap.Reconstruction:
    """A copy of a model whose frames were moved in the world by ``steps`` (F, 3), with sigmas (F, 3); everything else
    follows as the images determine it."""
    centres = np.array([world.image(k).projection_center() for k in world.reg_image_ids()])
    step, sigma = steps[0], np.maximum(steps[1], _FIRM * rms_length(centres - centres.mean(axis=0)))
    places: dict[int, PlacePrior] = {}
    for index, name in enumerate(scene.names):
        image, frame = world.find_image_with_name(name), scene.frame[index]
        pose = None if image is None else world.frame(image.frame_id).rig_from_world
        if image is None or pose is None or image.frame_id in places:
            continue
        centre = transforms.centre(matrix(pose))
        places[image.frame_id] = PlacePrior(image=image.image_id, place=centre + step[frame], sigma=sigma[frame])
    ties = of_one_shot(world, scene, tuning.rig)
    known = rig_priors(world, scene, held.soft, tuning.rig)
    known = replace(known, relative_poses=ties, places=tuple(places.values()))
    return adjusted_to(world, held.rigs, held.cameras, known, tuning=tuning.adjust)


def similarity_to(before: pycolmap.Reconstruction, after: pycolmap.Reconstruction, first: Similarity) -> Similarity:
    """The similarity from the model as mapped to the world that is closest to the adjusted one."""
    names = [i for i in before.reg_image_ids() if i in after.images and after.image(i).has_pose]
    a = np.array([before.image(i).projection_center() for i in names])
    b = np.array([after.image(i).projection_center() for i in names])
    moved = umeyama(first(a), b)
    return Similarity(moved.scale * first.scale, moved.rotation @ first.rotation, moved(first.translation[None])[0])
