"""Everything the evaluate stage states about a run: from a model, a cloud and references to metrics.json.

An error of a reference far beyond its predicted sigma contradicts; what would explain it is said.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from tiegraph.errors import InputError
from tiegraph.evaluate import reference
from tiegraph.evaluate.accuracy import Predicted, Stated, answered, cloud_figure, in_layers, passes_figure, pose_figures
from tiegraph.evaluate.clouds.judge import CloudJudgement, PassAgreement, Question, judge_cloud
from tiegraph.evaluate.clouds.nearest import Cameras
from tiegraph.evaluate.reference import ModelPoses
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.evaluate.trajectory import PoseMatch, TrajectoryError, evaluate_trajectory, registered_metrics
from tiegraph.evaluate.tuning import Tuning
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import ENU, Origin
from tiegraph.geometry.transforms import Similarity, rms_length, umeyama
from tiegraph.scene.cloudchunks import PointSource, open_cloud
from tiegraph.scene.colmapmodel import Registration, matrix
from tiegraph.scene.evidence import LIMIT, RARELY, fits_better
from tiegraph.scene.results import Figure, Metric, metrics_to_dict
from tiegraph.scene.scene import Scene

_WHOLE = 0.7  # share of the images registered: a torn or thin model may be a mirror image itself
_COUNTED = 6  # poses at most in the test of what explains an error: errors of neighbours are alike
_SAMPLE = 4_000_000  # points of the cloud that are projected back: bounds memory


@dataclass
class _Findings:
    metrics: list[Metric] = field(default_factory=list)
    tables: dict[str, dict] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    contradictions: list[str] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)

    def add(self, result: Any, note: str, figures: list[Figure]) -> None:
        """What a comparison found."""
        self.metrics += result.metrics()
        self.tables |= result.tables()
        self.notes.append(note)
        self.figures += figures


@dataclass(frozen=True, eq=False)
class Products:
    """What a run made: ``model`` a pycolmap reconstruction in the world frame, ``images`` which of the scene's are
    registered in it, the cloud, the world's origin (None: the model's own frame), the ground sampling distance, and an
    empty folder for the tiles of clouds."""

    model: Any
    images: Registration
    cloud: PointSource | None
    origin: Origin | None = None
    gsd_m: float | None = None
    scratch: Path | None = None


@dataclass(frozen=True)
class Evaluation:
    """The content of metrics.json, and how the cloud was judged by a reference cloud, if there is one, after an
    alignment (None: as it is)."""

    metrics: dict[str, Any]
    cloud: CloudJudgement | None = None
    alignment: Similarity | None = None


def evaluate_survey(
    scene: Scene,
    made: Products,
    settings: EvaluateSettings,
    tuning: Tuning,
    stated: Stated | None = None,
    passes: PassAgreement | None = None,
) -> Evaluation:
    """The content of metrics.json for a run, and how its cloud was judged.

    ``stated``: what the run says of itself, which its references are held against; ``passes``: how well two of them
    agree. Raises InputError for references that cannot be read or matched.
    """
    found, cloud, stated = _Findings(), made.cloud, stated or Stated()
    model = reference.model_poses(made.model, scene)
    found.metrics += registered_metrics(made.images)
    if cloud is not None:
        # Against its own points a camera model without depth maps says the same, and needs no reading of them.
        rmse, rounding, _ = backprojection_rmse(cloud.sample(_SAMPLE), made.model, tuning.points_tried)
        found.metrics += [Metric("backprojection_rmse", rmse, "m"), Metric("backprojection_rounding", rounding, "m")]
        found.notes.append(BACKPROJECTION)
    trajectory = judged = alignment = None
    if settings.reference is not None:
        trajectory = _trajectory(found, scene, made, model, settings, tuning, stated.predicted)
    if settings.reference_cloud is not None and cloud is not None:
        alignment, how = _alignment(settings, trajectory)
        truth, how = _truth(settings.reference_cloud, settings, made.origin, alignment, how)
        judged = _judged(scene, made, model, truth, settings, tuning, alignment)
        figure = cloud_figure(judged.nearest, _reach(judged), stated.predicted, alignment is not None)
        found.add(judged, f"Reference cloud {settings.reference_cloud.name}, {how}. {judged.notes()}", [figure])
        found.contradictions += against_cloud(figure)
    if passes is not None:
        found.add(passes, passes.note(), passes_figure(passes, stated.predicted))
    accuracy = in_layers(stated, found.figures)
    if settings.tolerance_m is not None:
        contradicted = bool(found.contradictions or stated.world.get("contradictions"))
        answer = answered(settings.tolerance_m, accuracy, stated, contradicted, tuning.min_checks)
        accuracy = replace(accuracy, answer=answer)
    said = metrics_to_dict(found.metrics, found.tables, found.notes, found.contradictions, accuracy)
    return Evaluation(said, judged, alignment)


def _trajectory(
    found: _Findings,
    scene: Scene,
    made: Products,
    model: ModelPoses,
    settings: EvaluateSettings,
    tuning: Tuning,
    predicted: Predicted,
) -> TrajectoryError:
    assert settings.reference is not None
    path, origin, metric = settings.reference, made.origin, predicted.metric
    match, said = reference.match_poses(reference.read_reference_poses(path), model, scene, tuning.trajectory.max_gap_s)
    comparable = settings.reference_origin is not None and origin is not None
    if settings.reference_origin is not None and origin is not None:
        match = reference.poses_to_world(match, Origin(*settings.reference_origin), origin)
    try:
        distances = tuning.trajectory.relative_m
        result = evaluate_trajectory(match, distances, tuning.trajectory, same_frame=comparable, metric=metric)
    except np.linalg.LinAlgError as error:
        raise InputError(f"{path}: the poses cannot be aligned: {error}") from None
    figures = pose_figures(match, result, predicted, tuning.trajectory)
    registered = float(made.images.registered.mean()) if len(scene) else 0.0
    found.add(result, f"Reference poses {path.name}: {said}.", figures)
    found.contradictions += against_poses(match, figures, metric, _step_s(scene), registered)
    if not metric:
        found.notes.append("Nothing told the model's scale: the reference does, and no error of it is stated.")
    if comparable:
        found.notes.append("absolute_rmse compares positions in the same CRS without any alignment.")
    else:
        found.notes.append("No absolute error: the reference has no stated origin, or the model is not georeferenced.")
    return result


def _step_s(scene: Scene) -> float:
    """Median time between frames of a pass, NaN without times."""
    order = np.lexsort((scene.sequence_index, scene.sequence))
    step = np.diff(scene.time_s[order])[np.diff(scene.sequence[order]) == 0]
    step = step[np.isfinite(step)]
    return float(np.median(step)) if len(step) else float("nan")


def _truth(
    path: Path, settings: EvaluateSettings, origin: Origin | None, alignment: Similarity | None, how: str
) -> tuple[PointSource, str]:
    """A reference cloud in the run's world, and how it is compared."""
    truth = open_cloud(path)
    source = _origin_of(settings, truth.crs)
    if source is None and alignment is None and origin is not None and origin.crs != ENU:
        source, taken = _origin_of(settings, origin.crs), f"no CRS in its header, so taken to be in {origin.crs}"
        truth, how = replace(truth, name=f"{truth.name} ({taken})"), f"{how}; {taken}, as the run's own files are"
    if truth.note and source is not None:
        how = f"{how}; {truth.note}"
    if source is not None and origin is not None:
        truth = truth.moved(lambda xyz: reference.to_world(xyz, source, origin))
    return truth, how


