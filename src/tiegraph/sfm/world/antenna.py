"""What a placement says of the receiver, beside its positions: how noisy, where its antenna is, how late its clock.

Lever arm and clock are unknowns of the placement with what is believed of them beforehand; those that the positions
hardly tell stay as given (``positionerrors``).
"""

from dataclasses import dataclass, replace

import numpy as np

from tiegraph.geometry.align import Similarity
from tiegraph.geometry.gravity import Up
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.world import StatementTuning, WorldTuning
from tiegraph.sfm.world.fit import Evidence, Fit, fit_similarity, leaning_deg
from tiegraph.sfm.world.fixes import Fixes
from tiegraph.sfm.world.positionerrors import HARDLY, factors
from tiegraph.text import known_to

RIGHT_ANGLE_DEG = 90.0  # an angle with a larger sigma is not known


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


def _upward(fit: Fit, evidence: Evidence) -> np.ndarray:
    """Mean upward direction (3,) in the rig frame."""
    turn = np.einsum("ij,kjl->kil", fit.similarity.rotation, evidence.pose[evidence.frame >= 0, :3, :3])
    upward = turn[:, 2, :].mean(axis=0)
    return np.asarray(upward / max(float(np.linalg.norm(upward)), 1e-12))


def arm_sigma(fit: Fit, evidence: Evidence) -> tuple[float, float]:
    """Sigmas (m) of a lever arm: the larger one in plan, and along the vertical."""
    upward, covariance = _upward(fit, evidence), fit.arm.covariance
    flat = np.eye(3) - np.outer(upward, upward)
    plan = flat @ covariance @ flat
    return float(np.sqrt(np.linalg.eigvalsh(plan)[-1])), float(np.sqrt(upward @ covariance @ upward))


def arm_text(fit: Fit, evidence: Evidence, tuning: WorldTuning) -> str:
    """What the positions tell of the lever arm, in words."""
    plan, height = arm_sigma(fit, evidence)
    open_m = HARDLY * tuning.fit.antenna_sigma_m
    if not told(fit, evidence):
        return (
            f"no lever arm given and none estimated (it is known to {plan:.2f} m only: that needs headings that "
            "differ, such as a return pass): the antenna is taken to be at the reference camera"
        )
    x, y, z = fit.arm.place
    text = f"lever arm estimated: {x:.2f} {y:.2f} {z:.2f} m in the reference camera's frame, to {plan:.2f} m in plan"
    if height > open_m:
        text += (
            "; its height cannot be told from the height of the world (taken as that of the camera, to 1 m): "
            "measure the antenna's height above the cameras where heights matter"
        )
    return text + "; a receiver whose positions jump between the passes looks the same and cannot be told from it"


def told(fit: Fit, evidence: Evidence) -> bool:
    """Whether the positions tell the lever arm: it moved from what is given; what is not told stays."""
    return bool(np.any(fit.arm.place != evidence.arm.place))


def clock_text(fit: Fit, evidence: Evidence) -> str:
    """What the positions tell of the receiver's clock, in words."""
    sigma, value = fit.clock.sigma_s, fit.clock.offset_s
    if not value:
        speed = np.zeros(1) if evidence.speed is None else np.linalg.norm(evidence.speed[:, :3, 3], axis=1)
        metres = sigma * float(np.median(speed)) * fit.similarity.scale
        return (
            f"the receiver's clock against the cameras' cannot be told (to {sigma:.2f} s, {metres:.2f} m on the way): "
            "at constant speed it is the lever arm along the track"
        )
    if abs(value) > LIMIT * sigma:
        return f"the receiver's clock is {value:+.3f} s (sigma {sigma:.3f}) off the cameras': taken into account"
    return f"the receiver's clock agrees with the cameras' ({value:+.3f} s, sigma {sigma:.3f})"


def with_clock(tuning: WorldTuning, scene: Scene) -> WorldTuning:
    """Times are right to a step between frames at worst: beyond, positions would belong to other frames."""
    steps = np.diff(scene.time_s)[np.diff(scene.sequence) == 0]
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf
    fit = tuning.fit.model_copy(update={"offset_sigma_s": min(step, tuning.fit.offset_sigma_s)})
    return tuning.model_copy(update={"fit": fit})


def _as_good(upright: Fit, alone: Fit, tuning: StatementTuning) -> bool:
    """Whether as many positions agree with the one fit as with the other, with errors that they may have."""
    few = upright.inlier.sum() < tuning.agreeing * alone.inlier.sum()
    return not few and _worst(upright) <= tuning.scatter * max(1.0, _worst(alone))


def _worst(fit: Fit) -> float:
    """Errors of the positions over what is stated of them, of the level where they are largest."""
    return max((factor for _, factor, _ in fit.levels), default=1.0)


def up_to_use(
    evidence: Evidence,
    up: Up | None,
    notes: list[str],
    tuning: WorldTuning,
    alone: Fit | Similarity | None = None,
    upright: Fit | None = None,
) -> Up | None:
    """The cameras' upward direction if the positions need it (a straight track leaves the roll about it open) and do
    not refute it: photographs straight down have tops that point anywhere.

    ``alone``: the fit without it, or a similarity that is known to be about right; ``upright``: the best fit with it.
    Of two passes a few metres apart metres of error turn one over the other, and where they have done so the sigma of
    the turn is small: so it is refuted only where positions would be off by more with it than they may be.
    """
    if up is None or np.isfinite(evidence.orientation).all(axis=(1, 2)).any():
        return None
    if not isinstance(alone, Fit):
        alone = fit_similarity(evidence, None, tuning.fit, alone)
    tilt = alone.sigma["tilt_deg"] if up.tilt else alone.roll_sigma_deg
    known = known_to(tilt, RIGHT_ANGLE_DEG, f"{tilt:.1f} deg")
    off = leaning_deg(evidence, alone.similarity, up)
    apart = off > LIMIT * np.hypot(tilt, up.sigma_deg)
    stands = upright is not None and leaning_deg(evidence, upright.similarity, up) < LIMIT * up.sigma_deg
    if apart and upright is not None and stands and _as_good(upright, alone, tuning.statements):
        notes.append(
            f"the positions alone would have the model lean by {off:.0f} deg; the upward direction of {up.cameras} "
            f"holds it, to about {up.sigma_deg:.0f} deg, for which they need be off by no more than "
            f"{_worst(upright):.1f} times their sigmas"
        )
        return up
    if apart:
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
