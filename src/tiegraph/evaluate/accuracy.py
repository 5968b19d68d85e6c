"""The accuracy of a run in layers (``scene.results``): what its stages predicted beside what references measured."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

from tiegraph.evaluate.clouds.judge import PassAgreement
from tiegraph.evaluate.clouds.m3c2 import CONFIDENCE
from tiegraph.evaluate.clouds.nearest import CloudComparison
from tiegraph.evaluate.trajectory import PoseMatch, TrajectoryError
from tiegraph.evaluate.tuning import TrajectoryTuning
from tiegraph.geometry.transforms import rms_length
from tiegraph.scene.results import MEASURED, NAN, PREDICTED, Accuracy, Answer, Figure
from tiegraph.scene.sorting import evenly
from tiegraph.text import csv_text

YES, NO, OPEN = "yes", "no", "cannot be told"
_CHECK = "check points, spread over the survey and not used in the adjustment; one or two are too few"
_AXES = ("east", "north", "up")
_DISTANCES_M = (10.0, 100.0)  # over which the shape is stated
POINT, POINT_90 = "a point of the cloud (median)", "nine in ten points of the cloud"
_OWN = "the run's own account: an error that it does not know of is not in it"
_WORLD = _OWN + "; what all positions share counts as stated"
_POSES = "the place in the world; the reference's own errors count as this run's"
_NOT = {  # key of a figure, in the order they stand -> what it does not prove
    "world": _WORLD,
    "world.nine_in_ten": _WORLD,
    "world.check_points": "anything away from the check points",
    "world.reference_cloud": "what the reference does not show; its own errors count as this run's",
    "world.reference_poses": "the cloud away from the cameras; the reference's own errors count as this run's",
    "world.held_out": "an error that all positions share (base station, datum), nor frames without a position",
    "world.control_points": "anything: the adjustment knew them",
    "world.positions": "anything: the fit knew them",
    "shape.whole": _OWN,
    "shape.10m": _OWN,
    "shape.100m": _OWN,
    "shape.passes": "what both passes share: place, scale, cameras, and what matching got wrong in both",
    "point": _OWN + "; not the place of the surface as a whole",
    "point.reference_cloud": "the place in the world: both were laid on each other first, or the shape of the whole",
}


@dataclass(frozen=True, eq=False)
class Predicted:
    """Sigmas of a run, metres, NaN = not known: of a camera ``inside_m`` the model; of the scale (share; ``spread_m``:
    of the cameras, root mean square from their middle); of what lies ``between`` two frames (K, 2: apart, sigma); of
    the place of a camera in the world by what places the model; of a point of the cloud, and of it in the world: of
    half of them, of nine in ten."""

    inside_m: float = NAN
    scale: float = NAN
    spread_m: float = NAN
    placed_m: float = NAN
    point_m: float = NAN
    world_m: float = NAN
    world_90_m: float = NAN
    between: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def metric(self) -> bool:
        """Whether the model has a scale that can be held against a reference's."""
        return bool(np.isfinite(self.scale))

    @property
    def whole_m(self) -> float:
        """Of a camera after the best alignment of the whole, the scale as it is."""
        return float(np.hypot(self.inside_m, np.nan_to_num(self.spread_m * self.scale)))

    def over_m(self, distance_m: float) -> float:
        """Of what lies between two cameras so far apart; NaN beyond the survey."""
        known = self.between
        if not len(known) or not self.metric or not known[0, 0] <= distance_m <= np.sqrt(2) * known[-1, 0]:
            return NAN
        own = np.interp(np.log(distance_m), np.log(known[:, 0]), known[:, 1])
        return float(np.hypot(own, distance_m * self.scale))

    @property
    def camera_m(self) -> float:
        """Of a camera in the world."""
        return float(np.hypot(np.nan_to_num(self.inside_m), self.placed_m))