def _judged(
    scene: Scene,
    made: Products,
    model: ModelPoses,
    truth: PointSource,
    settings: EvaluateSettings,
    tuning: Tuning,
    alignment: Similarity | None,
) -> CloudJudgement:
    assert made.cloud is not None and made.scratch is not None
    section = scene.section[scene.frame][model.placed]
    own, cameras = made.cloud, Cameras(model.centres(), tuple(f"{s}" if s >= 0 else "(none)" for s in section))
    if alignment is not None:
        own, cameras = own.moved(alignment), Cameras(alignment(cameras.centres), cameras.section)
    question = Question(distances_m=settings.distances_m, gsd_m=made.gsd_m, cameras=cameras, range_m=settings.range_m)
    try:
        return judge_cloud(own, truth, made.scratch, question, tuning)
    except InputError as error:
        shift = () if made.origin is None or alignment is not None else made.origin.shift_m
        less = " (of all coordinates the run's shift was taken off: " + ", ".join(f"{v:.10g}" for v in shift) + ")"
        raise InputError(f"{error}{less if any(shift) else ''}") from None


def _reach(result: CloudJudgement) -> float:
    """How far the middle one of the reference's core points is from their centre."""
    xyz = result.differences.xyz
    return float(np.median(np.linalg.norm(xyz - np.median(xyz, axis=0), axis=1))) if len(xyz) else 0.0


def _origin_of(settings: EvaluateSettings, crs: str | None) -> Origin | None:
    """The frame of a reference cloud: the CRS that its header names; local metres about the origin that is given."""
    if crs is not None:
        return Origin(lat_deg=0.0, lon_deg=0.0, height_m=0.0, crs=crs)
    return None if settings.reference_origin is None else Origin(*settings.reference_origin)


