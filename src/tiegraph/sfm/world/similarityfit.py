"""Placing a model: the available evidence, the part that is used, and the fit to it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tiegraph.geometry.geodesy import datum_sigma_m
from tiegraph.geometry.gravity import Up
from tiegraph.geometry.transforms import LEAST_PLACES, Similarity, umeyama
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning.world import FixTuning, WorldTuning
from tiegraph.sfm.world.fit import ANTENNA, CLOCK, Evidence, Fit, by_errors, fit_similarity
from tiegraph.sfm.world.fixes import Fixes, Measured, make_fixes
from tiegraph.sfm.world.positionerrors import HARDLY, MEDIAN_CHI2_3, Stated, factors
from tiegraph.sfm.world.upright import believed, looking_up, mirrored, up_to_use, upside_down
from tiegraph.sfm.world.weighing import UNKNOWN, Weighed, weigh


@dataclass(frozen=True)
class SimilarityFit:
    """The evidence and result of a georeference; rows of ``evidence`` are the fixes, then the control points."""

    measured: Measured
    evidence: Evidence  # sigmas as used
    fixes: Fixes  # sigmas as stated, with doubt about outages and bridges
    fit: Fit
    up: Up | None  # used to determine the tilt
    rows: Stated  # the fixes as stated
    weighed: Weighed
    notes: tuple[str, ...] = ()
    doubt: str = ""  # a possible error that remains

    @property
    def tuning(self) -> WorldTuning:
        """Those it was made with."""
        return self.measured.tuning

    def residuals(self) -> np.ndarray:
        """(K, 3) metres, of the fixes."""
        return self.fit.residuals(self.evidence)[: len(self.fixes)]

    def held_out(self, bends: bool) -> np.ndarray | None:
        """(K, 3) metres, residuals of the fixes in the fit without the held-out ones, with or without its estimate of
        the model's shape; None without held-out fixes, or with too few others."""
        count, evidence = len(self.fixes), self.evidence
        evidence = evidence if bends else replace(evidence, modes=evidence.modes[:, :, :0])
        held = np.append(self.fixes.held, np.zeros(len(evidence.frame) - count, bool))
        seen = self.fit.inlier & ~held
        if not held.any() or seen.sum() < LEAST_PLACES:
            return None
        blind = by_errors(evidence, self.up, replace(self.fit, inlier=seen), self.rows, self.tuning)
        assert blind.bent is not None
        turn = blind.similarity.scale * blind.similarity.rotation
        return (blind.residuals(evidence) + evidence.modes @ blind.bent[0] @ turn.T)[:count]

    def of_bent(self, poses: np.ndarray, targets: np.ndarray, bent: np.ndarray) -> SimilarityFit:
        """The same for a model that was placed by its similarity and then bent: ``poses`` (F, 4, 4) of the scene's
        frames, places (C, 3) of the control points used, coefficients (M,) of the modes of its shape."""
        there, evidence, fixes, count = self.fit.similarity, self.evidence, self.fixes, len(self.fixes)
        pose, speed = fixes.blend(poses)
        points = evidence.pose[count:].copy()
        before = there(points[:, :3, 3])
        points[:, :3, 3] = np.where(np.isfinite(targets), targets, before)  # rays that no longer meet
        length, up = evidence.log_scale, self.up
        evidence = replace(
            evidence,
            pose=np.concatenate([pose, points]),
            speed=np.concatenate([speed, np.zeros_like(points)]),
            modes=np.einsum("ij,kjm->kim", there.scale * there.rotation, evidence.modes),
            log_scale=length and (length[0] - np.log(there.scale), length[1]),
        )
        up = up and replace(up, direction=there.rotation @ up.direction)
        start = replace(self.fit, similarity=Similarity())
        off = start.residuals(evidence)[:count]
        factor = factors(off / fixes.sigma, fixes.level, self.tuning.noise)
        times = np.linalg.norm(off / (fixes.sigma * factor[:, None]), axis=1)
        inlier = np.append(times < LIMIT * np.sqrt(3), self.fit.inlier[count:])
        fit = by_errors(evidence, up, replace(start, inlier=inlier), self.rows, self.tuning, bent)
        return replace(self, evidence=evidence, up=up, fit=fit)


