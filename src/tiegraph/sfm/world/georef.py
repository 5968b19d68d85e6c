"""Georeferencing of a model: a robust similarity to prior positions, with lever arm, rig scale and gravity."""

from dataclasses import dataclass, field, replace

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry.geodesy import Origin, vertical_note
from tiegraph.geometry.gravity import up_vector
from tiegraph.geometry.transforms import PlacementError, Similarity, rms_length
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.evidence import LIMIT, Statement, contradictions, table
from tiegraph.scene.scene import Scene
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.ties import moved
from tiegraph.sfm.tuning.world import WorldTuning
from tiegraph.sfm.world.fit import Fit
from tiegraph.sfm.world.fixes import Measured, Measurements
from tiegraph.sfm.world.marks import point_table, targets, without_blunders
from tiegraph.sfm.world.scale import RIG, bars_in, rig_scale
from tiegraph.sfm.world.similarityfit import NotPlaced, SimilarityFit, fit_to_world
from tiegraph.sfm.world.upright import RIGHT_ANGLE_DEG
from tiegraph.sfm.world.weighing import length_statement, up_statements
from tiegraph.text import known_to

AXES = ("east", "north", "up")


@dataclass(frozen=True)
class Residuals:
    """Model minus measured positions: east, north, up, metres. Columns (F, ...) follow the scene's frames.

    Held out is every fifth fix, of frames and between them; ``held_m`` is without outliers of the full fit.
    """

    frames_m: np.ndarray  # (F, 3); NaN = no prior or not in the model
    inlier: np.ndarray  # (F,) positions used in the fit
    held_out_m: np.ndarray  # (F, 3) of the held-out positions, from a fit without them; NaN = others
    fixes_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # (K, 3) of all fixes
    held_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # (H, 3) of the held-out fixes, the same fit
    held_sigma_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # (H, 3) as stated

    @property
    def known(self) -> np.ndarray:
        """(F,) bool: frames with a residual."""
        return np.asarray(np.isfinite(self.frames_m).all(axis=1))

    def rms_m(self) -> dict[str, float]:
        """Root mean square of the residuals of the inliers per axis, metres."""
        return _rms_by_axis(self.frames_m[self.inlier])

    def held_out_rms_m(self) -> dict[str, float]:
        """The same for the held-out fixes."""
        return _rms_by_axis(self.held_m)


@dataclass(frozen=True)
class Uncertainty:
    """The accuracy of a georeference."""

    sigma: dict[str, float] = field(default_factory=dict)  # position_m, height_m, yaw_deg, tilt_deg, scale; {} = none
    error: PlacementError | None = None
    shape: Shape | None = None  # of the model, in the world


@dataclass(frozen=True)
class PointsFound:
    """Control and check points and scale bars in the model."""

    rows: tuple[dict, ...] = ()  # one a point: off_m east, north, up (model minus survey), rms_px
    accuracy: dict[str, dict[str, float]] = field(default_factory=dict)  # gcp, check: RMSE, CE90, LE90
    bars: tuple[dict, ...] = ()  # one a scale bar: lengths, off_mm (model minus measured), sigma_mm


@dataclass(frozen=True)
class Findings:
    """The remarks on a georeference: notes, statements of each source, and their contradictions."""

    notes: tuple[str, ...]
    statements: tuple[Statement, ...] = ()
    contradictions: tuple[str, ...] = ()


