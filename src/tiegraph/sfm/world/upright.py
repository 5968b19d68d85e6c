"""Which way is up in the world: whether positions determine it or the cameras do, and whether positions are mirrored.

A mirror image (two coordinates exchanged) shows in the residuals of a track that bends; a straight or level one it
turns over, which only the cameras show.
"""

from dataclasses import replace

import numpy as np

from tiegraph.geometry.gravity import STEEP_DEG, Up
from tiegraph.geometry.transforms import Similarity, rms_length
from tiegraph.scene.evidence import LIMIT, RARELY, fits_better
from tiegraph.sfm.tuning.world import StatementTuning, WorldTuning
from tiegraph.sfm.world.fit import ANTENNA, Evidence, Fit, fit_similarity, leaning_deg
from tiegraph.sfm.world.fixes import Fixes, Measured
from tiegraph.sfm.world.positionerrors import factors
from tiegraph.text import known_to

RIGHT_ANGLE_DEG = 90.0  # an angle with a larger sigma is unknown


def believed(
    evidence: Evidence, fixes: Fixes, up: Up | None, near: Similarity, tuning: WorldTuning
) -> tuple[Evidence, Fit]:
    """The evidence with the sigmas of the fixes, its first rows, scaled to their residuals; and its fit."""
    used, count = up_to_use(evidence, up, tuning, near)[0], len(fixes)
    fit = fit_similarity(evidence, used, tuning.fit, near)
    for _ in range(3 if count else 0):  # rounds in which sigmas follow the residuals
        factor = factors(fit.residuals(evidence)[:count] / fixes.sigma, fixes.level, tuning.noise)
        evidence = replace(evidence, sigma=np.concatenate([fixes.sigma * factor[:, None], evidence.sigma[count:]]))
        fit = fit_similarity(evidence, used, tuning.fit, fit.similarity)
    return evidence, fit


def up_to_use(
    evidence: Evidence,
    up: Up | None,
    tuning: WorldTuning,
    alone: Fit | Similarity | None = None,
    upright: Fit | None = None,
) -> tuple[Up | None, str]:
    """The cameras' upward direction if the positions need it (a straight track leaves the roll about it undetermined)
    and do not refute it: photographs straight down have tops in any direction; and a note on that.

    ``alone``: the fit without it, or an approximately correct similarity; ``upright``: the best fit with it. For two
    passes a few metres apart, errors of metres turn one over the other, and then the sigma of the rotation is small.
    So the direction is refuted only if the positions would have larger errors with it than they can have.
    """
    if up is None or evidence.oriented.any():
        return None, ""
    if not isinstance(alone, Fit):
        alone = fit_similarity(evidence, None, tuning.fit, alone)
    tilt = alone.sigma["tilt_deg"] if up.tilt else alone.roll_sigma_deg
    known = known_to(tilt, RIGHT_ANGLE_DEG, f"{tilt:.1f} deg")
    off = leaning_deg(evidence, alone.similarity, up)
    if off > LIMIT * np.hypot(tilt, up.sigma_deg):
        stands = upright is not None and leaning_deg(evidence, upright.similarity, up) < LIMIT * up.sigma_deg
        if upright is not None and stands and _as_good(upright, alone, tuning.statements):
            return up, (
                f"with the positions alone the model would lean by {off:.0f} deg; the upward direction of {up.cameras} "
                f"is used, with a sigma of about {up.sigma_deg:.0f} deg, because the positions agree with it to within "
                f"{_worst(upright):.1f} times their sigmas"
            )
        return None, (
            f"the positions determine the tilt ({known}): the upward direction of {up.cameras} is {off:.0f} deg off "
            "and is not used"
        )
    if up.tilt and tilt > up.sigma_deg:
        return up, (
            f"the positions do not determine the tilt ({known}): the upward direction of {up.cameras} does, with a "
            f"sigma of about {up.sigma_deg:.0f} deg; along so straight a track an exchange of east and north, or of "
            "one of them and the height, cannot be detected"
        )
    if not up.tilt and tilt > tuning.up.lone_sigma_deg:
        return up, (
            f"the positions are nearly on a straight line (roll about it {known}): the upward direction of "
            f"{up.cameras} determines the roll, with a sigma of about {up.sigma_deg:.0f} deg"
        )
    return None, ""


def _as_good(upright: Fit, alone: Fit, tuning: StatementTuning) -> bool:
    """Whether as many positions agree with the one fit as with the other, within their possible errors."""
    few = upright.inlier.sum() < tuning.agreeing * alone.inlier.sum()
    return not few and _worst(upright) <= tuning.scatter * max(1.0, _worst(alone))


def _worst(fit: Fit) -> float:
    """Ratio of the errors of the positions to their stated sigmas, for the level where it is largest."""
    return max((factor for _, factor, _ in fit.levels), default=1.0)