@dataclass(frozen=True)
class Hold:
    """What holds a run in the world: positions of how many of its frames, control points; and what checks it there."""

    source: str = ""  # what its positions are, in words
    positions: int = 0  # of frames, that the fit believes
    frames: int = 0
    covered: int = 0  # frames under a bridge that have none
    control: int = 0  # points that the fit used
    checks: int = 0  # points that it did not

    @property
    def text(self) -> str:
        """In words."""
        parts = [f"{self.source} of {self.positions} of {self.frames} frames"] if self.positions else []
        parts += [f"{self.control} control points"] if self.control else []
        return " and ".join(parts) or "nothing"


@dataclass(frozen=True, eq=False)
class Stated:
    """What the stages before say of a run: ``world`` is world.json, {} without."""

    predicted: Predicted = Predicted()
    hold: Hold = Hold()
    world: Mapping[str, Any] = field(default_factory=dict)


def in_layers(stated: Stated, measured: Iterable[Figure]) -> Accuracy:
    """All figures of a run, ``measured``: of its references; layers in order, predicted first, then independent."""
    found = {f.key: f for f in (*_own(stated), *measured)}
    unit = "m" if stated.predicted.metric else "units"
    figures = tuple(found[key] for key in _NOT if key in found)
    return Accuracy(unit=unit, held_by=stated.hold.text, figures=figures, placement=stated.world.get("sigma") or {})


def _own(stated: Stated) -> Iterator[Figure]:
    """What the run says of itself: predictions, and what the fit's own inputs tell."""
    predicted, world = stated.predicted, stated.world
    if placed := world.get("placed", False):
        yield _figure("world", POINT, predicted.world_m)
        yield _figure("world.nine_in_ten", POINT_90, predicted.world_90_m)
    for key, role, name in (("check_points", "check", "check"), ("control_points", "gcp", "control")):
        found = (world.get("accuracy") or {}).get(role)
        if found:
            count = int(found["points"])
            by = f"{count} {name} point{'s' if count > 1 else ''}"
            told = found.get("predicted_m", NAN), found["rmse_m"]
            yield _figure(f"world.{key}", f"a {name} point", *told, by=by, independent=role == "check")
    held = world.get("held_out") or {}
    if placed and held.get("count"):
        by = f"{held['count']} positions held back from the fit"
        sigma = NAN if held["sigma_m"] is None else held["sigma_m"]
        yield _figure("world.held_out", "a position", sigma, _length(held["rms_m"]), by=by)
    if placed and world.get("rms_m"):
        yield _figure("world.positions", "a position", NAN, _length(world["rms_m"]), by="the positions of the fit")
    for distance in _DISTANCES_M:
        if np.isfinite(predicted.over_m(distance)):
            yield _figure(f"shape.{distance:g}m", _over(distance), predicted.over_m(distance))
    yield _figure("shape.whole", "a camera, over the whole", predicted.whole_m)
    yield _figure("point", POINT, predicted.point_m)


def pose_figures(
    match: PoseMatch, result: TrajectoryError, predicted: Predicted, tuning: TrajectoryTuning
) -> list[Figure]:
    """What reference poses (K) measure; in model units where nothing tells its scale."""
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    fit = result.se3 if predicted.metric else result.sim3
    factor = 1.0 if predicted.metric else 1 / fit.alignment.scale
    rows = [("shape.whole", "a camera, over the whole", predicted.whole_m, factor * fit.rmse_m)]
    for distance in _DISTANCES_M if predicted.metric else ():
        off = between(fit.alignment(est), ref, distance, tuning)
        rows.append((f"shape.{distance:g}m", _over(distance), predicted.over_m(distance), off))
    if result.absolute is not None:
        rows.append(("world.reference_poses", "a camera", predicted.camera_m, result.absolute.rmse_m))
    by = f"{len(match)} reference poses"
    found = [_figure(*row, by=by, independent=True) for row in rows if np.isfinite(row[3])]
    return [replace(f, proves_not=_POSES) if f.layer == "shape" else f for f in found]


