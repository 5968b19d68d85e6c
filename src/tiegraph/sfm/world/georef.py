"""Georeferencing of a model: a robust similarity to prior positions, with lever arm, rig scale and gravity."""

from dataclasses import dataclass, field

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry.align import PlacementError, Similarity, rms_length
from tiegraph.geometry.geodesy import Origin, vertical_note
from tiegraph.geometry.gravity import up_vector
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.control import Control
from tiegraph.scene.evidence import Statement, contradictions, table
from tiegraph.scene.scene import Scene
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.ties import moved
from tiegraph.sfm.tuning.world import WorldTuning
from tiegraph.sfm.world.antenna import RIGHT_ANGLE_DEG
from tiegraph.sfm.world.bars import BarsFound, bars_in
from tiegraph.sfm.world.fit import Fit
from tiegraph.sfm.world.fixes import Fixes, Measurements
from tiegraph.sfm.world.marks import point_table, targets, without_blunders
from tiegraph.sfm.world.placed import Model, NotPlaced, SimilarityFit
from tiegraph.sfm.world.scale import RIG, rig_scale
from tiegraph.sfm.world.similarityfit import fit_to_world
from tiegraph.sfm.world.sources import rig_statement, up_statements
from tiegraph.text import known_to

_AXES = ("east", "north", "up")


@dataclass(frozen=True)
class HeldOut:
    """The held-out fixes (every fifth), of frames and between them, and their residuals in the last fit without them;
    without outliers of the full fit."""

    residual_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # (H, 3)
    sigma_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # (H, 3) as stated

    def to_dict(self) -> dict:
        """JSON-ready: number, root mean square per axis, and of the sigmas together, metres."""
        sigma = rms_length(self.sigma_m) if len(self.sigma_m) else None
        return {"count": len(self.residual_m), "rms_m": _rms_by_axis(self.residual_m), "sigma_m": sigma}


@dataclass(frozen=True)
class Residuals:
    """Model minus measured positions: east, north, up, metres. Columns (F, ...) follow the scene's frames."""

    frames_m: np.ndarray  # (F, 3); NaN = no prior or not in the model
    inlier: np.ndarray  # (F,) positions used in the fit
    held_out_m: np.ndarray  # (F, 3) of every fifth position, from a fit without it; NaN = others
    fixes_m: np.ndarray  # (K, 3) of all fixes
    held: HeldOut

    def rms_m(self) -> dict[str, float]:
        """Root mean square of the residuals of the inliers per axis, metres."""
        return _rms_by_axis(self.frames_m[self.inlier])

    def held_out_rms_m(self) -> dict[str, float]:
        """The same for the held-out fixes."""
        return _rms_by_axis(self.held.residual_m)


@dataclass(frozen=True)
class Uncertainty:
    """The accuracy of a georeference."""

    sigma: dict[str, float] = field(default_factory=dict)  # position_m, height_m, yaw_deg, tilt_deg, scale; {} = none
    error: PlacementError | None = None
    shape: Shape | None = None  # of the model, in the world


@dataclass(frozen=True)
class AppliedReceiver:
    """The receiver's lever arm and clock offset that were used."""

    antenna_m: tuple[float, float, float] | None = None  # lever arm, rig frame
    offset_s: float = 0.0  # its clock behind the cameras'


