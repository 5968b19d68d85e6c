"""What a placement says of the receiver, beside its positions: how noisy, where its antenna is, how late its clock.

Lever arm and clock are estimated where the positions tell them; they change the fit that is believed.
"""

from dataclasses import dataclass, replace

import numpy as np

from tiegraph.geometry.align import Similarity
from tiegraph.geometry.gravity import Up
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.world import WorldTuning
from tiegraph.sfm.world.fit import Evidence, Fit, fit_similarity, leaning_deg
from tiegraph.sfm.world.fixes import Fixes
from tiegraph.sfm.world.positionerrors import factors
from tiegraph.sfm.world.unknowns import Clock
from tiegraph.text import known_to

RIGHT_ANGLE_DEG = 90.0  # an angle with a larger sigma is not known
ARM_GAIN, CLOCK_GAIN = 16.3, 10.8  # chi-square of 3 and of 1 degrees of freedom at 0.1 %
UNKNOWN = Clock(float("nan"), float("nan"))  # was not asked for


@dataclass(frozen=True)
class Fitted:
    """Evidence and its fit; the first rows of the evidence are the ``fixes``, ``up`` is what the cameras say of up."""

    evidence: Evidence
    fit: Fit
    fixes: Fixes
    up: Up | None


def believed(evidence: Evidence, fixes: Fixes, up: Up | None, near: Similarity, tuning: WorldTuning) -> Fitted:
    """The evidence with the fixes' sigmas stretched to what their residuals say, and its fit."""
    used = up_to_use(evidence, up, [], tuning, near)
    fit = fit_similarity(evidence, used, tuning.fit, near)
    count = len(fixes)
    for _ in range(tuning.similarity_fit.noise_rounds if count else 0):
        residual = evidence.position_residuals(fit.similarity, fit.arm.place, fit.clock.offset_s)[:count] / fixes.sigma
        stretched = fixes.stretched(factors(residual, fixes.level, fixes.time_s, tuning.noise))
        evidence = replace(evidence, sigma=np.concatenate([stretched.sigma, evidence.sigma[count:]]))
        fit = fit_similarity(evidence, used, tuning.fit, near=fit.similarity)
    return Fitted(evidence=evidence, fit=fit, fixes=fixes, up=up)


def _again(now: Fitted, evidence: Evidence, tuning: WorldTuning) -> Fitted:
    """The fit of other evidence from the same fixes, started where it is."""
    return believed(evidence, now.fixes, now.up, now.fit.similarity, tuning)


def _without(richer: Fitted, fewer: Evidence, near: Fit, tuning: WorldTuning) -> Fit:
    """The fit of the same evidence with an unknown ``fewer``."""
    used = up_to_use(richer.evidence, richer.up, [], tuning, richer.fit.similarity)
    return fit_similarity(fewer, used, tuning.fit, near=near.similarity)


def try_lever_arm(now: Fitted, notes: list[str], tuning: WorldTuning) -> Fitted:
    """Estimate the lever arm if the positions tell it in plan and agree clearly better with it."""
    richer = with_lever_arm(now, tuning)
    plain = _without(richer, richer.evidence.with_arm(estimate=False), now.fit, tuning)
    plan_sigma = arm_sigma(richer)[0]
    if plan_sigma < _arm_limit_m(tuning) and plain.cost - richer.fit.cost > ARM_GAIN:
        notes.append(arm_text(richer, tuning))
        return richer
    why = (
        f"it is known to {plan_sigma:.2f} m only: that needs headings that differ, such as a return pass"
        if plan_sigma >= _arm_limit_m(tuning)
        else "with one the positions fit no better"
    )
    notes.append(f"no lever arm given and none estimated ({why}): the antenna is taken to be at the reference camera")
    return now


def with_lever_arm(now: Fitted, tuning: WorldTuning) -> Fitted:
    """The fit with the lever arm as unknown, without its height where that cannot be told.

    It begins with the sigmas as stated: without the lever arm all positions looked bad, and among those that are bad
    for another reason hide.
    """
    stated = np.concatenate([now.fixes.sigma, now.evidence.sigma[len(now.fixes) :]])
    free = replace(now.evidence, sigma=stated).with_arm(estimate=True)
    richer = _again(now, free, tuning)
    if arm_sigma(richer)[1] > _arm_limit_m(tuning):
        return _again(now, replace(free, arm=replace(free.arm, level=_upward(richer))), tuning)
    return richer


def _arm_limit_m(tuning: WorldTuning) -> float:
    """Sigma up to which a lever arm counts as known."""
    return tuning.similarity_fit.arm_share * tuning.fit.antenna_sigma_m


def _upward(now: Fitted) -> np.ndarray:
    """Mean upward direction (3,) in the rig frame."""
    poses = now.evidence.pose[now.evidence.frame >= 0, :3, :3]
    turn = np.einsum("ij,kjl->kil", now.fit.similarity.rotation, poses)
    upward = turn[:, 2, :].mean(axis=0)
    return np.asarray(upward / max(float(np.linalg.norm(upward)), 1e-12))


