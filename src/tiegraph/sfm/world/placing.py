"""Placing a model: which evidence there is, how noisy it is, whether lever arm and clock can be told from it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.align import Similarity, umeyama
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning.world import WorldTuning
from tiegraph.sfm.world import noise
from tiegraph.sfm.world.fit import Evidence, Fit, fit_similarity
from tiegraph.sfm.world.fixes import Fixes, Given, make_fixes
from tiegraph.sfm.world.gravity import Up
from tiegraph.sfm.world.marks import Target
from tiegraph.sfm.world.scale import RigScale
from tiegraph.sfm.world.sources import POSITIONS, common_of
from tiegraph.sfm.world.weighing import Question, Weighed, weigh
from tiegraph.text import known_to

RIGHT_ANGLE_DEG = 90.0  # an angle with a larger sigma is not known
ARM_GAIN, CLOCK_GAIN = 16.3, 10.8  # chi-square of 3 and of 1 degrees of freedom at 0.1 %


@dataclass(frozen=True)
class Model:
    """What of the model a placement needs."""

    images: np.ndarray  # cam_from_world (N, 4, 4)
    up: Up | None
    scale: RigScale | None
    targets: list[Target]
    names: tuple[str, ...] = ()  # of the images

    def frames(self, scene: Scene, metres_per_unit: float | None = None) -> np.ndarray:
        """world_from_rig (F, 4, 4), by the rig's scale if none is given."""
        guess = 1.0 if self.scale is None else self.scale.metres_per_unit
        return frame_poses(self.images, scene, metres_per_unit or guess)


@dataclass(frozen=True)
class Placing:
    """All a placement rests on; rows of ``evidence`` are the fixes, then the control points."""

    evidence: Evidence  # sigmas as believed
    fixes: Fixes  # sigmas as stated, with doubt about outages and bridges
    fit: Fit
    up: Up | None  # used to hold the tilt
    points: np.ndarray  # (C,) control points in the evidence: rows of the control file
    blind: Fit | None  # without the held-out fixes
    levels: tuple[noise.Level, ...]
    notes: tuple[str, ...]
    weighed: Weighed
    model: Model
    name: str  # of the positions
    tuning: WorldTuning
    clock: tuple[float, float] = (float("nan"), float("nan"))  # the receiver's behind the cameras' and sigma, s

    @property
    def factor(self) -> np.ndarray:
        """(K,) by which the fixes' sigmas were multiplied."""
        count = len(self.fixes)
        return self.evidence.sigma[:count, 0] / self.fixes.sigma[:, 0] if count else np.zeros(0)


