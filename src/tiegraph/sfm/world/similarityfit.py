"""Placing a model: the available evidence, the part that is used, and the fit to it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tiegraph.geometry.align import Similarity, rms_length, umeyama
from tiegraph.geometry.geodesy import datum_sigma_m
from tiegraph.scene.evidence import LIMIT, RARELY, fits_better
from tiegraph.scene.scene import Scene
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning.world import FixTuning, WorldTuning
from tiegraph.sfm.world.antenna import (
    Fitted,
    arm_text,
    believed,
    clock_text,
    up_to_use,
    with_clock,
)
from tiegraph.sfm.world.fit import Evidence, Fit, by_errors, fit_similarity
from tiegraph.sfm.world.fixes import Fixes, Measurements, make_fixes
from tiegraph.sfm.world.placed import Model, NotPlaced, SimilarityFit
from tiegraph.sfm.world.positionerrors import MEDIAN_CHI2_3, Stated
from tiegraph.sfm.world.sources import POSITIONS
from tiegraph.sfm.world.unknowns import Bend, LeverArm, LogScale
from tiegraph.sfm.world.weighing import EvidenceWeights, Question, weigh


@dataclass(frozen=True)
class _Arm:
    """The given lever arm, or None, and whether to estimate it (None: if the positions determine it)."""

    given: np.ndarray | None
    estimate: bool | None


@dataclass(frozen=True)
class _Given:
    """The input of a georeference: model, survey, measurements; ``points``: rows of the control points used."""

    model: Model
    scene: Scene
    settings: GeorefSettings
    measured: Measurements
    points: np.ndarray
    tuning: WorldTuning

    @cached_property
    def bend(self) -> np.ndarray:
        """(F, 3, M) movement of the frames by each mode of the model's shape, model units."""
        shape, frames = self.measured.shape, np.arange(self.scene.frames)
        return np.zeros((len(frames), 3, 0)) if shape is None else shape.at(frames)


def fit_to_world(
    model: Model, scene: Scene, settings: GeorefSettings, given: Measurements, tuning: WorldTuning
) -> SimilarityFit | NotPlaced:
    """Fit the model to all measurements in the world, if there are enough and the model is not mirrored."""
    notes, tuning = [], with_clock(tuning, scene)
    registered = np.all(np.isfinite(model.frames(scene)), axis=(1, 2))
    stated = make_fixes(scene, registered, given, tuning.fixes)
    points = _usable_points(model, given)
    frames = len(np.unique(stated.home))
    places = len(np.unique(stated.position, axis=0))  # EXIF may give one position for a whole object
    if min(frames, places) + len(points) < tuning.similarity_fit.min_positions:
        few = f"{frames} registered frames have a prior position"
        few += f" ({places} different ones)" if places < frames else ""
        few += f" and {len(points)} control points can be used" if given.control is not None else ""
        return NotPlaced(f"{few}, {tuning.similarity_fit.min_positions} are needed")
    arm = _lever_arm(scene, settings, notes)
    about = _Given(model=model, scene=scene, settings=settings, measured=given, points=points, tuning=tuning)
    weighed, rough = _weighed(about, stated, arm)
    moving = given.rows is not None and settings.antenna != "ignored"
    free = replace(rough.evidence.with_arm(arm.estimate is not False), estimate_offset=moving)
    now = believed(free, rough.fixes, model.up, rough.fit.similarity, tuning)
    if against := _mirrored(now, about) or _upside_down(now, about):
        return NotPlaced(against, contradicts=True)
    rows = _position_rows(now.fixes, scene, weighed.extra_m, tuning.fixes)
    fit = by_errors(now.evidence, None, now.fit, rows, tuning.fit, tuning.noise)
    if arm.estimate is None and not moving and not _significant(fit, now.evidence):  # positions of the cameras by name
        now = believed(free.with_arm(estimate=False), now.fixes, model.up, now.fit.similarity, tuning)
        fit = by_errors(now.evidence, None, now.fit, rows, tuning.fit, tuning.noise)
    up = None
    if model.up is not None:
        start = fit_similarity(now.evidence, model.up, tuning.fit)
        upright = by_errors(now.evidence, model.up, start, rows, tuning.fit, tuning.noise)
        up = up_to_use(now.evidence, model.up, notes, tuning, fit, upright)
        fit = fit if up is None else upright
    if not 0 < fit.sigma["scale"] < tuning.sources.any_scale:
        return NotPlaced(
            f"{fit.inlier.sum()} of {len(fit.inlier)} positions agree with it, and do not determine its size"
        )
    notes += [arm_text(fit, now.evidence, tuning)] if now.evidence.arm.estimate else []
    notes += [clock_text(fit, now.evidence)] if moving else []
    return SimilarityFit(
        evidence=now.evidence,
        fixes=now.fixes,
        fit=fit,
        up=up,
        points=points,
        notes=tuple(notes),
        weighed=replace(weighed, doubt=_looking_up(now, about)),
        model=model,
        tuning=tuning,
        rows=rows,
    )