def _alignment(settings: EvaluateSettings, trajectory: TrajectoryError | None) -> tuple[Similarity | None, str]:
    if settings.alignment == "none":
        return None, "compared as it is, without alignment"
    if trajectory is None:
        return None, "compared as it is: an alignment needs reference poses too"
    off = abs(trajectory.sim3.alignment.scale - 1)
    if settings.alignment == "similarity":
        return trajectory.sim3.alignment, "after a similarity alignment by the matched poses"
    if off < 0.1:  # further off it was never metric
        return trajectory.se3.alignment, "after a rigid alignment by the matched poses"
    how = f"the model's scale differs by {100 * off:.0f} %, so it was scaled too, by a similarity over the poses"
    return trajectory.sim3.alignment, how


def against_poses(
    match: PoseMatch, figures: Sequence[Figure], metric: bool, step_s: float = float("nan"), registered: float = 1.0
) -> list[str]:
    """Sentences about reference poses (K) that the model contradicts by ``figures`` (``accuracy.pose_figures``).

    ``metric``: the model's own scale is known; ``step_s``: between frames; ``registered``: share of the images.
    """
    by_key = {f.key: f for f in figures}
    whole, placed = by_key["shape.whole"], by_key.get("world.reference_poses")
    differ = "the reference poses and the model differ by"
    if beyond(whole):
        why = _explained(match, metric, step_s, registered >= _WHOLE)
        return [f"{differ} {_said(whole, metric)}: {why or 'one of the two is wrong by more than it says'}"]
    if placed is not None and beyond(placed):
        east, north, up = np.mean(match.estimate[:, :3, 3] - match.reference[:, :3, 3], axis=0)
        off = f"{east:+.2f} m east, {north:+.2f} m north, {up:+.2f} m up of it: another datum or origin?"
        text = "on the Earth, though their shapes agree: the model stands"
        return [f"{differ} {_said(placed, True)} {text} {off}"]
    return []


def against_cloud(figure: Figure) -> list[str]:
    """Sentences about a reference cloud that the cloud contradicts: half its points are farther than predicted."""
    why = "another frame or datum, or a place that has changed"
    text = f"the reference cloud and the cloud differ by {_said(figure, True)} (median): {why}"
    return [text] if beyond(figure) else []


def beyond(figure: Figure) -> bool:
    """Whether what was measured contradicts what was predicted; never where one of them is not known."""
    return figure.measured > LIMIT * figure.predicted


def _said(figure: Figure, metric: bool) -> str:
    return ", predicted ".join(_m(v) if metric else f"{v:.3g} units" for v in (figure.measured, figure.predicted))


def _explained(match: PoseMatch, metric: bool, step_s: float, whole: bool) -> str:
    """What of the reference would explain the difference better than chance does, in words; "" if nothing does."""
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    actual, free = _left(est, ref, metric), 3 * min(len(est), _COUNTED) - 7  # unknowns of a similarity
    if metric and fits_better(actual, _left(est, ref, False), free):
        return f"the reference is {umeyama(est, ref).scale:.4g} times as large as the model, {RARELY}"
    left, why = min(_hypotheses(match, metric, step_s, whole))
    return f"{why}, {RARELY}" if fits_better(actual, left, free) else ""


def _hypotheses(match: PoseMatch, metric: bool, step_s: float, whole: bool) -> Iterator[tuple[float, str]]:
    """(error left, what it would be) of a mirror image of a ``whole`` model, an axis of another scale, and a lag."""
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    if whole:
        text = "the reference is a mirror image: one of its axes is negated, or two are exchanged"
        yield _left(est, -ref, metric), text
    for axis in range(3):
        left, factor = _axis_scale(est, ref, axis, metric)
        text = f"the reference's {'xyz'[axis]} axis differs in scale, it is {1 / factor:.3g} times that of the others"
        yield left, text
    yield _lag(match, metric, step_s)


def _axis_scale(est: np.ndarray, ref: np.ndarray, axis: int, metric: bool) -> tuple[float, float]:
    """Error left and factor that an axis of the reference is to be multiplied by to agree best."""

    def left(log: float) -> float:
        return _left(est, ref * np.where(np.arange(3) == axis, 10**log, 1.0), metric)

    start = min(np.linspace(-4, 4, 33), key=left)  # over four decades up and down
    best = scipy.optimize.minimize_scalar(left, bounds=(start - 0.3, start + 0.3), method="bounded")
    return float(best.fun), float(10**best.x)


