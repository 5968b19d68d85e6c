"""From a model to the world: the similarity, then the adjustment with positions where it stands its check."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.geometry.align import Similarity
from tiegraph.scene.colmapmodel import image_poses, read_model, sim3d
from tiegraph.scene.evidence import CHANCE
from tiegraph.scene.scene import Scene
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.world import WorldTuning
from tiegraph.sfm.verified import VerifiedMatches, read_verified
from tiegraph.sfm.world import worldadjust
from tiegraph.sfm.world.antenna import told
from tiegraph.sfm.world.bars import bars_in
from tiegraph.sfm.world.fixes import Fixes, Measurements
from tiegraph.sfm.world.georef import Georeference, HeldOut, applied_receiver, bar_rows, georeference, row_of_frames
from tiegraph.sfm.world.marks import Target, as_copy, by_chance, copy_of, marked, point_table, targets
from tiegraph.sfm.world.oneworld import ByPositions, OneWorld, one_world
from tiegraph.sfm.world.scale import BARS
from tiegraph.sfm.world.similarityfit import SimilarityFit
from tiegraph.sfm.world.statements import with_statements
from tiegraph.sfm.world.worldadjust import (
    AdjustmentResult,
    ConstantParameters,
    Constraints,
    Lengths,
    Receiver,
    adjust_in_world,
)


def georeference_model(
    model: pycolmap.Reconstruction,
    scene: Scene,
    settings: GeorefSettings,
    tuning: Tuning,
    given: Measurements | None = None,
    held: ConstantParameters | None = None,
) -> tuple[Georeference, pycolmap.Reconstruction]:
    """The georeference of a model, judged (``statements.py``), and the model in the world; see ``_grounded``."""
    given, held = given or Measurements(), held or ConstantParameters()
    found, world = _georeferenced(model, scene, settings, tuning, given, held)
    points = _points(world, scene, given, tuning.world) if given.control is not None else []
    return with_statements(found, scene, points), world


def _georeferenced(
    model: pycolmap.Reconstruction,
    scene: Scene,
    settings: GeorefSettings,
    tuning: Tuning,
    given: Measurements,
    held: ConstantParameters,
) -> tuple[Georeference, pycolmap.Reconstruction]:
    """The georeference of a model and the model in the world.

    First the similarity of ``georeference``. Then a bundle adjustment with the positions and control points takes out
    drift, which no similarity can; it is kept only if positions it did not know (every fifth) are met at least as well
    as with the similarity, and the images no worse. What was decided, and why, is in the notes.
    """
    first = georeference(model, scene, settings, tuning.world, given)
    world = first.apply(model)
    placing = first.placing
    if placing is None or settings.adjust == "no":
        return first, world
    constraints = _constraints(world, scene, first, placing, tuning, given, held)
    settled = worldadjust.settled(world, tuning.adjust)
    check = _check(settled, scene, placing, constraints)
    checked, why = check.good, check.why
    if not checked and settings.adjust == "auto":
        return _with(first, f"the similarity stays, a bundle adjustment with the positions was refused: {why}"), world
    bounds = tuning.world.adjustment
    near = settled
    if checked and check.model is not None:  # what four fifths of the positions took out of a long way is out
        near, receiver = check.model, constraints.receiver
        off = worldadjust.residuals(near, scene, constraints.fixes, np.array(receiver.antenna), receiver.offset_s)
        constraints = replace(constraints, factor=worldadjust.factors(off, constraints))
    made = adjust_in_world(near, scene, constraints, bounds.rounds)
    made = replace(made, before_px=float(settled.compute_mean_reprojection_error()))  # not of what these have bent
    if made.after_px > bounds.worse_pixels * made.before_px and settings.adjust == "auto":
        text = f"the images fit worse with it ({made.before_px:.3f} -> {made.after_px:.3f} px)"
        return _with(first, f"the similarity stays, a bundle adjustment with the positions was refused: {text}"), world
    adjusted = _adjusted(first, made, model, world, scene, given, why)
    if check.held is not None:
        adjusted = replace(adjusted, residuals=replace(adjusted.residuals, held=check.held))
    return adjusted, made.model


@dataclass(frozen=True)
class GeorefRequest:
    """What a child process needs to bring the models on disk into one world; picklable."""

    folders: tuple[Path, ...]  # the first is the largest
    target: Path
    scene: str  # JSON
    settings: GeorefSettings
    measurements: Measurements
    constant: ConstantParameters
    tuning: Tuning
    database: Path
    refused: tuple[tuple[int, int], ...] = ()  # pairs (scene indices) whose matches are not believed


def georeference_folders(request: GeorefRequest, send: Callable[[Any], None]) -> OneWorld:
    """The models of ``folders`` in one world, as one model in ``target``; of that model, nothing is returned."""
    scene, settings, tuning, held = Scene.from_json(request.scene), request.settings, request.tuning, request.constant
    models = [read_model(folder) for folder in request.folders]
    given, unfit = as_marked(models[0], scene, request.measurements, tuning.world)
    nothing = VerifiedMatches(np.zeros((0, 2), int), (), {})
    verified = read_verified(request.database, scene, request.refused) if len(models) > 1 else nothing
    by_positions = ByPositions(
        similarity=lambda model, given: georeference(model, scene, settings, tuning.world, given),
        whole=lambda model, given: georeference_model(model, scene, settings, tuning, given, held),
    )
    made = one_world(models, scene, verified, by_positions, given, tuning)
    assert made.model is not None
    request.target.mkdir(parents=True, exist_ok=True)
    made.model.write(str(request.target))
    return replace(made, model=None, contradictions=(*made.contradictions, *unfit))


def as_marked(
    model: pycolmap.Reconstruction, scene: Scene, given: Measurements, tuning: WorldTuning
) -> tuple[Measurements, tuple[str, ...]]:
    """The same with the marks of control points in the images of the survey, if they were made in copies of these;
    without control points whose marks are as good as random ones, and what is to be said of that."""
    control, bars = given.control, given.bars
    if control is None:
        return given, ()
    copy, note = copy_of(model, scene, control.marks, tuning.marks)
    marks, notes = as_copy(control.marks, scene, copy, tuning.marks), (*control.notes, *([note] if note else []))
    bars = bars and replace(bars, marks=as_copy(bars.marks, scene, copy, tuning.marks))
    control = replace(control, marks=marks, notes=notes)
    chance = by_chance(targets(model, scene, marks, len(control), tuning.marks), tuning.marks)
    if chance > CHANCE:
        text = f"no control point is used: the rays of marks set at random meet as well (chance {chance:.2g})"
        return replace(given, control=None, bars=bars), (
            f"{text}: pixels of other images, or images that were cropped?",
        )
    return replace(given, control=control, bars=bars), ()


def _with(georeference: Georeference, note: str) -> Georeference:
    findings = georeference.findings
    return replace(georeference, findings=replace(findings, notes=(*findings.notes, note)))


def _constraints(
    world: pycolmap.Reconstruction,
    scene: Scene,
    first: Georeference,
    placing: SimilarityFit,
    tuning: Tuning,
    given: Measurements,
    held: ConstantParameters,
) -> Constraints:
    evidence, control = placing.evidence, given.control
    up = placing.up
    if up is not None:
        up = replace(up, direction=np.array([0.0, 0.0, 1.0]))  # it was brought there by the similarity
    stretch, found = 1.0, []
    if control is not None:
        found = marked(_points(world, scene, given, tuning.world), first.control.rows)
    if control is not None and len(placing.points):
        stretch = float(np.median(evidence.sigma[len(placing.fixes) :] / control.sigma_m[placing.points]))
    return Constraints(
        fixes=placing.fixes,
        factor=placing.factor,
        receiver=Receiver(
            antenna=placing.fit.arm.place,
            offset_s=placing.fit.clock.offset_s,
            free_antenna=told(placing.fit, evidence),
            free_offset=bool(placing.fit.clock.offset_s),
        ),
        held=held,
        tuning=tuning,
        control=control,
        targets=found,
        point_factor=stretch,
        up=up,
        lengths=_lengths(world, scene, placing, given, tuning.world),
    )


def _points(model: pycolmap.Reconstruction, scene: Scene, given: Measurements, tuning: WorldTuning) -> list[Target]:
    """The control points in a model."""
    assert given.control is not None
    return targets(model, scene, given.control.marks, len(given.control), tuning.marks)


def _lengths(
    world: pycolmap.Reconstruction, scene: Scene, placing: SimilarityFit, given: Measurements, tuning: WorldTuning
) -> Lengths | None:
    """The scale bars that hold lengths in the adjustment: those that the similarity believed, where it used them."""
    found = placing.model.bars
    if given.bars is None or found is None or BARS not in placing.weighed.scale_used:
        return None
    ends = targets(world, scene, given.bars.marks, len(given.bars.names), tuning.marks)
    there = np.array([not (ends[a].why_not or ends[b].why_not) for a, b in given.bars.ends], bool)
    return Lengths(given.bars, ends, found.used & there)


@dataclass(frozen=True)
class _Check:
    """Whether an adjustment may be kept, why, how it meets the positions it did not know, and the model it made.

    That is, where the similarity of all positions puts it.
    """

    good: bool
    why: str
    held: HeldOut | None = None
    model: pycolmap.Reconstruction | None = None


def _check(world: pycolmap.Reconstruction, scene: Scene, placing: SimilarityFit, constraints: Constraints) -> _Check:
    """Whether an adjustment without the held-out positions meets them at least as well as such a similarity; and how.

    The model starts from the similarity that did not know them either.
    """
    fixes, blind, bounds = placing.fixes, placing.held_out, placing.tuning.adjustment
    out = np.flatnonzero(fixes.held)
    if blind is None or len(out) < bounds.min_held:
        if len(placing.points) and not len(fixes):
            return _Check(True, "control points only: nothing was held out")
        return _Check(False, "too few positions to hold some back as a check")
    start = pycolmap.Reconstruction(world)
    start.transform(_between(placing.fit.similarity, blind.similarity))
    keep = ~fixes.held
    known = replace(
        constraints,
        fixes=fixes.where(keep),
        factor=placing.factor[keep],
        receiver=replace(constraints.receiver, antenna=blind.arm.place, offset_s=blind.clock.offset_s),
    )
    made = adjust_in_world(start, scene, known, bounds.check_rounds, filtered=False)
    held = fixes.where(fixes.held)
    sigma = held.sigma * placing.factor[out, None]
    before = worldadjust.residuals(start, scene, held, blind.arm.place, blind.clock.offset_s) / sigma
    after = worldadjust.residuals(made.model, scene, held, made.antenna, made.offset_s) / sigma
    a, b = _score(before, bounds.clip_sigmas), _score(after, bounds.clip_sigmas)
    believed = placing.fit.inlier[out]
    text = f"{len(out)} positions held back are met within {b:.2f} of their sigmas, with the similarity {a:.2f}"
    met = HeldOut((after * sigma)[believed], held.stated[believed])
    made.model.transform(_between(blind.similarity, placing.fit.similarity))  # weak positions would not bring it back
    return _Check(good=b <= bounds.not_worse * a, why=text, held=met, model=made.model)


def _score(residual: np.ndarray, clip: float) -> float:
    """Root mean square per axis in sigmas, single outliers clipped."""
    distance = np.minimum(np.linalg.norm(residual, axis=1), clip * np.sqrt(3))
    return float(np.sqrt(np.mean(distance**2) / 3))


def _between(first: Similarity, second: Similarity) -> pycolmap.Sim3d:
    """From the world of one similarity to that of another."""
    scale, rotation = second.scale / first.scale, second.rotation @ first.rotation.T
    shift = second.translation - scale * rotation @ first.translation
    return sim3d(Similarity(scale, rotation, shift))


def _adjusted(
    first: Georeference,
    made: AdjustmentResult,
    model: pycolmap.Reconstruction,
    world: pycolmap.Reconstruction,
    scene: Scene,
    given: Measurements,
    why: str,
) -> Georeference:
    assert first.placing is not None
    tuning = first.placing.tuning
    fixes: Fixes = first.placing.fixes
    at = row_of_frames(fixes, scene.frames)
    has = np.flatnonzero(at >= 0)
    residual, inlier = np.full((scene.frames, 3), np.nan), np.zeros(scene.frames, bool)
    residual[has] = made.residual[at[has]]
    sigma = fixes.sigma * made.factor[:, None] if len(fixes) else fixes.sigma
    inlier[has] = np.linalg.norm(made.residual / sigma, axis=1)[at[has]] < tuning.fit.inlier_sigmas * np.sqrt(3)
    control = first.control
    if given.control is not None:
        found = marked(_points(made.model, scene, given, tuning), control.rows)
        off = np.array([t.place for t in found]).reshape(-1, 3) - given.control.world_m
        rows, accuracy = point_table(given.control, found, off, scene.names)
        control = replace(control, rows=tuple(rows), accuracy=accuracy)
    bars = bars_in(made.model, scene, given.bars, tuning.marks)
    control = replace(control, bars=bar_rows(bars, 1.0))
    step = _centres(made.model, scene) - _centres(world, scene)
    moved, of_frames = np.linalg.norm(step, axis=1), np.full((scene.frames, 3), np.nan)
    of_frames[scene.frame[::-1]] = step[::-1]  # by the first image of each
    note = (
        f"adjusted with the positions: frames moved by {np.nanmedian(moved):.3f} m (at most {np.nanmax(moved):.3f} m), "
        f"reprojection {made.before_px:.3f} -> {made.after_px:.3f} px"
    )
    known, bent = first.uncertainty, first.placing.fit.bent
    shape = known.shape if known.shape is None or bent is None else known.shape.told(*bent, of_frames)
    adjusted = replace(
        first,
        uncertainty=replace(known, shape=shape),
        world_from_model=worldadjust.similarity_to(model, made.model, first.world_from_model),
        residuals=replace(first.residuals, frames_m=residual, inlier=inlier, fixes_m=made.residual),
        receiver=applied_receiver(made.antenna, made.offset_s),
        control=control,
        adjusted=True,
    )
    return _with(_with(adjusted, note), f"check of this adjustment: {why}")


def _centres(model: pycolmap.Reconstruction, scene: Scene) -> np.ndarray:
    poses = image_poses(model, scene)
    return -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