@dataclass(frozen=True)
class Georeference:
    """The similarity from a model to the world, and its accuracy."""

    world_from_model: Similarity
    scale_source: str  # gnss, exif, trajectory, rig baseline, none
    origin: Origin | None  # None: not on the Earth
    residuals: Residuals
    findings: Findings
    uncertainty: Uncertainty
    control: PointsFound
    fit: Fit | None = (
        None  # of the similarity or, if the model was adjusted with the positions, of similarity and shape
    )
    adjusted: bool = False  # by a bundle adjustment with the positions, not by the similarity alone
    placing: SimilarityFit | None = None

    @property
    def placed(self) -> bool:
        """Whether positions place the model in the world."""
        return bool(self.uncertainty.sigma)

    @property
    def antenna_m(self) -> list[float] | None:
        """The lever arm that was used, in the rig frame."""
        return None if self.fit is None or not self.fit.antenna.any() else self.fit.antenna.tolist()

    @property
    def clock_offset_s(self) -> float:
        """The receiver's clock behind the cameras'."""
        return 0.0 if self.fit is None else self.fit.offset_s

    def noted(self, *notes: str) -> "Georeference":
        """The same with more notes."""
        return replace(self, findings=replace(self.findings, notes=(*self.findings.notes, *notes)))

    def counts(self) -> dict[str, float]:
        """Numbers for the receipt."""
        residuals = self.residuals
        out: dict[str, float] = {"positions": int(residuals.known.sum()), "inliers": int(residuals.inlier.sum())}
        out["scale"] = self.world_from_model.scale
        out.update({f"rms_{a}_m": v for a, v in residuals.rms_m().items()})
        out.update({f"held_out_rms_{a}_m": v for a, v in residuals.held_out_rms_m().items()})
        out.update({f"sigma_{n}": v for n, v in self.uncertainty.sigma.items()})
        for role, values in self.control.accuracy.items():
            out.update({f"{role}_{n}": v for n, v in values.items() if n in ("points", "rmse_m", "ce90_m", "le90_m")})
        if self.control.rows:
            out["points_refused"] = sum(bool(row["why_not"]) for row in self.control.rows)
        out["contradictions"] = len(self.findings.contradictions)
        return {n: round(v, 6) for n, v in out.items()}

    def to_dict(self) -> dict:
        """JSON-ready, for world.json."""
        residuals, error = self.residuals, self.uncertainty.error
        rows = [
            {
                "frame": int(f),
                "residual_m": [round(float(v), 4) for v in residuals.frames_m[f]],
                "inlier": bool(residuals.inlier[f]),
                "held_out_m": [round(float(v), 4) for v in held] if np.isfinite(held).all() else None,
            }
            for f in np.flatnonzero(residuals.known)
            for held in (residuals.held_out_m[f],)
        ]
        return {
            "format": 1,
            "placed": self.placed,
            "scale_source": self.scale_source,
            "crs": None if self.origin is None else self.origin.crs,
            "origin": None if self.origin is None else self.origin.to_dict(),
            "world_from_model": self.world_from_model.matrix.tolist(),
            "scale": self.world_from_model.scale,
            "positions": len(rows),
            "inliers": int(residuals.inlier.sum()),
            "rms_m": residuals.rms_m(),
            "held_out": {
                "count": len(residuals.held_m),
                "rms_m": residuals.held_out_rms_m(),
                "sigma_m": rms_length(residuals.held_sigma_m) if len(residuals.held_m) else None,
            },
            "sigma": self.uncertainty.sigma,
            "antenna_m": self.antenna_m,
            "clock_offset_s": round(self.clock_offset_s, 4),
            "adjusted": self.adjusted,
            "vertical": None if self.origin is None else vertical_note(self.origin.crs),
            "placement_error": None if error is None else error.to_dict(),
            "control": list(self.control.rows),
            "accuracy": self.control.accuracy,
            "scale_bars": list(self.control.bars),
            "frames": rows,
            "notes": list(self.findings.notes),
            "evidence": table(self.findings.statements),
            "contradictions": list(self.findings.contradictions),
        }

    def apply(self, model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
        """A copy of the model in the world; the lengths of its rigs are scaled too."""
        return moved(model, self.world_from_model)


def _rms_by_axis(residuals: np.ndarray) -> dict[str, float]:
    if len(residuals) == 0:
        return {}
    rms = np.sqrt(np.mean(residuals**2, axis=0))
    return {name: round(float(v), 4) for name, v in zip(AXES, rms)}


def georeference(
    model: pycolmap.Reconstruction,
    scene: Scene,
    settings: GeorefSettings,
    tuning: WorldTuning,
    given: Measurements | None = None,
) -> Georeference:
    """Place a model by positions and control points; with fewer than three, level it by its cameras.

    Robust least squares over rotation, translation, scale, lever arm and clock offset from: positions weighted by
    their sigmas (scaled to their residuals), with the antenna's lever arm rotated by the model's own orientations;
    control points where the rays of their marks intersect; prior orientations; the rig's baselines where they are
    known and long enough; the cameras' upward direction where the positions do not determine the roll about a
    straight track.
    """
    given = given or Measurements()
    images, side, found = image_poses(model, scene), scene.of_role("side"), []
    if given.control is not None:
        found = targets(model, scene, given.control.marks, len(given.control), tuning.marks)
        found = without_blunders(found, given.control, tuning.marks)
    bars = bars_in(model, scene, given.bars, tuning.marks)
    lengths = (
        None if bars is None else bars.scale,
        rig_scale(model, images, scene, tuning.scale, given.model_scale_sigma),
    )
    measured = Measured(
        images=images,
        up=up_vector(images[side], scene.frame[side], tuning.up),
        scene=scene,
        settings=settings,
        given=given,
        tuning=tuning,
        lengths=tuple(s for s in lengths if s is not None),
        targets=found,
        bars=bars,
    )
    placing = fit_to_world(measured)
    return _levelled(measured, placing) if isinstance(placing, NotPlaced) else of_fit(placing)


def of_fit(placing: SimilarityFit) -> Georeference:
    """The georeference of a model that its evidence places."""
    fit, measured = placing.fit, placing.measured
    control, shape, bars = measured.given.control, measured.given.shape, measured.bars
    points, lines = PointsFound(bars=() if bars is None else bars.rows(fit.similarity.scale)), []
    if control is not None:
        place = np.array([t.place for t in measured.targets]).reshape(-1, 3)
        off = fit.similarity(place) - control.world_m
        rows, sums = point_table(control, measured.targets, off, measured.scene.names)
        points, lines = replace(points, rows=tuple(rows), accuracy=sums), list(control.notes)
        for k, target in enumerate(measured.targets):
            if target.why_not:
                where = control.marks.line[(control.marks.point == k) & (control.marks.line > 0)]
                line = f" (marks in line {', '.join(map(str, where[:4]))})" if len(where) else ""
                lines.append(f"point {control.names[k]!r} is not used: {target.why_not}{line}")
    return Georeference(
        world_from_model=fit.similarity,
        scale_source=_scale_source(placing),
        origin=measured.scene.origin or (control.origin if control is not None else None),
        residuals=residuals_of(placing, placing.held_out(bends=False)),
        findings=Findings((*placing.notes, *_remarks(placing), *lines)),
        uncertainty=Uncertainty(fit.sigma, fit.error, shape and shape.moved(fit.similarity)),
        control=points,
        fit=fit,
        placing=placing,
    )


def residuals_of(placing: SimilarityFit, blind: np.ndarray | None) -> Residuals:
    """The residuals of a georeference; ``blind`` (K, 3): those of the fit without the held-out fixes."""
    fixes, inlier, here, frames = placing.fixes, placing.fit.inlier, placing.residuals(), placing.measured.scene.frames
    at = np.full(frames, -1)  # the fix nearest to each frame
    nearest = np.lexsort((-np.arange(len(fixes)), np.abs(fixes.weights).max(axis=1)))
    at[fixes.home[nearest]] = nearest
    has = np.flatnonzero(at >= 0)
    residual, held_out, used = np.full((frames, 3), np.nan), np.full((frames, 3), np.nan), np.zeros(frames, bool)
    residual[has], used[has] = here[at[has]], inlier[at[has]]
    out = Residuals(residual, used, held_out, fixes_m=here)
    if blind is None:
        return out
    held, good = has[fixes.held[at[has]]], fixes.held & inlier[: len(fixes)]
    held_out[held] = blind[at[held]]
    return replace(out, held_m=blind[good], held_sigma_m=fixes.stated[good])


def _scale_source(placing: SimilarityFit) -> str:
    """What determines the scale: known lengths, if the rest of the evidence tells it clearly worse."""
    measured, told = placing.measured, placing.evidence.log_scale is not None
    if told:
        scale = measured.lengths[0]
        others = 1 / placing.fit.error.covariance[6, 6] - scale.sigma**-2  # information
        if others < (placing.tuning.statements.scatter * scale.sigma) ** -2:
            return scale.name
    if not len(placing.fixes):
        return "control points"
    return measured.scene.prior if measured.scene.prior != "none" else "positions"


def _remarks(placing: SimilarityFit) -> list[str]:
    fit, scene, tuning = placing.fit, placing.measured.scene, placing.tuning
    most = tuning.statements.scatter
    notes = [
        f"positions of stated sigma {sigma_m:.2f} m scatter {factor:.1f} times as much: their sigma was increased "
        "accordingly"
        for sigma_m, factor, count in fit.levels
        if 1 + LIMIT / np.sqrt(6 * count) < factor <= most and count >= tuning.noise.min_rows  # of 3 values each
    ]
    if fit.roll_sigma_deg > tuning.up.lone_sigma_deg:
        known = known_to(fit.roll_sigma_deg, RIGHT_ANGLE_DEG, f"{fit.roll_sigma_deg:.0f} deg only")
        notes.append(f"the roll about the track is {known}")
    if scene.origin is None and not len(placing.measured.points):
        notes.append("the positions are not geographic: the world is the trajectory's own frame")
    if len(placing.fixes) and len(scene.sequences) > 1:
        lost = set(range(len(scene.sequences))) - set(scene.sequence[placing.fixes.home].tolist())
        notes += [
            f"pass {scene.sequences[k]!r} has no position: only its ties to the other passes place it"
            for k in sorted(lost)
        ]
    return notes


def _levelled(measured: Measured, placing: NotPlaced) -> Georeference:
    """Without positions: the model turned upright, scaled by scale bars or the rig where these are reliable."""
    up, bars, shape = measured.up, measured.bars, measured.given.shape
    notes = [] if placing.contradicts else [f"not georeferenced: {placing.why}"]
    against = [placing.why] if placing.contradicts else []
    rotation, factor, source = np.eye(3), 1.0, "none"
    if up is not None:
        rotation = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up.direction])[0].as_matrix()
        notes.append(f"levelled by the upward direction of {up.cameras}, with a sigma of about {up.sigma_deg:.0f} deg")
    scale = next(iter(measured.lengths), None)
    if scale is None:
        notes.append("the scale is unknown: lengths are in model units")
    elif scale.why_not:
        notes.append(f"the rig gives no scale: {scale.why_not}")
    else:
        factor, source = scale.metres_per_unit, scale.name
        by = "the rig's baselines" if scale.source == RIG else f"the {scale.source}"
        notes.append(f"metric by {by} (scale good to {scale.sigma:.{1 if scale.source == RIG else 3}%})")
    here = Similarity(factor, rotation)
    said = [s for k, one in enumerate(measured.lengths) for s in length_statement(one, here, used=k == 0)]
    said += up_statements(up, here, used=True)
    against = [*(c.text() for c in contradictions(said)), *against]
    rows = () if bars is None else bars.rows(factor if source != "none" else float("nan"))
    against += bars.told(rows, scale.sigma) if bars is not None and scale is not None else ()
    frames = measured.scene.frames
    empty = np.full((frames, 3), np.nan)
    return Georeference(
        world_from_model=here,
        scale_source=source,
        origin=None,
        residuals=Residuals(empty, np.zeros(frames, bool), empty),
        findings=Findings(tuple(notes), tuple(said), tuple(against)),
        uncertainty=Uncertainty(shape=shape and shape.moved(here)),
        control=PointsFound(bars=rows),
    )