def place(model: Model, scene: Scene, settings: GeorefSettings, given: Given, tuning: WorldTuning) -> Placing | None:
    """Fit the model to everything measured in the world; None with too few positions and points."""
    notes: list[str] = []
    frames = model.frames(scene)
    registered = np.isfinite(frames).all(axis=(1, 2))
    fixes = stated = make_fixes(scene, registered, given, settings.sigma_floor_m, tuning.fixes)
    points = _usable_points(model, given)
    if len(np.unique(fixes.home)) + len(points) < tuning.placing.min_positions:
        return None
    arm, estimate = _lever_arm(scene, settings, notes)
    metres = 1.0 if model.scale is None else model.scale.metres_per_unit
    name = POSITIONS.get(scene.prior, "positions")
    weighed: Weighed | None = None
    # The second time with the true scale for frames known through another camera than the first.
    for _ in range(tuning.placing.rounds):
        evidence = _evidence(frames, fixes, scene, (arm, estimate is True), model.scale, tuning)
        evidence = _with_points(evidence, model, given, points, metres, tuning)
        if weighed is None:
            free = estimate is not False
            reach = tuning.fit.antenna_sigma_m if free else 0.0
            common = common_of(stated.sigma, settings.sigma_floor_m, reach) if len(stated) else np.zeros(4)
            times = time_order(scene, fixes)
            weighed = weigh(Question(evidence, len(fixes), times, name, common, model.scale, tuning, free))
        fixes = fixes.blurred(weighed.extra_m)
        blurred = np.concatenate([fixes.sigma, evidence.sigma[len(fixes) :]])
        evidence = replace(evidence, sigma=blurred, log_scale=evidence.log_scale if weighed.rig_used else None)
        fit = fit_similarity(evidence, up_to_use(evidence, model.up, [], tuning), tuning.fit)
        metres = fit.similarity.scale
        frames = model.frames(scene, metres)
        fixes = stated.widened(frames, metres, tuning.fixes)
    assert weighed is not None
    fixes = fixes.blurred(weighed.extra_m)
    evidence, fit = _believed(evidence, fixes, model.up, fit.similarity, tuning)
    _refuse_exchanged(evidence, fit, tuning)
    _refuse_upside_down(evidence, fixes, model.up, tuning)
    if estimate is None:
        evidence, fit = _try_lever_arm(evidence, fit, fixes, model.up, notes, tuning)
    elif estimate:
        evidence, fit = _with_lever_arm(evidence, fit, fixes, model.up, tuning)
        notes.append(_arm_text(evidence, fit, tuning))
    clock = (float("nan"), float("nan"))
    if given.rows is not None and settings.antenna != "ignored":
        evidence, fit, clock = _try_clock(evidence, fit, fixes, model.up, notes, tuning)
    up = up_to_use(evidence, model.up, notes, tuning, fit.similarity)
    blind = None
    held = np.zeros(len(evidence.frame), bool)
    held[: len(fixes)] = fixes.held
    if held.any() and (~held).sum() >= tuning.placing.min_positions:
        blind = fit_similarity(evidence.where(~held), up, tuning.fit, fit.similarity)
    count = len(fixes)
    residual = evidence.position_residuals(fit.similarity, fit.antenna, fit.offset_s)[:count]
    found = noise.levels(residual / fixes.sigma, fixes.level, fixes.sigma, fixes.time_s, tuning.noise)
    said = tuple(found), tuple(notes)
    return Placing(evidence, fixes, fit, up, points, blind, *said, weighed, model, name, tuning, clock)


def time_order(scene: Scene, fixes: Fixes) -> np.ndarray:
    """(K,) times of the fixes, or their places in the order of the passes where there are none."""
    if np.isfinite(fixes.time_s).all():
        return fixes.time_s
    order = np.lexsort((scene.step[fixes.home], scene.track[fixes.home]))
    return np.argsort(order, kind="stable").astype(float)


def _usable_points(model: Model, given: Given) -> np.ndarray:
    """Rows of the control points that enter the placement."""
    if given.control is None:
        return np.zeros(0, int)
    usable = [k for k, t in enumerate(model.targets) if not t.why_not and not given.control.check[k]]
    return np.array(usable, int)


def _evidence(
    frames: np.ndarray,
    fixes: Fixes,
    scene: Scene,
    antenna: tuple[np.ndarray | None, bool],
    scale: RigScale | None,
    tuning: WorldTuning,
) -> Evidence:
    pose, speed = fixes.blend(frames)
    orientation = scene.world_from_rig[fixes.home, :3, :3].copy()
    orientation[fixes.weights.max(axis=1) < tuning.placing.at_frame] = np.nan
    arm, estimate = antenna
    return Evidence(
        frame=fixes.home,
        pose=pose,
        position=fixes.position,
        sigma=fixes.sigma,
        orientation=orientation,
        antenna=np.zeros(3) if arm is None else arm,
        estimate_antenna=estimate,
        log_scale=np.log(scale.metres_per_unit) if scale is not None and scale.trusted else None,
        log_scale_sigma=scale.sigma if scale is not None else np.nan,
        speed=speed,
    )


def _with_points(
    evidence: Evidence, model: Model, given: Given, points: np.ndarray, metres: float, tuning: WorldTuning
) -> Evidence:
    """The evidence with control points added: rows without rotation, so that no lever arm acts."""
    if not len(points) or given.control is None:
        return evidence
    control = given.control
    pose = np.zeros((len(points), 4, 4))
    pose[:, :3, 3] = [model.targets[k].place for k in points]
    spread = np.array([np.sqrt(np.trace(model.targets[k].covariance) / 3) for k in points]) * metres
    sigma = np.hypot(control.sigma_m[points], spread[:, None])
    sigma *= _point_factor(pose[:, :3, 3], control.world_m[points], sigma, tuning)
    return replace(
        evidence,
        frame=np.append(evidence.frame, np.full(len(points), -1)),
        pose=np.concatenate([evidence.pose, pose]),
        speed=None if evidence.speed is None else np.concatenate([evidence.speed, np.zeros_like(pose)]),
        position=np.concatenate([evidence.position, control.world_m[points]]),
        sigma=np.concatenate([evidence.sigma, sigma]),
        orientation=np.concatenate([evidence.orientation, np.full((len(points), 3, 3), np.nan)]),
    )


