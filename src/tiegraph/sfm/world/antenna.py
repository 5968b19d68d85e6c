"""What a georeference determines of the receiver beside its positions: their noise, its antenna, its clock offset.

Lever arm and clock offset are unknowns with priors; values that the positions hardly determine stay as given
(``positionerrors``).
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

RIGHT_ANGLE_DEG = 90.0  # an angle with a larger sigma is unknown


@dataclass(frozen=True)
class Fitted:
    """Evidence and its fit; the first rows of the evidence are the ``fixes``, ``up`` is the upward direction of the
    cameras."""

    evidence: Evidence
    fit: Fit
    fixes: Fixes
    up: Up | None


def believed(evidence: Evidence, fixes: Fixes, up: Up | None, near: Similarity, tuning: WorldTuning) -> Fitted:
    """The evidence with the fixes' sigmas scaled to their residuals, and its fit."""
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
    """The lever arm determined from the positions, in words."""
    plan, height = arm_sigma(fit, evidence)
    open_m = HARDLY * tuning.fit.antenna_sigma_m
    if not told(fit, evidence):
        return (
            f"no lever arm is given and none could be estimated (sigma {plan:.2f} m; an estimate needs different "
            "headings, such as a return pass): the antenna is assumed to be at the reference camera"
        )
    x, y, z = fit.arm.place
    text = f"lever arm estimated: {x:.2f} {y:.2f} {z:.2f} m in the reference camera's frame, to {plan:.2f} m in plan"
    if height > open_m:
        text += (
            "; its height cannot be separated from the height of the world (it is assumed to be that of the camera, "
            "to within 1 m): measure the antenna's height above the cameras where heights matter"
        )
    return text + "; a receiver whose positions jump between the passes has the same effect"


def told(fit: Fit, evidence: Evidence) -> bool:
    """Whether the positions determine the lever arm: then it moved from its prior value."""
    return bool(np.any(fit.arm.place != evidence.arm.place))


def clock_text(fit: Fit, evidence: Evidence) -> str:
    """The receiver's clock offset determined from the positions, in words."""
    sigma, value = fit.clock.sigma_s, fit.clock.offset_s
    if not value:
        speed = np.zeros(1) if evidence.speed is None else np.linalg.norm(evidence.speed[:, :3, 3], axis=1)
        metres = sigma * float(np.median(speed)) * fit.similarity.scale
        return (
            f"the receiver's clock offset from the cameras cannot be determined (sigma {sigma:.2f} s, {metres:.2f} m "
            "along the path): at constant speed it acts like a lever arm along the track"
        )
    if abs(value) > LIMIT * sigma:
        return f"the receiver's clock is {value:+.3f} s (sigma {sigma:.3f}) off the cameras': taken into account"
    return f"the receiver's clock agrees with the cameras' ({value:+.3f} s, sigma {sigma:.3f})"


def with_clock(tuning: WorldTuning, scene: Scene) -> WorldTuning:
    """Limit the clock offset to one step between frames: beyond it, positions would belong to other frames."""
    steps = np.diff(scene.time_s)[np.diff(scene.sequence) == 0]
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf
    fit = tuning.fit.model_copy(update={"offset_sigma_s": min(step, tuning.fit.offset_sigma_s)})
    return tuning.model_copy(update={"fit": fit})


def _as_good(upright: Fit, alone: Fit, tuning: StatementTuning) -> bool:
    """Whether as many positions agree with the one fit as with the other, within their possible errors."""
    few = upright.inlier.sum() < tuning.agreeing * alone.inlier.sum()
    return not few and _worst(upright) <= tuning.scatter * max(1.0, _worst(alone))


def _worst(fit: Fit) -> float:
    """Ratio of the errors of the positions to their stated sigmas, for the level where it is largest."""
    return max((factor for _, factor, _ in fit.levels), default=1.0)


def up_to_use(
    evidence: Evidence,
    up: Up | None,
    notes: list[str],
    tuning: WorldTuning,
    alone: Fit | Similarity | None = None,
    upright: Fit | None = None,
) -> Up | None:
    """The cameras' upward direction if the positions need it (a straight track leaves the roll about it undetermined)
    and do not refute it: photographs straight down have tops in any direction.

    ``alone``: the fit without it, or an approximately correct similarity; ``upright``: the best fit with it. For two
    passes a few metres apart, errors of metres turn one over the other, and then the sigma of the rotation is small.
    So the direction is refuted only if the positions would have larger errors with it than they can have.
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
            f"with the positions alone the model would lean by {off:.0f} deg; the upward direction of {up.cameras} is "
            f"used, with a sigma of about {up.sigma_deg:.0f} deg, because the positions agree with it to within "
            f"{_worst(upright):.1f} times their sigmas"
        )
        return up
    if apart:
        notes.append(
            f"the positions determine the tilt ({known}): the upward direction of {up.cameras} is {off:.0f} deg off "
            "and is not used"
        )
        return None
    if up.tilt and tilt > tuning.similarity_fit.tilt_share * up.sigma_deg:
        notes.append(
            f"the positions do not determine the tilt ({known}): the upward direction of {up.cameras} does, with a "
            f"sigma of about {up.sigma_deg:.0f} deg; along so straight a track an exchange of east and north, or of "
            "one of them and the height, cannot be detected"
        )
    elif not up.tilt and tilt > tuning.similarity_fit.roll_limit_deg:
        notes.append(
            f"the positions are nearly on a straight line (roll about it {known}): the upward direction of "
            f"{up.cameras} determines the roll, with a sigma of about {up.sigma_deg:.0f} deg"
        )
    else:
        return None
    return up