def _significant(fit: Fit, evidence: Evidence) -> bool:
    """Whether the antenna certainly differs from its given place."""
    off = fit.arm.place - evidence.arm.place
    return bool(off @ np.linalg.pinv(fit.arm.covariance, hermitian=True) @ off > LIMIT**2)


def _position_rows(fixes: Fixes, scene: Scene, extra_m: np.ndarray, tuning: FixTuning) -> Stated:
    """The fixes as stated, with (3,) ``extra_m`` added where another source contradicts them, and their common error:
    part of a receiver's stated error is constant (base station, atmosphere), and so is the error of the datum."""
    common = np.full(3, np.nan)
    if scene.prior in ("gnss", "exif") and len(fixes):
        datum = 0.0 if scene.origin is None else datum_sigma_m(scene.origin.crs)
        common = np.hypot(tuning.lasting * np.median(fixes.stated, axis=0), datum * np.array([0.5, 0.5, 0.0]) ** 0.5)
    sigma = np.hypot(np.maximum(fixes.stated, 1e-3), extra_m)
    return Stated(sigma=sigma, level=fixes.level, time_s=fixes.time_s, common=common)


def _weighed(about: _Given, stated: Fixes, arm: _Arm) -> tuple[EvidenceWeights, Fitted]:
    """The selection of the measurements, and the first fit to them.

    Selected once, fitted twice: the second time with the true scale for frames known through another camera than the
    first.
    """
    model, scene, tuning = about.model, about.scene, about.tuning
    fixes, frames = stated, model.frames(scene)
    metres = 1.0 if model.scale is None else model.scale.metres_per_unit
    weighed: EvidenceWeights | None = None
    for _ in range(tuning.similarity_fit.rounds):
        evidence = _with_points(_evidence(frames, fixes, about, arm), about, metres)
        if weighed is None:
            weighed = weigh(_question(evidence, stated, about, arm))
        fixes = fixes.blurred(weighed.extra_m)
        blurred = np.concatenate([fixes.sigma, evidence.sigma[len(fixes) :]])
        evidence = replace(evidence, sigma=blurred, log_scale=evidence.log_scale if weighed.lengths_used else None)
        fit = fit_similarity(evidence, up_to_use(evidence, model.up, [], tuning), tuning.fit)
        metres = fit.similarity.scale
        frames = model.frames(scene, metres)
        fixes = stated.widened(frames, metres, tuning.fixes)
    assert weighed is not None
    return weighed, Fitted(evidence=evidence, fit=fit, fixes=fixes.blurred(weighed.extra_m), up=model.up)


def _question(evidence: Evidence, stated: Fixes, about: _Given, arm: _Arm) -> Question:
    free = arm.estimate is not False
    return Question(
        evidence=evidence,
        count=len(stated),
        times=time_order(about.scene, stated),
        name=POSITIONS.get(about.scene.prior, "positions"),
        stated=_position_rows(stated, about.scene, np.zeros(3), about.tuning.fixes),
        scale=about.model.scale,
        tuning=about.tuning,
        free_antenna=free,
    )


def time_order(scene: Scene, fixes: Fixes) -> np.ndarray:
    """(K,) times of the fixes, or their index in the order of the passes where there are none."""
    if np.isfinite(fixes.time_s).all():
        return fixes.time_s
    order = np.lexsort((scene.sequence_index[fixes.home], scene.sequence[fixes.home]))
    return np.argsort(order, kind="stable").astype(float)


def _usable_points(model: Model, given: Measurements) -> np.ndarray:
    """Rows of the control points that are used in the georeference."""
    if given.control is None:
        return np.zeros(0, int)
    usable = [k for k, t in enumerate(model.targets) if not t.why_not and not given.control.check[k]]
    return np.array(usable, int)