@dataclass(frozen=True)
class NotPlaced:
    """Why a model is not placed, and whether that contradicts it."""

    why: str
    contradicts: bool = False


def fit_to_world(measured: Measured) -> SimilarityFit | NotPlaced:
    """Fit the model to all measurements in the world, if there are enough and the model is not mirrored."""
    scene, given, settings = measured.scene, measured.given, measured.settings
    measured = replace(measured, tuning=_with_clock(measured.tuning, scene))
    tuning, up = measured.tuning, measured.up
    registered = np.all(np.isfinite(measured.frames(measured.metres_per_unit)), axis=(1, 2))
    stated, points = make_fixes(scene, registered, given, tuning.fixes), len(measured.points)
    frames = len(np.unique(stated.home))
    places = len(np.unique(stated.position, axis=0))  # EXIF may give one position for a whole object
    if min(frames, places) + points < LEAST_PLACES:
        few = f"{frames} registered frames have a prior position"
        few += f" ({places} different ones)" if places < frames else ""
        few += f" and {points} control points can be used" if given.control is not None else ""
        return NotPlaced(f"{few}, {LEAST_PLACES} are needed")
    arm, estimate, note = _lever_arm(scene, settings)
    rough, weighed, near = _selected(measured, stated, arm, estimate)
    fixes = stated.widened(measured.frames(near.scale), near.scale).blurred(weighed.extra_m)
    moving = given.rows is not None and settings.antenna != "ignored"
    rough = replace(rough, free=frozenset([ANTENNA] * (estimate is not False) + [CLOCK] * moving))
    evidence, fit = believed(rough, fixes, up, near, tuning)
    if against := mirrored(measured, evidence, fixes, fit) or upside_down(measured, evidence, fixes, up):
        return NotPlaced(against, contradicts=True)
    rows = _stated(fixes, scene, weighed.extra_m, tuning.fixes)
    first, fit = fit, by_errors(evidence, None, fit, rows, tuning)
    if estimate is None and not moving and not _significant(fit, evidence):  # positions of the cameras by name
        evidence, first = believed(replace(rough, free=frozenset()), fixes, up, first.similarity, tuning)
        fit = by_errors(evidence, None, first, rows, tuning)
    notes = [note]
    if up is not None:
        upright = by_errors(evidence, up, fit_similarity(evidence, up, tuning.fit), rows, tuning)
        up, note = up_to_use(evidence, up, tuning, fit, upright)
        fit, notes = fit if up is None else upright, [*notes, note]
    if not 0 < fit.sigma["scale"] < UNKNOWN:
        return NotPlaced(
            f"{fit.inlier.sum()} of {len(fit.inlier)} positions agree with it, and do not determine its size"
        )
    notes += [_arm_text(fit, evidence, tuning)] if ANTENNA in evidence.free else []
    notes += [_clock_text(fit, evidence)] if moving else []
    return SimilarityFit(
        measured=measured,
        evidence=evidence,
        fixes=fixes,
        fit=fit,
        up=up,
        rows=rows,
        weighed=weighed,
        notes=tuple(n for n in notes if n),
        doubt=looking_up(measured, evidence, fixes, first),
    )


def _with_clock(tuning: WorldTuning, scene: Scene) -> WorldTuning:
    """Limit the clock offset to one step between frames: beyond it, positions would belong to other frames."""
    steps = np.diff(scene.time_s)[np.diff(scene.sequence) == 0]
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf
    fit = tuning.fit.model_copy(update={"offset_sigma_s": min(step, tuning.fit.offset_sigma_s)})
    return tuning.model_copy(update={"fit": fit})