def between(estimate: np.ndarray, reference: np.ndarray, distance_m: float, tuning: TrajectoryTuning) -> float:
    """Root mean square error of the vector between two positions (K, 3) about so far apart in the reference, both in
    one frame; of many positions an even part. NaN where no two are."""
    rows = evenly(len(reference), 1500)  # a million pairs
    apart = pdist(reference[rows])
    of = (apart >= distance_m) & (apart <= tuning.max_stretch * distance_m)
    i, j = (k[of] for k in np.triu_indices(len(rows), 1))
    off = (estimate - reference)[rows]
    return rms_length(off[j] - off[i])


def cloud_figure(result: CloudComparison, reach_m: float, predicted: Predicted, aligned: bool) -> Figure:
    """What a reference cloud measures: of a point where it was laid on it first, else in the world.

    What the reference's own spacing leaves between a point and its nearest counts as predicted, and what the scale's
    sigma moves a point by at ``reach_m``, the middle one of the reference's distances from its centre. Where half of
    the points have none near, the distance to which nearest ones were looked for.
    """
    criteria, found = result.criteria, np.isfinite(result.whole.median_m)
    parts = [predicted.point_m, np.nan_to_num(predicted.inside_m), max(criteria.spacing_m, criteria.voxel_m) / 2]
    parts.append(reach_m * np.nan_to_num(predicted.scale))
    parts.append(0.0 if aligned else np.nan_to_num(predicted.placed_m))
    layer = "world" if np.isfinite(predicted.placed_m) and not aligned else "point"
    which = "the nearest one, median" if found else "half of the points have none so near"
    by = f"a reference cloud ({result.whole.reference_points} points; {which})"
    return _figure(
        f"{layer}.reference_cloud", "a point of the cloud", float(np.linalg.norm(parts)),
        result.whole.median_m if found else criteria.reach_m, by=by, independent=True,
    )  # fmt: skip


def passes_figure(found: PassAgreement, predicted: Predicted) -> list[Figure]:
    """What the clouds of two passes say of each other, along the surface's normal; none where they were not compared.

    Predicted: what the points of both state (the level of detection is so many sigmas of it), and two cameras
    inside the model, one axis of them. The adjustment knew both passes, so that neither is independent.
    """
    if not np.isfinite(found.rms_m):
        return []
    cameras = np.nan_to_num(predicted.inside_m) * np.sqrt(2 / 3)
    told = float(np.hypot(found.detection_m / CONFIDENCE, cameras))
    of = "a surface, one pass against the other"
    return [_figure("shape.passes", of, told, found.rms_m, by=f"the clouds of passes {' and '.join(found.passes)}")]


def _figure(key: str, of: str, predicted: float = NAN, measured: float = NAN, **more: Any) -> Figure:
    return Figure(key=key, of=of, predicted=float(predicted), measured=float(measured), proves_not=_NOT[key], **more)


def _over(distance_m: float) -> str:
    return f"what lies between two cameras {distance_m:g} m apart"


def _length(axes: Mapping[str, float]) -> float:
    return float(np.linalg.norm(list(axes.values())))


def accuracy_csv(said: Mapping[str, Any], tables: Mapping[str, Mapping[str, Any]], world: dict) -> str:
    """CSV (about, item, quantity, value, unit) of what metrics.json says (``said``: its layers and metrics), of the
    tables {name: {"columns", "rows"}} by their first column, and of each frame's position by ``world`` (world.json)."""
    unit = said["accuracy"]["unit"]
    rows: list[list[Any]] = []
    for key, value in Accuracy.from_dict(said["accuracy"]).values().items():
        rows.append(["accuracy", "", key, value, unit if key.endswith((PREDICTED, MEASURED)) else ""])
    rows += [["survey", "", m["name"], m["value"], m["unit"]] for m in said["metrics"]]
    rows += [[*row, ""] for row in _frames(world)]
    for about, table in tables.items():
        for first, *cells in table["rows"]:
            rows += [[about, first, name, value, ""] for name, value in zip(table["columns"][1:], cells)]
    texts = ([*row[:3], f"{row[3]:.6g}" if isinstance(row[3], float) else row[3], row[4]] for row in rows)
    return csv_text(["about", "item", "quantity", "value", "unit"], texts)