def _point_factor(place: np.ndarray, world: np.ndarray, sigma: np.ndarray, tuning: WorldTuning) -> float:
    """By how much control points disagree with each other more than their sigmas say; 1 with three of them."""
    count = len(place)
    if count < tuning.placing.min_positions + 1:
        return 1.0
    off = umeyama(place, world, 1 / sigma[:, 0] ** 2)(place) - world
    squares = np.sum((off / sigma) ** 2, axis=1)
    typical = float(np.mean(squares))
    if count >= tuning.placing.many_points:
        typical = float(np.median(squares)) * 3 / noise.MEDIAN_CHI2_3
    return max(1.0, float(np.sqrt(typical * count / (3 * count - 7))))


def _believed(
    evidence: Evidence, fixes: Fixes, up: Up | None, near: Similarity, tuning: WorldTuning
) -> tuple[Evidence, Fit]:
    """The evidence with the fixes' sigmas stretched to what their residuals say, and its fit."""
    used = up_to_use(evidence, up, [], tuning, near)
    fit = fit_similarity(evidence, used, tuning.fit, near)
    count = len(fixes)
    for _ in range(tuning.placing.noise_rounds if count else 0):
        residual = evidence.position_residuals(fit.similarity, fit.antenna, fit.offset_s)[:count] / fixes.sigma
        unknowns = noise.SIMILARITY + 3 * evidence.estimate_antenna + evidence.estimate_offset
        stretched = fixes.stretched(noise.factors(residual, fixes.level, fixes.time_s, tuning.noise, unknowns))
        evidence = replace(evidence, sigma=np.concatenate([stretched.sigma, evidence.sigma[count:]]))
        fit = fit_similarity(evidence, used, tuning.fit, near=fit.similarity)
    return evidence, fit


def _refuse_exchanged(evidence: Evidence, fit: Fit, tuning: WorldTuning) -> None:
    """Raise InputError where the positions fit clearly better with east and north exchanged: a mirror image.

    A straight track is its own mirror image, so that nothing can be said of it.
    """
    reach = tuning.fit.antenna_sigma_m
    if np.median(np.linalg.norm(evidence.position_residuals(fit.similarity, fit.antenna), axis=1)) < reach:
        return
    mirrored = replace(evidence, position=evidence.position[:, [1, 0, 2]])
    other = fit_similarity(mirrored, None, tuning.fit)
    sizes = [
        float(np.median(np.linalg.norm(e.position_residuals(f.similarity, f.antenna)[:, :2], axis=1)))
        for e, f in ((evidence, fit), (mirrored, other))
    ]
    if sizes[1] < sizes[0] / tuning.placing.mirror_gain and sizes[0] > reach:
        raise InputError(
            f"the positions are a mirror image of the survey: they miss the model by {sizes[0]:.2f} m (median), with "
            f"their first two coordinates exchanged by {sizes[1]:.2f} m; are latitude and longitude, or north and "
            "east, exchanged in the GNSS file?"
        )