@dataclass(frozen=True)
class PointsFound:
    """Control and check points, as given and in the model."""

    given: Control | None = None
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
    uncertainty: Uncertainty = Uncertainty()
    receiver: AppliedReceiver = AppliedReceiver()
    control: PointsFound = PointsFound()
    adjusted: bool = False  # by a bundle adjustment with the positions, not by the similarity alone
    placing: SimilarityFit | None = None

    @property
    def placed(self) -> bool:
        """Whether positions place the model in the world."""
        return bool(self.uncertainty.sigma)

    def counts(self) -> dict[str, float]:
        """Numbers for the receipt."""
        residuals = self.residuals
        positions = int(np.isfinite(residuals.frames_m).all(axis=1).sum())
        out: dict[str, float] = {"positions": positions, "inliers": int(residuals.inlier.sum())}
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
        residuals, antenna_m, error = self.residuals, self.receiver.antenna_m, self.uncertainty.error
        rows = []
        for f in np.flatnonzero(np.isfinite(residuals.frames_m).all(axis=1)):
            held = residuals.held_out_m[f]
            rows.append(
                {
                    "frame": int(f),
                    "residual_m": [round(float(v), 4) for v in residuals.frames_m[f]],
                    "inlier": bool(residuals.inlier[f]),
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
            "inliers": int(residuals.inlier.sum()),
            "rms_m": residuals.rms_m(),
            "held_out": residuals.held.to_dict(),
            "sigma": self.uncertainty.sigma,
            "antenna_m": None if antenna_m is None else list(antenna_m),
            "clock_offset_s": round(self.receiver.offset_s, 4),
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
    images = image_poses(model, scene)
    found = []
    if given.control is not None:
        found = targets(model, scene, given.control.marks, len(given.control), tuning.marks)
        found = without_blunders(found, given.control, tuning.marks)
    rig = rig_scale(model, images, scene, tuning.scale, given.model_scale_sigma)
    bars = bars_in(model, scene, given.bars, tuning.marks)
    by_bars = None if bars is None else bars.scale
    side = scene.of_role("side")
    up = up_vector(images[side], scene.frame[side], tuning.up)
    view = Model(
        images=images,
        up=up,
        scale=by_bars or rig,
        targets=found,
        names=scene.names,
        bars=bars,
        rig=rig if by_bars else None,
    )
    placing = fit_to_world(view, scene, settings, given, tuning)
    if isinstance(placing, NotPlaced):
        return _levelled(scene, view, placing, given.shape)
    return _placed(placing, view, scene, given)


def _placed(placing: SimilarityFit, view: Model, scene: Scene, given: Measurements) -> Georeference:
    fit, count = placing.fit, len(placing.fixes)
    points, sums, lines = _points(view, given, fit)
    return Georeference(
        world_from_model=fit.similarity,
        scale_source=_scale_source(placing, scene, view, count),
        origin=scene.origin or (given.control.origin if given.control is not None else None),
        residuals=residuals_of(placing, scene, placing.held_out(bends=False)),
        findings=Findings((*placing.notes, *_remarks(placing, scene), *lines)),
        uncertainty=Uncertainty(fit.sigma, fit.error, given.shape and given.shape.moved(fit.similarity)),
        receiver=applied_receiver(fit.arm.place, fit.clock.offset_s),
        control=PointsFound(
            given=given.control, rows=tuple(points), accuracy=sums, bars=bar_rows(view.bars, fit.similarity.scale)
        ),
        placing=placing,
    )


def residuals_of(placing: SimilarityFit, scene: Scene, blind: np.ndarray | None) -> Residuals:
    """The residuals of a georeference; ``blind`` (K, 3): those of the fit without the held-out fixes."""
    fixes, fit, here = placing.fixes, placing.fit, placing.residuals()
    at = row_of_frames(fixes, scene.frames)
    has = np.flatnonzero(at >= 0)
    residual, held_out = np.full((scene.frames, 3), np.nan), np.full((scene.frames, 3), np.nan)
    residual[has] = here[at[has]]
    inlier, held_fixes = np.zeros(scene.frames, bool), HeldOut()
    inlier[has] = fit.inlier[at[has]]
    if blind is not None:
        held = has[fixes.held[at[has]]]
        held_out[held] = blind[at[held]]
        good = fixes.held & fit.inlier[: len(fixes)]
        held_fixes = HeldOut(blind[good], fixes.stated[good])
    return Residuals(residual, inlier, held_out_m=held_out, fixes_m=here, held=held_fixes)


def applied_receiver(antenna: np.ndarray, offset_s: float) -> AppliedReceiver:
    """Lever arm (3,) and clock offset of a georeference; a lever arm of zero counts as none."""
    x, y, z = antenna.tolist()
    return AppliedReceiver((x, y, z) if antenna.any() else None, offset_s)


def row_of_frames(fixes: Fixes, frames: int) -> np.ndarray:
    """(F,) the fix nearest to each frame; -1 = none."""
    out, best = np.full(frames, -1), np.zeros(frames)
    weight = np.abs(fixes.weights).max(axis=1)
    for k, home in enumerate(fixes.home):
        if weight[k] > best[home]:
            out[home], best[home] = k, weight[k]
    return out


def _points(view: Model, given: Measurements, fit: Fit) -> tuple[list[dict], dict, list[str]]:
    """Table of control and check points, their accuracy, and points that could not be used, with file and line."""
    control = given.control
    if control is None:
        return [], {}, []
    place = np.array([t.place for t in view.targets]).reshape(-1, 3)
    off = fit.similarity(place) - control.world_m
    rows, sums = point_table(control, view.targets, off, view.names)
    lines = list(control.notes)
    for k, target in enumerate(view.targets):
        if target.why_not:
            where = control.marks.line[(control.marks.point == k) & (control.marks.line > 0)]
            line = f" (marks in line {', '.join(map(str, where[:4]))})" if len(where) else ""
            lines.append(f"point {control.names[k]!r} is not used: {target.why_not}{line}")
    return rows, sums, lines


def _scale_source(placing: SimilarityFit, scene: Scene, view: Model, fixes: int) -> str:
    held = view.scale is not None and placing.evidence.log_scale is not None
    limit = placing.tuning.statements.rig_tells * placing.fit.sigma_positions_scale
    if held and view.scale is not None and view.scale.sigma < limit:
        return view.scale.name
    if not fixes:
        return "control points"
    return scene.prior if scene.prior != "none" else "positions"


def _remarks(placing: SimilarityFit, scene: Scene) -> list[str]:
    notes, fit, tuning = [], placing.fit, placing.tuning
    told, most = tuning.statements.scatter_told, tuning.statements.scatter
    for sigma_m, factor, count in placing.fit.levels:
        if told < factor <= most and count >= tuning.noise.min_rows:
            notes.append(
                f"positions of stated sigma {sigma_m:.2f} m scatter {factor:.1f} times as much: their sigma was "
                "increased accordingly"
            )
    if fit.roll_sigma_deg > tuning.similarity_fit.roll_limit_deg:
        known = known_to(fit.roll_sigma_deg, RIGHT_ANGLE_DEG, f"{fit.roll_sigma_deg:.0f} deg only")
        notes.append(f"the roll about the track is {known}")
    if scene.origin is None and not len(placing.points):
        notes.append("the positions are not geographic: the world is the trajectory's own frame")
    notes += _passes_without(placing, scene)
    return notes


def _passes_without(placing: SimilarityFit, scene: Scene) -> list[str]:
    """Passes without any position: only the images tie them to the others."""
    if not len(placing.fixes) or len(scene.sequences) < 2:
        return []
    lost = [name for k, name in enumerate(scene.sequences) if not np.any(scene.sequence[placing.fixes.home] == k)]
    return [f"pass {name!r} has no position: only its ties to the other passes place it" for name in lost]


def bar_rows(bars: BarsFound | None, metres_per_unit: float) -> tuple[dict, ...]:
    """The rows of the scale bars, none without any."""
    return () if bars is None else bars.rows(metres_per_unit)


def _levelled(scene: Scene, view: Model, placing: NotPlaced, shape: Shape | None) -> Georeference:
    """Without positions: the model turned upright, scaled by scale bars or the rig where these are reliable."""
    up, scale, bars = view.up, view.scale, view.bars
    notes = [] if placing.contradicts else [f"not georeferenced: {placing.why}"]
    rotation, factor, source = np.eye(3), 1.0, "none"
    if up is not None:
        rotation = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up.direction])[0].as_matrix()
        notes.append(f"levelled by the upward direction of {up.cameras}, with a sigma of about {up.sigma_deg:.0f} deg")
    if scale is not None and scale.trusted:
        factor, source = scale.metres_per_unit, scale.name
        by = "the rig's baselines" if scale.source == RIG else f"the {scale.source}"
        notes.append(f"metric by {by} (scale good to {scale.sigma:.{1 if scale.source == RIG else 3}%})")
    elif scale is not None:
        notes.append(f"the rig gives no scale: {scale.why_not}")
    else:
        notes.append("the scale is unknown: lengths are in model units")
    empty = np.full((scene.frames, 3), np.nan)
    here = Similarity(factor, rotation, np.zeros(3))
    said = [*rig_statement(scale, here, True), *rig_statement(view.rig, here, False), *up_statements(up, here, True)]
    rows = bar_rows(bars, factor if source != "none" else float("nan"))
    against = [placing.why] if placing.contradicts else []
    against += bars.told(rows, scale.sigma) if bars is not None and scale is not None else ()
    return Georeference(
        world_from_model=here,
        scale_source=source,
        origin=None,
        residuals=Residuals(
            empty, np.zeros(scene.frames, bool), held_out_m=empty, fixes_m=np.zeros((0, 3)), held=HeldOut()
        ),
        findings=Findings(tuple(notes), tuple(said), (*(c.text() for c in contradictions(said)), *against)),
        uncertainty=Uncertainty(shape=shape and shape.moved(here)),
        control=PointsFound(bars=rows),
    )


def _rms_by_axis(residuals: np.ndarray) -> dict[str, float]:
    if len(residuals) == 0:
        return {}
    rms = np.sqrt(np.mean(residuals**2, axis=0))
    return {name: round(float(v), 4) for name, v in zip(_AXES, rms)}