def _lever_arm(scene: Scene, settings: GeorefSettings) -> tuple[np.ndarray, bool | None, str]:
    """The given lever arm (3,) (zeros: none), whether to estimate it (None: if the positions determine it), a note."""
    none = np.zeros(3)
    if scene.prior in ("trajectory", "exif", "none") or settings.antenna == "ignored":
        return none, False, ""
    given = next((np.array(r.antenna_m) for r in scene.rigs if r.antenna_m is not None), None)
    if settings.antenna == "estimated":
        return none if given is None else given, True, ""
    if given is not None:
        return given, False, ""
    if settings.antenna == "given":
        note = (
            "georef.antenna = 'given', but the rig file gives no antenna: positions are taken as those of the cameras"
        )
        return none, False, note
    return none, None, ""


def _significant(fit: Fit, evidence: Evidence) -> bool:
    """Whether the antenna certainly differs from its given place."""
    off = fit.antenna - evidence.antenna
    return bool(off @ np.linalg.pinv(fit.antenna_covariance, hermitian=True) @ off > LIMIT**2)


def _stated(fixes: Fixes, scene: Scene, extra_m: np.ndarray, tuning: FixTuning) -> Stated:
    """The fixes as stated, with (3,) ``extra_m`` added where another source contradicts them, and their common error:
    part of a receiver's stated error is constant (base station, atmosphere), and so is the error of the datum."""
    common = np.full(3, np.nan)
    if scene.prior in ("gnss", "exif") and len(fixes):
        datum = 0.0 if scene.origin is None else datum_sigma_m(scene.origin.crs)
        common = np.hypot(tuning.lasting * np.median(fixes.stated, axis=0), datum * np.array([0.5, 0.5, 0.0]) ** 0.5)
    sigma = np.hypot(np.maximum(fixes.stated, 1e-3), extra_m)
    return Stated(sigma=sigma, level=fixes.level, time_s=fixes.time_s, common=common)


def _selected(
    measured: Measured, stated: Fixes, arm: np.ndarray, estimate: bool | None
) -> tuple[Evidence, Weighed, Similarity]:
    """The selection of the measurements, and the first fit to them.

    Selected once, fitted twice: the second time with the true scale for frames known through another camera than the
    first.
    """
    tuning, fixes, metres, weighed = measured.tuning, stated, measured.metres_per_unit, None
    for _ in range(2):
        evidence = _of_points(_of_fixes(measured, fixes, arm, metres), measured, metres)
        evidence = replace(evidence, free=frozenset([ANTENNA] if estimate else []))
        if weighed is None:
            rows = _stated(stated, measured.scene, np.zeros(3), tuning.fixes)
            weighed = weigh(measured, evidence, stated, rows, estimate is not False)
        fixes = fixes.blurred(weighed.extra_m)
        sigma = np.concatenate([fixes.sigma, evidence.sigma[len(fixes) :]])
        evidence = replace(evidence, sigma=sigma, log_scale=evidence.log_scale if weighed.lengths_used else None)
        used = up_to_use(evidence, measured.up, tuning)[0]
        near = fit_similarity(evidence, used, tuning.fit).similarity
        metres = near.scale
        fixes = stated.widened(measured.frames(metres), metres)
    assert weighed is not None
    return evidence, weighed, near


def _of_fixes(measured: Measured, fixes: Fixes, arm: np.ndarray, metres: float) -> Evidence:
    """The evidence of positions alone."""
    pose, speed = fixes.blend(measured.frames(metres))
    orientation = measured.scene.world_from_rig[fixes.home, :3, :3].copy()
    orientation[~fixes.at_frame] = np.nan
    scale = measured.length_scale
    return Evidence(
        frame=fixes.home,
        pose=pose,
        speed=speed,
        position=fixes.position,
        sigma=fixes.sigma,
        orientation=orientation,
        modes=np.einsum("kn,knim->kim", fixes.weights, measured.modes[fixes.frames]),
        antenna=arm,
        log_scale=None if scale is None else (float(np.log(scale.metres_per_unit)), scale.sigma),
    )