def _refuse_upside_down(evidence: Evidence, fixes: Fixes, up: Up | None, tuning: WorldTuning) -> None:
    """Raise InputError where the positions alone put a ring of cameras upside down: the mirror image of a track.

    Two passes side by side and mirrored are the same passes turned over, so that the residuals of a fit tell nothing.
    """
    if up is None or not up.ring or len(fixes) < tuning.placing.min_positions:
        return
    rows = np.arange(len(evidence.frame)) < len(fixes)
    free = replace(evidence.where(rows), sigma=fixes.sigma, estimate_antenna=True)
    free = replace(free, orientation=np.full_like(free.orientation, np.nan))
    alone = fit_similarity(free, None, tuning.fit)
    residual = free.position_residuals(alone.similarity, alone.antenna) / fixes.sigma
    factors = noise.factors(residual, fixes.level, fixes.time_s, tuning.noise)
    free = replace(free, sigma=fixes.sigma * factors[:, None])
    alone = fit_similarity(free, None, tuning.fit, alone.similarity)
    lean = float((alone.similarity.rotation @ up.direction)[2])
    if lean < tuning.placing.upside_down and alone.roll_sigma_deg < tuning.placing.roll_limit_deg:
        raise InputError(
            "the positions turn the survey upside down: the tops of the side cameras' images point to the ground, "
            f"though the roll about the track is known to {alone.roll_sigma_deg:.1f} deg; are latitude and longitude, "
            "or north and east, exchanged in the GNSS file (a mirror image)? Or do the cameras hang upside down: then "
            "turn the images"
        )


def _lever_arm(scene: Scene, settings: GeorefSettings, notes: list[str]) -> tuple[np.ndarray | None, bool | None]:
    """The given lever arm or None, and whether to estimate it (None: if the positions can tell)."""
    if scene.prior in ("trajectory", "exif", "none") or settings.antenna == "ignored":
        return None, False
    arm = next((r.antenna_m for r in scene.rigs if r.antenna_m is not None), None)
    given = None if arm is None else np.array(arm)
    if settings.antenna == "estimated":
        return given, True
    if settings.antenna == "given" and given is None:
        notes.append("georef.antenna = 'given', but the rig file gives no antenna: the cameras are taken to be there")
    return given, False if given is not None or settings.antenna == "given" else None


def _try_lever_arm(
    evidence: Evidence, fit: Fit, fixes: Fixes, up: Up | None, notes: list[str], tuning: WorldTuning
) -> tuple[Evidence, Fit]:
    """Estimate the lever arm if the positions tell it in plan and agree clearly better with it."""
    richer, other = _with_lever_arm(evidence, fit, fixes, up, tuning)
    used = up_to_use(richer, up, [], tuning, other.similarity)
    plain = fit_similarity(replace(richer, estimate_antenna=False), used, tuning.fit, near=fit.similarity)
    plan_sigma = arm_sigma(richer, other)[0]
    if plan_sigma < _arm_limit_m(tuning) and plain.cost - other.cost > ARM_GAIN:
        notes.append(_arm_text(richer, other, tuning))
        return richer, other
    why = (
        f"it is known to {plan_sigma:.2f} m only: that needs headings that differ, such as a return pass"
        if plan_sigma >= _arm_limit_m(tuning)
        else "with one the positions fit no better"
    )
    notes.append(f"no lever arm given and none estimated ({why}): the antenna is taken to be at the reference camera")
    return evidence, fit


def _arm_limit_m(tuning: WorldTuning) -> float:
    """Sigma up to which a lever arm counts as known."""
    return tuning.placing.arm_share * tuning.fit.antenna_sigma_m


def _with_lever_arm(
    evidence: Evidence, fit: Fit, fixes: Fixes, up: Up | None, tuning: WorldTuning
) -> tuple[Evidence, Fit]:
    """The fit with the lever arm as unknown, without its height where that cannot be told.

    It begins with the sigmas as stated: without the lever arm all positions looked bad, and among those that are bad
    for another reason hide.
    """
    stated = np.concatenate([fixes.sigma, evidence.sigma[len(fixes) :]])
    evidence = replace(evidence, sigma=stated, estimate_antenna=True)
    richer, other = _believed(evidence, fixes, up, fit.similarity, tuning)
    if arm_sigma(richer, other)[1] > _arm_limit_m(tuning):
        held = replace(evidence, level=_upward(richer, other))
        return _believed(held, fixes, up, fit.similarity, tuning)
    return richer, other


def _upward(evidence: Evidence, fit: Fit) -> np.ndarray:
    """Mean upward direction (3,) in the rig frame."""
    turn = np.einsum("ij,kjl->kil", fit.similarity.rotation, evidence.pose[evidence.frame >= 0, :3, :3])
    upward = turn[:, 2, :].mean(axis=0)
    return upward / max(float(np.linalg.norm(upward)), 1e-12)