def _frames(world: dict) -> Iterator[tuple[str, Any, str, Any]]:
    for frame in world.get("frames", ()):
        for kind in ("residual_m", "held_out_m"):
            for axis, value in zip(_AXES, frame.get(kind) or ()):
                yield f"{kind.removesuffix('_m').replace('_', ' ')} of a frame, m", frame["frame"], axis, value


def answered(tolerance_m: float, accuracy: Accuracy, stated: Stated, contradicted: bool, min_checks: int) -> Answer:
    """The answer to a tolerance of a point in the world, metres.

    Held: the standard deviation of nine in ten points of the cloud is within it, and so is what was measured
    independently (root mean square). Not held: what was measured is beyond it, or, where nothing was, the standard
    deviation of half of the points is. Fewer than ``min_checks`` check points hold nothing, but may refuse it. The text
    names no figures: they stand beside it, in the layers.
    """
    measured = [f for f in accuracy.of("world") if f.independent and np.isfinite(f.measured)]
    enough = [f for f in measured if f.key != "world.check_points" or stated.hold.checks >= min_checks]
    beyond = next((f for f in measured if f.measured > tolerance_m), None)
    said, why, remedy = _judged(tolerance_m, stated, beyond, enough)
    if said == YES and contradicted:
        said, why, remedy = OPEN, "the survey contradicts itself", "what settles the contradictions stated above"
    return Answer(tolerance_m=tolerance_m, said=said, why=why, remedy=remedy)


def _judged(tolerance_m: float, stated: Stated, beyond: Figure | None, measured: list[Figure]) -> tuple[str, str, str]:
    predicted, hold = stated.predicted, stated.hold
    if not predicted.metric:
        return OPEN, "nothing tells the scale", "positions, control points, or the size of the rig"
    if not np.isfinite(predicted.placed_m):
        return OPEN, "nothing holds the survey in the world", "control points, or positions of its frames"
    if beyond is not None:
        return NO, f"{beyond.by} measured more", _remedy(predicted, hold)
    half, most = predicted.world_m <= tolerance_m, predicted.world_90_m <= tolerance_m
    if most and measured:
        return YES, f"predicted of nine in ten points, and {measured[0].by} measured no more", ""
    if most:
        return OPEN, "predicted of nine in ten points, but nothing independent measured it", _CHECK
    if not np.isfinite(predicted.world_m):
        return OPEN, "nothing is predicted of the cloud's points", _CHECK
    share = "half of the points, not of nine in ten" if half else "less than half of the points"
    if half or measured:
        here = f"; {measured[0].by} measured no more, which is not the cloud as a whole" if measured else ""
        return OPEN, f"predicted of {share}{here}", _remedy(predicted, hold)
    return NO, f"predicted of {share}, and nothing independent says otherwise", _remedy(predicted, hold)


def _remedy(predicted: Predicted, hold: Hold) -> str:
    """What would bring the largest part of the error down."""
    # of points: what turns and stretches the whole moves them more than cameras
    placed = float(np.sqrt(max(predicted.world_m**2 - np.nan_to_num(predicted.point_m) ** 2, 0.0)))
    parts = {"placed": placed, "inside": predicted.inside_m, "point": predicted.point_m}
    largest = max(parts, key=lambda name: np.nan_to_num(parts[name]))
    if largest == "point":
        return "images nearer to the surface or with more pixels, and more of them of each point"
    if largest == "inside":
        return "more overlap between images, a second pass, and ties between passes"
    if not hold.control:
        lost = f", positions under the bridge ({hold.covered} frames have none)" if hold.covered else ""
        return f"control points on both sides and at both ends of the way{lost}"
    return "more control points, to the sides and at the ends of the way"
