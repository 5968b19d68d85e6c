"""Everything the evaluate stage states about a run: from a model, a cloud and references to metrics.json."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.evaluate import backprojection, reference
from tiegraph.evaluate.backprojection import View, backprojection_rmse
from tiegraph.evaluate.cloud import cloud_to_cloud, thin
from tiegraph.evaluate.judge import Predicted, against_cloud, against_poses
from tiegraph.evaluate.metrics import metrics_to_dict
from tiegraph.evaluate.reference import ModelPoses
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.evaluate.trajectory import TrajectoryError, evaluate_trajectory, registered_metrics, registered_table
from tiegraph.geometry.align import Similarity
from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.registered import registration
from tiegraph.scene.results import Cloud, DepthMap, Metric
from tiegraph.scene.scene import Scene

_UNSCALED = 0.1  # a model whose scale is further off than this share was never metric


@dataclass
class _Findings:
    metrics: list[Metric] = field(default_factory=list)
    tables: dict[str, dict] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    contradictions: list[str] = field(default_factory=list)


def evaluate_survey(
    scene: Scene,
    reconstruction: Any,
    cloud: Cloud | None,
    views: Iterable[View | DepthMap] | None,
    settings: EvaluateSettings,
    origin: Origin | None = None,
    predicted: Predicted | None = None,
) -> dict[str, Any]:
    """The content of metrics.json for a run.

    ``reconstruction``: pycolmap model in the world frame; ``views``: undistorted images (or their depth maps) for the
    back-projection, None = the model's images as pinholes; ``origin``: the world's (None: the model's own frame);
    ``predicted``: the run's own sigmas, which its references are held against.
    Raises InputError for references that cannot be read or matched.
    """
    found = _Findings()
    model = reference.model_poses(reconstruction, scene)
    images = registration(reconstruction, scene)
    found.metrics.extend(registered_metrics(images))
    found.tables.update(registered_table(images, scene.image_label(), scene.section[scene.frame]))
    if cloud is not None and len(cloud):
        result = backprojection_rmse(cloud, pinhole_views(reconstruction) if views is None else views)
        found.metrics.extend(result.metrics())
        found.notes.append(backprojection.MEANING)
    trajectory = None
    if settings.reference is not None:
        trajectory = _trajectory(scene, model, settings, origin, predicted or Predicted(), found)
    if settings.reference_cloud is not None and cloud is not None and len(cloud):
        _cloud(cloud, model, settings, origin, trajectory, predicted or Predicted(), found)
    return metrics_to_dict(found.metrics, found.tables, found.notes, found.contradictions)


def pinhole_views(reconstruction: Any) -> list[View]:
    """The images with a pose as pinholes without distortion, when no depth maps are there.

    The round trip needs only K and the pose; leaving the distortion out shifts which points fall into the frame.
    """
    views = []
    for image in reconstruction.images.values():
        if image.has_pose:
            camera = reconstruction.cameras[image.camera_id]
            pose = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
            views.append(View(image.name, camera.calibration_matrix(), pose, camera.width, camera.height))
    return sorted(views, key=lambda v: v.name)


def _trajectory(
    scene: Scene,
    model: ModelPoses,
    settings: EvaluateSettings,
    origin: Origin | None,
    predicted: Predicted,
    found: _Findings,
) -> TrajectoryError:
    assert settings.reference is not None
    match, said = reference.match_poses(reference.read_reference_poses(settings.reference), model, scene)
    comparable = settings.reference_origin is not None and origin is not None
    if settings.reference_origin is not None and origin is not None:
        match = reference.poses_to_world(match, reference.enu_origin(settings.reference_origin), origin)
    try:
        result = evaluate_trajectory(match, settings.rpe_m, same_frame=comparable)
    except np.linalg.LinAlgError as error:
        raise InputError(f"{settings.reference}: the poses cannot be aligned: {error}") from None
    found.metrics.extend(result.metrics())
    found.tables.update(result.tables())
    found.notes.append(f"Reference poses {settings.reference.name}: {said}.")
    found.contradictions += against_poses(match, result, predicted, _step_s(scene))
    if comparable:
        found.notes.append("absolute_rmse compares positions in the same CRS without any alignment.")
    else:
        found.notes.append("No absolute error: the reference has no stated origin, or the model is not georeferenced.")
    return result


def _step_s(scene: Scene) -> float:
    """Median time between frames of a pass, NaN without times."""
    order = np.lexsort((scene.step, scene.track))
    step = np.diff(scene.time_s[order])[np.diff(scene.track[order]) == 0]
    step = step[np.isfinite(step)]
    return float(np.median(step)) if len(step) else float("nan")


def _cloud(
    cloud: Cloud,
    model: ModelPoses,
    settings: EvaluateSettings,
    origin: Origin | None,
    trajectory: TrajectoryError | None,
    predicted: Predicted,
    found: _Findings,
) -> None:
    path = settings.reference_cloud
    assert path is not None
    points, crs = reference.read_points(path)
    source = _origin_of(settings, crs)
    if source is not None and origin is not None and len(points):
        # thinned first: the way through geodetic coordinates costs more than the comparison
        points = reference.to_world(thin(points, min(settings.distances_m) / 2)[0], source, origin)
    alignment, how = _alignment(settings, trajectory)
    try:
        result = cloud_to_cloud(cloud, points, settings.distances_m, alignment, model.centres(), settings.range_m)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    found.metrics.extend(result.metrics())
    found.tables.update(result.tables())
    found.contradictions += against_cloud(result, points, predicted, alignment is not None)
    share = f"{100 * result.outside:.0f} % of the cloud lie outside the reference's outline and are not judged."
    found.notes.append(f"Reference cloud {path.name}, {how}. {result.meaning} {share}")


def _origin_of(settings: EvaluateSettings, crs: str | None) -> Origin | None:
    if settings.reference_origin is not None:
        return reference.enu_origin(settings.reference_origin)
    return None if crs is None else Origin(0.0, 0.0, 0.0, crs)


def _alignment(settings: EvaluateSettings, trajectory: TrajectoryError | None) -> tuple[Similarity | None, str]:
    if settings.alignment == "none":
        return None, "compared as it is, without alignment"
    if trajectory is None:
        return None, "compared as it is: an alignment needs reference poses too"
    off = abs(trajectory.sim3.scale - 1)
    if settings.alignment == "rigid" and off < _UNSCALED:
        return trajectory.rigid, "after a rigid alignment by the matched poses"
    if settings.alignment == "rigid":
        how = f"the model's scale differs by {100 * off:.0f} %, so it was scaled too, by a similarity over the poses"
        return trajectory.similarity, how
    return trajectory.similarity, "after a similarity alignment by the matched poses"