def arm_sigma(evidence: Evidence, fit: Fit) -> tuple[float, float]:
    """Sigmas (m) of an estimated lever arm: the larger one in plan, and along the vertical."""
    upward = _upward(evidence, fit)
    flat = np.eye(3) - np.outer(upward, upward)
    plan = flat @ fit.antenna_covariance @ flat
    return float(np.sqrt(np.linalg.eigvalsh(plan)[-1])), float(np.sqrt(upward @ fit.antenna_covariance @ upward))


def _arm_text(evidence: Evidence, fit: Fit, tuning: WorldTuning) -> str:
    plan, height = arm_sigma(evidence, fit)
    x, y, z = fit.antenna
    text = f"lever arm estimated: {x:.2f} {y:.2f} {z:.2f} m in the reference camera's frame, to {plan:.2f} m in plan"
    if evidence.level is not None or height > _arm_limit_m(tuning):
        text += (
            "; its height cannot be told from the height of the world (taken as that of the camera, to 1 m): "
            "measure the antenna's height above the cameras where heights matter"
        )
    return text + "; a receiver whose positions jump between the passes looks the same and cannot be told from it"


def _try_clock(
    evidence: Evidence, fit: Fit, fixes: Fixes, up: Up | None, notes: list[str], tuning: WorldTuning
) -> tuple[Evidence, Fit, tuple[float, float]]:
    """Estimate the offset of the receiver's clock if it is observable and differs from nothing; and what was found."""
    richer, other = _believed(replace(evidence, estimate_offset=True), fixes, up, fit.similarity, tuning)
    used = up_to_use(richer, up, [], tuning, other.similarity)
    plain = fit_similarity(replace(richer, estimate_offset=False), used, tuning.fit, near=fit.similarity)
    sigma, value = other.offset_sigma_s, other.offset_s
    speed = np.linalg.norm(evidence.speed[: len(fixes), :3, 3], axis=1) if evidence.speed is not None else np.zeros(1)
    metres = sigma * float(np.median(speed)) * fit.similarity.scale
    if not metres < _arm_limit_m(tuning):
        notes.append(
            f"the receiver's clock against the cameras' cannot be told (to {sigma:.2f} s, {metres:.2f} m on the way): "
            "at constant speed it is the lever arm along the track"
        )
    elif abs(value) > tuning.placing.clock_sigmas * sigma and plain.cost - other.cost > CLOCK_GAIN:
        notes.append(f"the receiver's clock is {value:+.3f} s (sigma {sigma:.3f}) off the cameras': taken into account")
        return richer, other, (value, sigma)
    else:
        notes.append(f"the receiver's clock agrees with the cameras' ({value:+.3f} s, sigma {sigma:.3f})")
    return evidence, fit, (value, sigma)


def up_to_use(
    evidence: Evidence, up: Up | None, notes: list[str], tuning: WorldTuning, near: Similarity | None = None
) -> Up | None:
    """The cameras' upward direction if the positions need it: a straight track leaves the roll about it open.

    ``near``: a similarity that is known to be about right saves looking for a start.
    """
    if up is None or np.isfinite(evidence.orientation).all(axis=(1, 2)).any():
        return None
    alone = fit_similarity(evidence, None, tuning.fit, near)
    if up.ring and alone.tilt_sigma_deg > tuning.placing.tilt_share * up.sigma_deg:
        known = known_to(alone.tilt_sigma_deg, RIGHT_ANGLE_DEG, f"{alone.tilt_sigma_deg:.1f} deg")
        notes.append(
            f"the positions leave the tilt open ({known}): the upward direction of {up.cameras} holds it, to about "
            f"{up.sigma_deg:.0f} deg; whether east and north, or one of them and the height, are exchanged cannot be "
            "told along so straight a track"
        )
    elif not up.ring and alone.roll_sigma_deg > tuning.placing.roll_limit_deg:
        known = known_to(alone.roll_sigma_deg, RIGHT_ANGLE_DEG, f"{alone.roll_sigma_deg:.0f} deg")
        notes.append(
            f"the positions lie nearly on a straight line (roll about it {known}): the upward direction of "
            f"{up.cameras} holds it, to about {up.sigma_deg:.0f} deg"
        )
    else:
        return None
    return up