def arm_sigma(now: Fitted) -> tuple[float, float]:
    """Sigmas (m) of an estimated lever arm: the larger one in plan, and along the vertical."""
    upward, covariance = _upward(now), now.fit.arm.covariance
    flat = np.eye(3) - np.outer(upward, upward)
    plan = flat @ covariance @ flat
    return float(np.sqrt(np.linalg.eigvalsh(plan)[-1])), float(np.sqrt(upward @ covariance @ upward))


def arm_text(now: Fitted, tuning: WorldTuning) -> str:
    """The lever arm that was estimated, in words."""
    plan, height = arm_sigma(now)
    x, y, z = now.fit.arm.place
    text = f"lever arm estimated: {x:.2f} {y:.2f} {z:.2f} m in the reference camera's frame, to {plan:.2f} m in plan"
    if now.evidence.arm.level is not None or height > _arm_limit_m(tuning):
        text += (
            "; its height cannot be told from the height of the world (taken as that of the camera, to 1 m): "
            "measure the antenna's height above the cameras where heights matter"
        )
    return text + "; a receiver whose positions jump between the passes looks the same and cannot be told from it"


def try_clock(now: Fitted, notes: list[str], tuning: WorldTuning) -> tuple[Fitted, Clock]:
    """Estimate the offset of the receiver's clock if it is observable and differs from nothing; and what was found."""
    richer = _again(now, replace(now.evidence, estimate_offset=True), tuning)
    plain = _without(richer, replace(richer.evidence, estimate_offset=False), now.fit, tuning)
    sigma, value = richer.fit.clock.sigma_s, richer.fit.clock.offset_s
    motion = now.evidence.speed
    speed = np.linalg.norm(motion[: len(now.fixes), :3, 3], axis=1) if motion is not None else np.zeros(1)
    metres = sigma * float(np.median(speed)) * now.fit.similarity.scale
    if not metres < _arm_limit_m(tuning):
        notes.append(
            f"the receiver's clock against the cameras' cannot be told (to {sigma:.2f} s, {metres:.2f} m on the way): "
            "at constant speed it is the lever arm along the track"
        )
    elif abs(value) > tuning.similarity_fit.clock_sigmas * sigma and plain.cost - richer.fit.cost > CLOCK_GAIN:
        notes.append(f"the receiver's clock is {value:+.3f} s (sigma {sigma:.3f}) off the cameras': taken into account")
        return richer, richer.fit.clock
    else:
        notes.append(f"the receiver's clock agrees with the cameras' ({value:+.3f} s, sigma {sigma:.3f})")
    return now, richer.fit.clock


def with_clock(tuning: WorldTuning, scene: Scene) -> WorldTuning:
    """Times are right to a step between frames at worst: beyond, positions would belong to other frames."""
    steps = np.diff(scene.time_s)[np.diff(scene.sequence) == 0]
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf
    fit = tuning.fit.model_copy(update={"offset_sigma_s": min(step, tuning.fit.offset_sigma_s)})
    return tuning.model_copy(update={"fit": fit})


def up_to_use(
    evidence: Evidence, up: Up | None, notes: list[str], tuning: WorldTuning, alone: Fit | Similarity | None = None
) -> Up | None:
    """The cameras' upward direction if the positions need it (a straight track leaves the roll about it open) and do
    not refute it: photographs straight down have tops that point anywhere.

    ``alone``: the fit without it, or a similarity that is known to be about right.
    """
    if up is None or np.isfinite(evidence.orientation).all(axis=(1, 2)).any():
        return None
    if not isinstance(alone, Fit):
        alone = fit_similarity(evidence, None, tuning.fit, alone)
    tilt = alone.sigma["tilt_deg"] if up.tilt else alone.roll_sigma_deg
    known = known_to(tilt, RIGHT_ANGLE_DEG, f"{tilt:.1f} deg")
    off = leaning_deg(evidence, alone.similarity, up)
    if off > LIMIT * np.hypot(tilt, up.sigma_deg):
        notes.append(
            f"the positions tell what is level ({known}): the upward direction of {up.cameras} is {off:.0f} deg off "
            "and not used"
        )
        return None
    if up.tilt and tilt > tuning.similarity_fit.tilt_share * up.sigma_deg:
        notes.append(
            f"the positions leave the tilt open ({known}): the upward direction of {up.cameras} holds it, to about "
            f"{up.sigma_deg:.0f} deg; whether east and north, or one of them and the height, are exchanged cannot be "
            "told along so straight a track"
        )
    elif not up.tilt and tilt > tuning.similarity_fit.roll_limit_deg:
        notes.append(
            f"the positions lie nearly on a straight line (roll about it {known}): the upward direction of "
            f"{up.cameras} holds it, to about {up.sigma_deg:.0f} deg"
        )
    else:
        return None
    return up
