"""Everything the evaluate stage states about a run: from a model, a cloud and references to metrics.json."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.evaluate import backprojection, reference
from tiegraph.evaluate.accuracy import Predicted, Stated, cloud_figure, in_layers, pose_figures
from tiegraph.evaluate.backprojection import View, backprojection_rmse
from tiegraph.evaluate.cloud import cloud_to_cloud, thin
from tiegraph.evaluate.contradictions import against_cloud, against_poses
from tiegraph.evaluate.metrics import metrics_to_dict
from tiegraph.evaluate.reference import ModelPoses
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.evaluate.tolerance import answered
from tiegraph.evaluate.trajectory import TrajectoryError, evaluate_trajectory, registered_metrics, registered_table
from tiegraph.evaluate.tuning import Tuning
from tiegraph.geometry.align import Similarity
from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.accuracy import Figure
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.registered import Registration
from tiegraph.scene.results import Cloud, Metric
from tiegraph.scene.scene import Scene


@dataclass
class _Findings:
    metrics: list[Metric] = field(default_factory=list)
    tables: dict[str, dict] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    contradictions: list[str] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Products:
    """What a run made: ``model`` a pycolmap reconstruction in the world frame, ``images`` which of the scene's are
    registered in it, the cloud, and the world's origin (None: the model's own frame)."""

    model: Any
    images: Registration
    cloud: Cloud | None
    origin: Origin | None = None


@dataclass(frozen=True, eq=False)
class _Work:
    scene: Scene
    model: ModelPoses
    settings: EvaluateSettings
    tuning: Tuning
    origin: Origin | None
    predicted: Predicted
    found: _Findings


def evaluate_survey(
    scene: Scene, made: Products, settings: EvaluateSettings, tuning: Tuning, stated: Stated | None = None
) -> dict[str, Any]:
    """The content of metrics.json for a run.

    ``stated``: what the run says of itself, which its references are held against. Raises InputError for references
    that cannot be read or matched.
    """
    found, cloud, stated = _Findings(), made.cloud, stated or Stated()
    model = reference.model_poses(made.model, scene)
    work = _Work(
        scene=scene,
        model=model,
        settings=settings,
        tuning=tuning,
        origin=made.origin,
        predicted=stated.predicted,
        found=found,
    )
    found.metrics.extend(registered_metrics(made.images))
    found.tables.update(registered_table(made.images, scene.image_label(), scene.section[scene.frame]))
    if cloud is not None and len(cloud):
        # Against its own points a camera model without depth maps says the same, and needs no reading of them.
        result = backprojection_rmse(cloud, pinhole_views(made.model), tuning.points_tried)
        found.metrics.extend(result.metrics())
        found.notes.append(backprojection.MEANING)
    trajectory = None if settings.reference is None else _trajectory(work, settings.reference)
    if settings.reference_cloud is not None and cloud is not None and len(cloud):
        _cloud(work, cloud, settings.reference_cloud, trajectory)
    accuracy = in_layers(stated, found.figures)
    if settings.tolerance_m is not None:
        contradicted = bool(found.contradictions or stated.world.get("contradictions"))
        answer = answered(settings.tolerance_m, accuracy, stated, contradicted, tuning.min_checks)
        accuracy = replace(accuracy, answer=answer)
    return metrics_to_dict(found.metrics, found.tables, found.notes, found.contradictions, accuracy)


def pinhole_views(reconstruction: Any) -> list[View]:
    """The images with a pose as pinholes without distortion, when no depth maps are there.

    The round trip needs only K and the pose; leaving the distortion out shifts which points fall into the frame.
    """
    views = []
    for image in reconstruction.images.values():
        if image.has_pose:
            camera = reconstruction.cameras[image.camera_id]
            views.append(
                View(
                    name=image.name,
                    K=camera.calibration_matrix(),
                    cam_from_world=matrix(image.cam_from_world()),
                    width=camera.width,
                    height=camera.height,
                )
            )
    return sorted(views, key=lambda v: v.name)


def _trajectory(work: _Work, path: Path) -> TrajectoryError:
    """Reference poses against the model's."""
    settings, tuning, origin, found = work.settings, work.tuning, work.origin, work.found
    poses = reference.read_reference_poses(path)
    match, said = reference.match_poses(poses, work.model, work.scene, tuning.trajectory.max_gap_s)
    comparable = settings.reference_origin is not None and origin is not None
    if settings.reference_origin is not None and origin is not None:
        match = reference.poses_to_world(match, reference.enu_origin(settings.reference_origin), origin)
    try:
        distances = tuning.trajectory.relative_m
        result = evaluate_trajectory(match, distances, tuning.trajectory, same_frame=comparable)
    except np.linalg.LinAlgError as error:
        raise InputError(f"{path}: the poses cannot be aligned: {error}") from None
    found.metrics.extend(result.metrics())
    found.tables.update(result.tables())
    found.notes.append(f"Reference poses {path.name}: {said}.")
    figures, metric = pose_figures(match, result, work.predicted, tuning.trajectory), work.predicted.metric
    found.figures += figures
    found.contradictions += against_poses(match, figures, metric, tuning.judge, _step_s(work.scene))
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


def _cloud(work: _Work, cloud: Cloud, path: Path, trajectory: TrajectoryError | None) -> None:
    """A reference cloud against the run's."""
    settings, tuning, origin, found = work.settings, work.tuning, work.origin, work.found
    points, crs = reference.read_points(path, tuning.cloud.read_points)
    source = _origin_of(settings, crs)
    if source is not None and origin is not None and len(points):
        # thinned first: the way through geodetic coordinates costs more than the comparison
        thinned, _ = thin(points, min(settings.distances_m) / 2, tuning.cloud)
        points = reference.to_world(thinned, source, origin)
    alignment, how = _alignment(settings, trajectory, tuning.unscaled_share)
    centres = work.model.centres()
    try:
        result = cloud_to_cloud(cloud, points, tuning.cloud, settings.distances_m, alignment, centres, settings.range_m)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    found.metrics.extend(result.metrics())
    found.tables.update(result.tables())
    figure = cloud_figure(result, points, work.predicted, alignment is not None, tuning.judge.spacing_samples)
    found.figures.append(figure)
    found.contradictions += against_cloud(figure, tuning.judge)
    share = f"{100 * result.judged.outside:.0f} % of the cloud lie outside the reference's outline and are not judged."
    found.notes.append(f"Reference cloud {path.name}, {how}. {result.criteria.meaning} {share}")


def _origin_of(settings: EvaluateSettings, crs: str | None) -> Origin | None:
    if settings.reference_origin is not None:
        return reference.enu_origin(settings.reference_origin)
    return None if crs is None else Origin(lat_deg=0.0, lon_deg=0.0, height_m=0.0, crs=crs)


def _alignment(
    settings: EvaluateSettings, trajectory: TrajectoryError | None, unscaled_share: float
) -> tuple[Similarity | None, str]:
    if settings.alignment == "none":
        return None, "compared as it is, without alignment"
    if trajectory is None:
        return None, "compared as it is: an alignment needs reference poses too"
    off = abs(trajectory.sim3.alignment.scale - 1)
    if settings.alignment == "rigid" and off < unscaled_share:
        return trajectory.se3.alignment, "after a rigid alignment by the matched poses"
    if settings.alignment == "rigid":
        how = f"the model's scale differs by {100 * off:.0f} %, so it was scaled too, by a similarity over the poses"
        return trajectory.sim3.alignment, how
    return trajectory.sim3.alignment, "after a similarity alignment by the matched poses"