def _evidence(frames: np.ndarray, fixes: Fixes, about: _Given, arm: _Arm) -> Evidence:
    scene, scale, tuning = about.scene, about.model.scale, about.tuning
    pose, speed = fixes.blend(frames)
    orientation = scene.world_from_rig[fixes.home, :3, :3].copy()
    orientation[fixes.weights.max(axis=1) < tuning.similarity_fit.at_frame] = np.nan
    return Evidence(
        frame=fixes.home,
        pose=pose,
        position=fixes.position,
        sigma=fixes.sigma,
        orientation=orientation,
        arm=LeverArm(np.zeros(3) if arm.given is None else arm.given, arm.estimate is True),
        log_scale=LogScale(np.log(scale.metres_per_unit), scale.sigma) if scale is not None and scale.trusted else None,
        speed=speed,
        bend=Bend.of(np.einsum("kn,knim->kim", fixes.weights, about.bend[fixes.frames])),
    )


def _with_points(evidence: Evidence, about: _Given, metres: float) -> Evidence:
    """The evidence with control points added: rows without rotation, so that no lever arm acts."""
    model, points, control = about.model, about.points, about.measured.control
    if not len(points) or control is None or evidence.bend is None:
        return evidence
    pose = np.zeros((len(points), 4, 4))
    pose[:, :3, 3] = [model.targets[k].place for k in points]
    spread = np.array([np.sqrt(np.trace(model.targets[k].covariance) / 3) for k in points]) * metres
    sigma = np.hypot(control.sigma_m[points], spread[:, None])
    seen = [about.scene.frame[control.marks.image[model.targets[k].marks]] for k in points]
    bend = [about.bend[f].sum(axis=0) / max(len(f), 1) for f in seen]  # a point moves with the frames that see it
    sigma *= _point_factor(pose[:, :3, 3], control.world_m[points], sigma, about.tuning)
    return replace(
        evidence,
        frame=np.append(evidence.frame, np.full(len(points), -1)),
        pose=np.concatenate([evidence.pose, pose]),
        speed=None if evidence.speed is None else np.concatenate([evidence.speed, np.zeros_like(pose)]),
        position=np.concatenate([evidence.position, control.world_m[points]]),
        sigma=np.concatenate([evidence.sigma, sigma]),
        orientation=np.concatenate([evidence.orientation, np.full((len(points), 3, 3), np.nan)]),
        bend=Bend.of(np.concatenate([evidence.bend.modes, bend])),
    )


def _point_factor(place: np.ndarray, world: np.ndarray, sigma: np.ndarray, tuning: WorldTuning) -> float:
    """Ratio of the differences between control points to their sigmas; 1 with three of them."""
    count = len(place)
    if count < tuning.similarity_fit.min_positions + 1:
        return 1.0
    off = umeyama(place, world, 1 / sigma[:, 0] ** 2)(place) - world
    squares = np.sum((off / sigma) ** 2, axis=1)
    typical = float(np.mean(squares))
    if count >= tuning.similarity_fit.many_points:
        typical = float(np.median(squares)) * 3 / MEDIAN_CHI2_3
    return max(1.0, float(np.sqrt(typical * count / (3 * count - 7))))


def _mirrored(now: Fitted, about: _Given) -> str:
    """A message if the positions fit clearly better with east and north exchanged, which makes a mirror image; else
    "".

    From the errors in plan (``fits_better``), over the inliers of both readings. A straight track is its own mirror
    image, so there is no message for it.
    """
    off = now.evidence.position_residuals(now.fit.similarity, now.fit.arm.place)
    if np.median(np.linalg.norm(off, axis=1)) < about.tuning.fit.antenna_sigma_m:
        return ""
    rows, errors, _ = _exchanged(now, about)
    first, second = (rms_length(r[:, :2]) for r in errors)
    free = 2 * about.tuning.statements.least_positions - 4  # a similarity in plan has four unknowns
    if not fits_better(first, second, free) or not _whole(now.evidence.frame[rows], about):
        return ""
    return (
        f"the positions are a mirror image of the model: they miss it by {first:.2f} m in plan, with their first two "
        f"coordinates exchanged by {second:.2f} m, {RARELY}: are latitude and longitude, or north and east, exchanged "
        "in the GNSS file? The positions are not used"
    )


def _exchanged(now: Fitted, about: _Given) -> tuple[np.ndarray, list[np.ndarray], Similarity]:
    """The inliers of both readings of the positions, (K,) bool; their residuals as given and with their first two
    coordinates exchanged; the similarity of the model if they are exchanged."""
    evidence, fit, tuning = now.evidence, now.fit, about.tuning
    stated, turn = np.concatenate([now.fixes.sigma, evidence.sigma[len(now.fixes) :]]), [1, 0, 2]
    turned = replace(evidence, position=evidence.position[:, turn], sigma=stated[:, turn])
    start = fit_similarity(turned, None, tuning.fit).similarity
    other = believed(turned, replace(now.fixes, sigma=now.fixes.sigma[:, turn]), None, start, tuning).fit
    rows, both = fit.inlier | other.inlier, ((evidence, fit), (turned, other))
    return rows, [e.position_residuals(f.similarity, f.arm.place)[rows] for e, f in both], other.similarity