def _lag(match: PoseMatch, metric: bool, step_s: float) -> tuple[float, str]:
    """Error left with the reference moved along its own way by one number of frames."""
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    speed = np.zeros_like(ref)
    for rows in match.sequences():
        if len(rows) > 2:
            at = match.order[rows].astype(float)
            speed[rows] = np.gradient(ref[rows], np.maximum.accumulate(at + 1e-9 * np.arange(len(at))), axis=0)
    frames = 0.0
    for _ in range(3):  # alignment and lag in turn
        fit = umeyama(est, ref + frames * speed, with_scale=not metric)
        off = fit(est) - ref
        frames = float(np.sum(off * speed) / max(np.sum(speed**2), 1e-12))
    said = f"{frames:+.2f} frames" + (f" ({frames * step_s:+.3f} s)" if np.isfinite(step_s) else "")
    return _left(est, ref + frames * speed, metric), f"the reference's times are off by {said}"


def _left(est: np.ndarray, ref: np.ndarray, metric: bool) -> float:
    return rms_length(umeyama(est, ref, with_scale=not metric)(est) - ref)


def _m(value: float) -> str:
    if value >= 1000:
        return f"{value:.0f} m"
    return f"{value:.3g} m" if value >= 0.01 else f"{1000 * value:.2g} mm"


# Papers 000 and 001: a round trip through the images, named for what it is.
BACKPROJECTION = (
    "Back-projection error (paper 000, eq. 4-6): each point of the dense cloud is projected into the images, its "
    "position is rounded to the pixel, and the pixel is sent back into space with the depth of the same point. "
    "What is left is the rounding to whole pixels, about depth x 0.41 pixel / focal length. It is given because the "
    "papers give it. It says nothing about errors of the poses, drift, ghosts or completeness."
)
_ROUNDING_PX = (2 / 12) ** 0.5  # standard deviation of a uniform rounding to whole pixels in u and v together


def round_trip(points: np.ndarray, camera: Any, cam_from_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differences X_true - R^T (X_est - t) (M, 3) and depths (M,) of the points (N, 3) that an image shows.

    A point counts when it lies in front of the camera and inside the frame. Occlusion is not looked at, as in the
    paper. ``camera``: pycolmap's, as a pinhole without distortion: the round trip needs only K and the pose; leaving
    the distortion out shifts which points fall into the frame.
    """
    K = camera.calibration_matrix()
    x_cam = transforms.apply(cam_from_world, points)
    front = np.flatnonzero(x_cam[:, 2] > 1e-6)
    uvw = x_cam[front] @ K.T  # p = K X_c in homogeneous coordinates (eq. 4-5)
    uv = uvw[:, :2] / uvw[:, 2:]
    inside = np.all((uv >= 0) & (uv < [camera.width, camera.height]), axis=1)
    seen, uv = front[inside], uv[inside]
    # pixel (0, 0) is a corner: the pixel a point falls into is floor(u), its centre floor(u) + 0.5
    pixel = np.column_stack([np.floor(uv) + 0.5, np.ones(len(uv))])
    x_est = x_cam[seen, 2:] * (pixel @ np.linalg.inv(K).T)  # X_c = z_c K^-1 [u v 1]^T (eq. 5 solved)
    world_from_cam = transforms.invert(cam_from_world)  # R^T (X - t)
    return points[seen] - transforms.apply(world_from_cam, x_est), x_cam[seen, 2]


def backprojection_rmse(points: np.ndarray, model: Any, points_tried: int) -> tuple[float, float, int]:
    """Back-projection RMSE of a cloud (N, 3) over the images with a pose of a ``pycolmap.Reconstruction`` (paper 000,
    eq. 6), sqrt(1/N sum |X_true - R^T(X_est - t)|^2), the error that rounding alone predicts, both in metres, and N.

    See BACKPROJECTION. N counts every point once for each image that shows it; of a large cloud every n-th point is
    tried in an image, about ``points_tried``, other ones in the next. NaN when no image shows a point.
    """
    squares, rounding, count = 0.0, 0.0, 0
    step = max(1, len(points) // points_tried)
    for turn, image in enumerate(sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)):
        camera = model.cameras[image.camera_id]
        difference, z = round_trip(points[turn % step :: step], camera, matrix(image.cam_from_world()))
        squares, count = squares + float(np.sum(difference**2)), count + len(z)
        rounding += float(z @ z) * _ROUNDING_PX**2 / (camera.focal_length_x * camera.focal_length_y)
    rmse, expected = (float(np.sqrt(s / count)) if count else float("nan") for s in (squares, rounding))
    return rmse, expected, count