def _of_points(evidence: Evidence, measured: Measured, metres: float) -> Evidence:
    """The evidence with control points added: rows without rotation, so that no lever arm acts."""
    points, control = measured.points, measured.given.control
    if not len(points) or control is None:
        return evidence
    found, pose = [measured.targets[k] for k in points], np.zeros((len(points), 4, 4))
    pose[:, :3, 3] = [t.place for t in found]
    spread = np.array([np.sqrt(np.trace(t.covariance) / 3) for t in found]) * metres
    sigma = np.hypot(control.sigma_m[points], spread[:, None])
    sigma *= _point_factor(pose[:, :3, 3], control.world_m[points], sigma, measured.tuning)
    seen = [measured.scene.frame[control.marks.image[t.marks]] for t in found]
    modes = [measured.modes[f].sum(axis=0) / max(len(f), 1) for f in seen]  # a point moves with the frames that see it
    own = replace(
        evidence,
        frame=np.full(len(points), -1),
        pose=pose,
        speed=np.zeros_like(pose),
        position=control.world_m[points],
        sigma=sigma,
        orientation=np.full((len(points), 3, 3), np.nan),
        modes=np.array(modes),
    )
    return evidence.joined(own)


def _point_factor(place: np.ndarray, world: np.ndarray, sigma: np.ndarray, tuning: WorldTuning) -> float:
    """Ratio of the differences between control points to their sigmas; 1 with three of them."""
    count = len(place)
    if count <= LEAST_PLACES:
        return 1.0
    off = umeyama(place, world, 1 / sigma[:, 0] ** 2)(place) - world
    squares = np.sum((off / sigma) ** 2, axis=1)
    typical = float(np.mean(squares))
    if count >= tuning.noise.min_rows:  # a wrong one cannot hide
        typical = float(np.median(squares)) * 3 / MEDIAN_CHI2_3
    return max(1.0, float(np.sqrt(typical * count / (3 * count - 7))))


def _arm_text(fit: Fit, evidence: Evidence, tuning: WorldTuning) -> str:
    """The lever arm determined from the positions, in words; its sigmas are the larger one in plan, and along the
    vertical."""
    upward = (fit.similarity.rotation @ evidence.pose[evidence.frame >= 0, :3, :3])[:, 2, :].mean(axis=0)
    upward /= max(float(np.linalg.norm(upward)), 1e-12)
    flat = np.eye(3) - np.outer(upward, upward)
    plan = float(np.sqrt(np.linalg.eigvalsh(flat @ fit.antenna_covariance @ flat)[-1]))
    if not np.any(fit.antenna != evidence.antenna):
        return (
            f"no lever arm is given and none could be estimated (sigma {plan:.2f} m; an estimate needs different "
            "headings, such as a return pass): the antenna is assumed to be at the reference camera"
        )
    x, y, z = fit.antenna
    text = f"lever arm estimated: {x:.2f} {y:.2f} {z:.2f} m in the reference camera's frame, to {plan:.2f} m in plan"
    if np.sqrt(upward @ fit.antenna_covariance @ upward) > HARDLY * tuning.fit.antenna_sigma_m:
        text += (
            "; its height cannot be separated from the height of the world (it is assumed to be that of the camera, "
            "to within 1 m): measure the antenna's height above the cameras where heights matter"
        )
    return text + "; a receiver whose positions jump between the passes has the same effect"


def _clock_text(fit: Fit, evidence: Evidence) -> str:
    """The receiver's clock offset determined from the positions, in words."""
    sigma, value = fit.offset_sigma_s, fit.offset_s
    if not value:
        speed = np.linalg.norm(evidence.speed[:, :3, 3], axis=1)
        metres = sigma * float(np.median(speed)) * fit.similarity.scale
        return (
            f"the receiver's clock offset from the cameras cannot be determined (sigma {sigma:.2f} s, {metres:.2f} m "
            "along the path): at constant speed it acts like a lever arm along the track"
        )
    if abs(value) > LIMIT * sigma:
        return f"the receiver's clock is {value:+.3f} s (sigma {sigma:.3f}) off the cameras': taken into account"
    return f"the receiver's clock agrees with the cameras' ({value:+.3f} s, sigma {sigma:.3f})"