def _looking_up(now: Fitted, about: _Given) -> str:
    """A message if cameras look up with a receiver's positions as given, but look down with an equally good fit if
    two columns are exchanged: a flight at constant height is its own mirror image turned over."""
    steep, scene, fit = about.tuning.similarity_fit.looks_up_deg, about.scene, now.fit
    axes = about.model.images[scene.of_role("side"), 2, :3]
    axes = axes[np.isfinite(axes).all(axis=1)]

    def up_deg(placed: Similarity) -> float:
        return float(np.degrees(np.arcsin(np.clip(np.mean(axes @ placed.rotation[2]), -1, 1))))

    oriented = np.isfinite(now.evidence.orientation).all(axis=(1, 2)).any()
    if scene.prior not in ("gnss", "exif") or oriented or not len(axes) or not _whole(now.evidence.frame, about):
        return ""
    if up_deg(fit.similarity) - LIMIT * fit.sigma["tilt_deg"] < steep:
        return ""
    _, errors, other = _exchanged(now, about)
    first, second = (rms_length(r) for r in errors)
    if up_deg(other) > -steep or fits_better(second, first, 3 * about.tuning.statements.least_positions - 7):
        return ""
    return (
        f"with these positions the cameras look up, by {up_deg(fit.similarity):.0f} deg on average (sigma "
        f"{fit.sigma['tilt_deg']:.1f} deg); with their first two coordinates exchanged the positions fit as well "
        f"({first:.2f} and {second:.2f} m), and the cameras look down: if they did, latitude and longitude, or north "
        "and east, are exchanged in the GNSS file (a mirror image)"
    )


def _upside_down(now: Fitted, about: _Given) -> str:
    """A message if the positions alone turn a ring of cameras upside down: the mirror image of a track.

    Two passes side by side and mirrored are the same passes turned over, so the residuals of a fit do not show it.
    """
    evidence, fixes, up, tuning = now.evidence, now.fixes, now.up, about.tuning
    if up is None or not up.ring or not len(fixes) or not _whole(fixes.home, about):
        return ""
    rows = np.arange(len(evidence.frame)) < len(fixes)
    free = replace(evidence.where(rows), sigma=fixes.sigma).with_arm(estimate=True).without_orientations()
    alone = believed(free, fixes, None, fit_similarity(free, None, tuning.fit).similarity, tuning).fit
    lean_deg = float(np.degrees(np.arccos(np.clip((alone.similarity.rotation @ up.direction)[2], -1, 1))))
    reach_deg = LIMIT * float(np.hypot(alone.roll_sigma_deg, up.sigma_deg))
    if lean_deg < reach_deg or 180 - lean_deg > reach_deg:
        return ""
    return (
        "the positions turn the survey upside down: the tops of the side cameras' images point to the ground, "
        f"although the roll about the track has a sigma of {alone.roll_sigma_deg:.1f} deg; are latitude and "
        "longitude, or north and east, exchanged in the GNSS file (a mirror image)? If the cameras are mounted "
        "upside down, turn the images. The positions are not used"
    )


def _whole(frames: np.ndarray, about: _Given) -> bool:
    """Whether a model covers most of its survey with enough points, from the frames (K,) with the positions used: a
    torn or weak model may be a mirror image itself."""
    asked, known = int(np.isfinite(about.scene.world_from_rig[:, :3, 3]).all(axis=1).sum()), about.tuning.statements
    speak = len(np.unique(frames[frames >= 0])) if asked else len(frames)
    return min(speak, about.measured.firm_frames) >= max(known.least_positions, known.agreeing * asked)


def _lever_arm(scene: Scene, settings: GeorefSettings, notes: list[str]) -> _Arm:
    if scene.prior in ("trajectory", "exif", "none") or settings.antenna == "ignored":
        return _Arm(None, estimate=False)
    arm = next((r.antenna_m for r in scene.rigs if r.antenna_m is not None), None)
    given = None if arm is None else np.array(arm)
    if settings.antenna == "estimated":
        return _Arm(given, estimate=True)
    if settings.antenna == "given" and given is None:
        notes.append(
            "georef.antenna = 'given', but the rig file gives no antenna: positions are taken as those of the cameras"
        )
    return _Arm(given, estimate=False if given is not None or settings.antenna == "given" else None)
