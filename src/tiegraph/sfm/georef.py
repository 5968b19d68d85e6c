"""Where the model is in the world: a robust similarity to prior positions, with lever arm, rig scale and gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity
from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.scene import Scene
from tiegraph.sfm.fit import Evidence, Fit, fit_similarity, jackknife_sigma
from tiegraph.sfm.gravity import Up, up_vector
from tiegraph.sfm.model import frame_poses, held_out_frames, image_poses
from tiegraph.sfm.scale import RigScale, rig_scale
from tiegraph.sfm.settings import GeorefSettings

MIN_POSITIONS = 3
_UNKNOWN_SIGMA_M = 10.0  # of a position whose source gives none (hand-held GPS)
ROLL_LIMIT_DEG = 10.0  # sigma of the roll about the track above which lone cameras' upright direction is used
_AXES = ("east", "north", "up")


@dataclass(frozen=True)
class Georeference:
    """The similarity from a model to the world, and how far to trust it. Columns (F, ...) follow the scene's frames."""

    world_from_model: Similarity
    scale_source: str  # gnss, exif, trajectory, rig baseline, none
    origin: Origin | None  # None: not on the Earth
    residual_m: np.ndarray  # (F, 3) east, north, up: model minus prior; NaN = no prior or not in the model
    inlier: np.ndarray  # (F,) positions the fit believes
    held_out_m: np.ndarray  # (F, 3) residuals of every fifth position, from a fit that did not know it; NaN = others
    sigma: dict[str, float]  # position_m, height_m, yaw_deg, tilt_deg, scale of the placement; {} = not placed
    antenna_m: tuple[float, float, float] | None  # lever arm used, rig frame
    notes: tuple[str, ...]

    @property
    def placed(self) -> bool:
        """Whether positions put the model into the world."""
        return bool(self.sigma)

    def rms_m(self) -> dict[str, float]:
        """Root mean square of the believed residuals per axis, metres."""
        return _rms(self.residual_m[self.inlier])

    def held_out_rms_m(self) -> dict[str, float]:
        """The same of the held-out positions that are not outliers of the full fit."""
        return _rms(self.held_out_m[self.inlier & np.isfinite(self.held_out_m).all(axis=1)])

    def counts(self) -> dict[str, float]:
        """Numbers for the receipt."""
        positions = int(np.isfinite(self.residual_m).all(axis=1).sum())
        out: dict[str, float] = {"positions": positions, "inliers": int(self.inlier.sum())}
        out["scale"] = self.world_from_model.scale
        out.update({f"rms_{a}_m": v for a, v in self.rms_m().items()})
        out.update({f"held_out_rms_{a}_m": v for a, v in self.held_out_rms_m().items()})
        out.update({f"sigma_{n}": v for n, v in self.sigma.items()})
        return {n: round(v, 6) for n, v in out.items()}

    def to_dict(self) -> dict:
        """JSON-ready, for world.json."""
        rows = []
        for f in np.flatnonzero(np.isfinite(self.residual_m).all(axis=1)):
            held = self.held_out_m[f]
            rows.append(
                {
                    "frame": int(f),
                    "residual_m": [round(float(v), 4) for v in self.residual_m[f]],
                    "inlier": bool(self.inlier[f]),
                    "held_out_m": [round(float(v), 4) for v in held] if np.isfinite(held).all() else None,
                }
            )
        return {
            "format": 1,
            "placed": self.placed,
            "scale_source": self.scale_source,
            "crs": None if self.origin is None else self.origin.crs,
            "origin": None if self.origin is None else self.origin.to_dict(),
            "world_from_model": self.world_from_model.matrix.tolist(),
            "scale": self.world_from_model.scale,
            "positions": len(rows),
            "inliers": int(self.inlier.sum()),
            "rms_m": self.rms_m(),
            "held_out_rms_m": self.held_out_rms_m(),
            "sigma": self.sigma,
            "antenna_m": None if self.antenna_m is None else list(self.antenna_m),
            "frames": rows,
            "notes": list(self.notes),
        }

    def apply(self, model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
        """A copy of the model in the world; the lengths of its rigs are scaled too."""
        fit = self.world_from_model
        moved = pycolmap.Reconstruction(model)
        rotation = pycolmap.Rotation3d(transforms.quaternion_xyzw(fit.rotation))
        moved.transform(pycolmap.Sim3d(fit.scale, rotation, np.asarray(fit.translation, float)))
        return moved


def georeference(model: pycolmap.Reconstruction, scene: Scene, settings: GeorefSettings) -> Georeference:
    """Place a model by the scene's prior positions; without three of them, level it by its cameras.

    Robust least squares over rotation, translation, scale (and lever arm) from: positions weighted by their sigmas with
    the antenna's lever arm turned by the model's own orientations; prior orientations of a trajectory; the rig's
    baselines where they are known and long enough; the cameras' upward direction where the positions leave the roll
    about a straight track open.
    """
    images = image_poses(model, scene)
    scale = rig_scale(model, images, scene)
    up = up_vector(images, scene)
    guess = _first_guess(images, scene, scale)
    has = np.isfinite(guess).all(axis=(1, 2)) & np.isfinite(scene.world_from_rig[:, :3, 3]).all(axis=1)
    if has.sum() < MIN_POSITIONS:
        return _levelled(scene, settings, up, scale, int(has.sum()))
    return _placed(images, scene, settings, up, scale)


def georeference_all(
    models: Sequence[pycolmap.Reconstruction], scene: Scene, settings: GeorefSettings
) -> list[Georeference]:
    """Each model by itself; those that are ``placed`` share one world even where no image joins them."""
    return [georeference(model, scene, settings) for model in models]


def _first_guess(images: np.ndarray, scene: Scene, scale: RigScale | None) -> np.ndarray:
    return frame_poses(images, scene, 1.0 if scale is None else scale.metres_per_unit)


def _placed(
    images: np.ndarray, scene: Scene, settings: GeorefSettings, up: Up | None, scale: RigScale | None
) -> Georeference:
    notes: list[str] = []
    arm, estimate = _lever_arm(scene, settings, notes)
    frames = _first_guess(images, scene, scale)
    for _ in range(2):  # the second time with the true scale for frames known through another camera than the first
        evidence = _evidence(frames, scene, settings, arm, estimate, scale)
        fit = fit_similarity(evidence, up_to_use(evidence, up, notes=[]))
        frames = frame_poses(images, scene, fit.similarity.scale)
    used_up = up_to_use(evidence, up, notes)
    held = held_out_frames(scene)[evidence.frame]
    held_out = np.full((scene.frames, 3), np.nan)
    if held.any() and (~held).sum() >= MIN_POSITIONS:
        blind = fit_similarity(evidence.where(~held), used_up)
        held_out[evidence.frame[held]] = evidence.where(held).position_residuals(blind.similarity, blind.antenna)
    residual = np.full((scene.frames, 3), np.nan)
    residual[evidence.frame] = evidence.position_residuals(fit.similarity, fit.antenna)
    inlier = np.zeros(scene.frames, bool)
    inlier[evidence.frame[fit.inlier]] = True
    source = scene.prior if scene.prior != "none" else "positions"
    if scale is not None and scale.trusted and scale.sigma < 0.5 * fit.sigma_positions_scale:
        source = "rig baseline"
    order = np.lexsort((scene.step[evidence.frame], scene.track[evidence.frame]))
    notes += _remarks(fit, scene, scale, len(evidence.frame))
    return Georeference(
        world_from_model=fit.similarity,
        scale_source=source,
        origin=scene.origin,
        residual_m=residual,
        inlier=inlier,
        held_out_m=held_out,
        sigma=jackknife_sigma(evidence, used_up, fit, order),
        antenna_m=tuple(float(v) for v in fit.antenna) if arm is not None or estimate else None,  # type: ignore[arg-type]
        notes=tuple(notes),
    )


def _lever_arm(scene: Scene, settings: GeorefSettings, notes: list[str]) -> tuple[np.ndarray | None, bool]:
    """The given lever arm or None, and whether to estimate it."""
    if scene.prior == "trajectory" or settings.antenna == "ignored":
        return None, False
    given = next((r.antenna_m for r in scene.rigs if r.antenna_m is not None), None)
    if settings.antenna == "estimated":
        notes.append("the antenna's lever arm was estimated; its height cannot be told from the height of the world")
        return None if given is None else np.array(given), True
    if settings.antenna == "given" and given is None:
        notes.append("georef.antenna = 'given', but the rig file gives no antenna: the cameras are taken to be there")
    return None if given is None else np.array(given), False


def _evidence(
    frames: np.ndarray,
    scene: Scene,
    settings: GeorefSettings,
    arm: np.ndarray | None,
    estimate: bool,
    scale: RigScale | None,
) -> Evidence:
    prior = scene.world_from_rig
    use = np.flatnonzero(np.isfinite(frames).all(axis=(1, 2)) & np.isfinite(prior[:, :3, 3]).all(axis=1))
    sigma = np.where(np.isfinite(scene.position_sigma_m[use]), scene.position_sigma_m[use], _UNKNOWN_SIGMA_M)
    return Evidence(
        frame=use,
        pose=frames[use],
        position=prior[use, :3, 3],
        sigma=np.maximum(sigma, settings.sigma_floor_m),
        orientation=prior[use, :3, :3],
        antenna=np.zeros(3) if arm is None else arm,
        estimate_antenna=estimate,
        log_scale=np.log(scale.metres_per_unit) if scale is not None and scale.trusted else None,
        log_scale_sigma=scale.sigma if scale is not None else np.nan,
    )


def up_to_use(evidence: Evidence, up: Up | None, notes: list[str]) -> Up | None:
    """The cameras' upward direction if the positions need it: a straight track leaves the roll about it open."""
    if up is None or np.isfinite(evidence.orientation).all(axis=(1, 2)).any():
        return None
    alone = fit_similarity(evidence, None)
    if up.ring and alone.tilt_sigma_deg > up.sigma_deg / 2:
        notes.append(
            f"the positions leave the tilt open (known to {min(alone.tilt_sigma_deg, 90):.1f} deg): the upward "
            f"direction of {up.cameras} holds it, to about {up.sigma_deg:.0f} deg"
        )
    elif not up.ring and alone.roll_sigma_deg > ROLL_LIMIT_DEG:
        notes.append(
            f"the positions lie nearly on a straight line (roll about it known to {min(alone.roll_sigma_deg, 90):.0f} "
            f"deg): the upward direction of {up.cameras} holds it, to about {up.sigma_deg:.0f} deg"
        )
    else:
        return None
    return up


def _remarks(fit: Fit, scene: Scene, scale: RigScale | None, positions: int) -> list[str]:
    notes = []
    if fit.inlier.sum() < 0.7 * positions:
        notes.append(
            f"only {int(fit.inlier.sum())} of {positions} positions agree with the model within three sigmas: the "
            f"model is bent, or the sigmas are too small"
        )
    if fit.chi2_per_dof > 4:
        notes.append(
            f"residuals are {np.sqrt(fit.chi2_per_dof):.1f} times what the positions' sigmas allow; the sigmas given "
            f"here were widened by it"
        )
    if fit.roll_sigma_deg > ROLL_LIMIT_DEG:
        notes.append(f"the roll about the track is known to {min(fit.roll_sigma_deg, 90):.0f} deg only")
    if scale is not None and scale.trusted:
        ratio = scale.metres_per_unit / fit.similarity.scale
        if abs(np.log(ratio)) > 3 * np.hypot(scale.sigma, fit.sigma["scale"]):
            notes.append(f"the rig's baselines want a scale {ratio:.3f} times that of the positions")
    if scene.origin is None:
        notes.append("the positions are not on the Earth: the world is the trajectory's own frame")
    return notes


def _levelled(
    scene: Scene, settings: GeorefSettings, up: Up | None, scale: RigScale | None, found: int
) -> Georeference:
    """No placement: turned so that up is up, scaled by the rig where that can be trusted."""
    notes = [f"not georeferenced: {found} registered frames have a prior position, {MIN_POSITIONS} are needed"]
    rotation, factor, source = np.eye(3), 1.0, "none"
    if settings.level and up is not None:
        rotation = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up.direction])[0].as_matrix()
        notes.append(f"levelled by the upward direction of {up.cameras}, to about {up.sigma_deg:.0f} deg")
    if scale is not None and scale.trusted:
        factor, source = scale.metres_per_unit, "rig baseline"
        notes.append(f"metric by the rig's baselines (scale good to {scale.sigma:.1%})")
    elif scale is not None:
        notes.append(f"no scale taken from the rig: {scale.why_not}")
    else:
        notes.append("nothing fixes the scale: lengths are in units of the model")
    empty = np.full((scene.frames, 3), np.nan)
    return Georeference(
        world_from_model=Similarity(factor, rotation, np.zeros(3)),
        scale_source=source,
        origin=None,
        residual_m=empty,
        inlier=np.zeros(scene.frames, bool),
        held_out_m=empty,
        sigma={},
        antenna_m=None,
        notes=tuple(notes),
    )


def _rms(residuals: np.ndarray) -> dict[str, float]:
    if len(residuals) == 0:
        return {}
    rms = np.sqrt(np.mean(residuals**2, axis=0))
    return {name: round(float(v), 4) for name, v in zip(_AXES, rms)}