def mirrored(measured: Measured, evidence: Evidence, fixes: Fixes, fit: Fit) -> str:
    """A message if the positions fit clearly better with east and north exchanged, which makes a mirror image; else
    "".

    From the errors in plan (``fits_better``), over the inliers of both readings. A straight track is its own mirror
    image, so there is no message for it.
    """
    tuning = measured.tuning
    if np.median(np.linalg.norm(fit.residuals(evidence), axis=1)) < tuning.fit.antenna_sigma_m:
        return ""
    rows, errors, _ = _exchanged(evidence, fixes, fit, tuning)
    first, second = (rms_length(r[:, :2]) for r in errors)
    free = 2 * tuning.noise.min_rows - 4  # a similarity in plan has four unknowns
    if not fits_better(first, second, free) or not _whole(measured, evidence.frame[rows]):
        return ""
    return (
        f"the positions are a mirror image of the model: they miss it by {first:.2f} m in plan, with their first two "
        f"coordinates exchanged by {second:.2f} m, {RARELY}: are latitude and longitude, or north and east, exchanged "
        "in the GNSS file? The positions are not used"
    )


def _exchanged(
    evidence: Evidence, fixes: Fixes, fit: Fit, tuning: WorldTuning
) -> tuple[np.ndarray, list[np.ndarray], Similarity]:
    """The inliers of both readings of the positions, (K,) bool; their residuals as given and with their first two
    coordinates exchanged; the similarity of the model if they are exchanged."""
    stated, turn = np.concatenate([fixes.sigma, evidence.sigma[len(fixes) :]]), [1, 0, 2]
    turned = replace(evidence, position=evidence.position[:, turn], sigma=stated[:, turn])
    start = fit_similarity(turned, None, tuning.fit).similarity
    turned, other = believed(turned, replace(fixes, sigma=fixes.sigma[:, turn]), None, start, tuning)
    rows = fit.inlier | other.inlier
    return rows, [fit.residuals(evidence)[rows], other.residuals(turned)[rows]], other.similarity


def looking_up(measured: Measured, evidence: Evidence, fixes: Fixes, fit: Fit) -> str:
    """A message if cameras look up with a receiver's positions as given, but look down with an equally good fit if
    two columns are exchanged: a flight at constant height is its own mirror image turned over."""
    tuning, scene = measured.tuning, measured.scene
    axes = measured.images[scene.of_role("side"), 2, :3]
    axes = axes[np.isfinite(axes).all(axis=1)]

    def up_deg(placed: Similarity) -> float:
        return float(np.degrees(np.arcsin(np.clip(np.mean(axes @ placed.rotation[2]), -1, 1))))

    if scene.prior not in ("gnss", "exif") or evidence.oriented.any() or not len(axes):
        return ""
    if not _whole(measured, evidence.frame) or up_deg(fit.similarity) - LIMIT * fit.sigma["tilt_deg"] < STEEP_DEG:
        return ""
    _, errors, other = _exchanged(evidence, fixes, fit, tuning)
    first, second = (rms_length(r) for r in errors)
    if up_deg(other) > -STEEP_DEG or fits_better(second, first, 3 * tuning.noise.min_rows - 7):
        return ""
    return (
        f"with these positions the cameras look up, by {up_deg(fit.similarity):.0f} deg on average (sigma "
        f"{fit.sigma['tilt_deg']:.1f} deg); with their first two coordinates exchanged the positions fit as well "
        f"({first:.2f} and {second:.2f} m), and the cameras look down: if they did, latitude and longitude, or north "
        "and east, are exchanged in the GNSS file (a mirror image)"
    )


def upside_down(measured: Measured, evidence: Evidence, fixes: Fixes, up: Up | None) -> str:
    """A message if the positions alone turn a ring of cameras upside down: the mirror image of a track.

    Two passes side by side and mirrored are the same passes turned over, so the residuals of a fit do not show it.
    """
    if up is None or not up.ring or not len(fixes) or not _whole(measured, fixes.home):
        return ""
    tuning, first = measured.tuning, np.arange(len(evidence.frame)) < len(fixes)
    free = replace(evidence.alone(first, evidence.free | {ANTENNA}), sigma=fixes.sigma)
    alone = believed(free, fixes, None, fit_similarity(free, None, tuning.fit).similarity, tuning)[1]
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


def _whole(measured: Measured, frames: np.ndarray) -> bool:
    """Whether a model covers most of its survey with enough points, from the frames (K,) with the positions used: a
    torn or weak model may be a mirror image itself."""
    tuning = measured.tuning
    asked = int(np.isfinite(measured.scene.world_from_rig[:, :3, 3]).all(axis=1).sum())
    speak = len(np.unique(frames[frames >= 0])) if asked else len(frames)
    return min(speak, measured.given.firm_frames) >= max(tuning.noise.min_rows, tuning.statements.agreeing * asked)
