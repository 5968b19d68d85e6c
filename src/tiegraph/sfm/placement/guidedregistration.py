"""What verified matches could not place, or hardly tie, is asked once more by guided matching."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.sfm.model import image_poses
from tiegraph.sfm.placement.guidedmatching import (
    Descriptors,
    ExpectedView,
    GuidedMatches,
    add_observations,
    guided_matches,
    rows_of,
)
from tiegraph.sfm.placement.missing import Unit, missing, register, tied_elsewhere
from tiegraph.sfm.placement.predictedpose import PredictedPose, predicted_pose
from tiegraph.sfm.placement.repair import Repair, around, fits, mounts
from tiegraph.sfm.placement.resection import Resection, resect
from tiegraph.sfm.tuning.placement import PlacementTuning
from tiegraph.sfm.verified import ImageObservations


@dataclass(frozen=True)
class GuidedResult:
    """Images placed and images tied more firmly, with how many points each sees now; why others stay missing."""

    placed: dict[int, int] = field(default_factory=dict)
    tied: dict[int, int] = field(default_factory=dict)
    why: dict[int, str] = field(default_factory=dict)


def guided_registration(
    work: Repair, image_ids: dict[int, int], descriptors: Descriptors, skip: frozenset[int]
) -> GuidedResult:
    """Place what is missing and tie what sees fewer than 10 points; changes the model of ``work``.

    ``image_ids``: COLMAP's, by scene index; ``skip``: keys of sensors whose own ties are not believed.
    """
    done = GuidedResult()
    for _ in range(work.tuning.guided.rounds):
        before = len(done.placed)
        _place_missing(work, image_ids, descriptors, done)
        if len(done.placed) == before:
            break
    _tie_weak(work, image_ids, descriptors, skip, done)
    return done


def _place_missing(work: Repair, image_ids: dict[int, int], descriptors: Descriptors, done: GuidedResult) -> None:
    scene, tuning = work.scene, work.tuning
    with_features = {k for k, xy in work.verified.xy.items() if len(xy)}
    away, lost = tied_elsewhere(work), dict(work.left_out)
    units = [u for u in missing(work, with_features) if u.frame not in lost and not away & set(u.images)]
    if not units:
        return
    here = around(work, work.seen())
    for unit in units:
        where = None
        if unit.bound or len(unit.images) == 1:
            where = predicted_pose(unit.frame, here.poses, work.preview, scene, tuning.predict)
        if where is None:
            done.why.update(dict.fromkeys(unit.images, "neither a coarse model nor neighbours say where it stands"))
            continue
        found = _search(work, unit, where, here.seen, descriptors)
        placed = resect(rows_of(found, work.verified, here.seen), *mounts(work, unit.images), tuning)
        if placed is None or not _holds(placed, where, tuning):
            agree = 0 if placed is None else placed.inliers
            text = (
                f"guided matching at the place that {where.by} give: {agree} points agree, "
                f"{tuning.resection.min_inliers} are needed"
            )
            done.why.update(dict.fromkeys(unit.images, text))
            continue
        if not fits(work, unit.images, placed.pose, here):
            text = "guided matching puts it off the course of its pass, and its verified matches do not hold it there"
            done.why.update(dict.fromkeys(unit.images, text))
            continue
        register(work, unit, placed.pose, image_ids)
        for one in found:
            done.placed[one.image] = add_observations(work.model, one, image_ids[one.image], tuning.guided.agree_px)
            done.why.pop(one.image, None)


def _search(
    work: Repair, unit: Unit, where: PredictedPose, seen: ImageObservations, descriptors: Descriptors
) -> list[GuidedMatches]:
    cameras, cam_from_rig = mounts(work, unit.images)
    out = []
    for k, camera in cameras.items():
        slack_px = max(where.slack_rad * camera.mean_focal_length(), work.tuning.guided.least_px)
        sight = ExpectedView(
            image=k, cam_from_world=cam_from_rig[k] @ transforms.invert(where.pose), camera=camera, slack_px=slack_px
        )
        out.append(guided_matches(sight, seen, work.verified, descriptors, work.tuning.guided))
    return out


def _holds(placed: Resection, where: PredictedPose, tuning: PlacementTuning) -> bool:
    turned = np.radians(float(transforms.angle_deg(placed.pose[:3, :3], where.pose[:3, :3])))
    return placed.holds(tuning.resection) and turned < tuning.guided.max_miss * where.slack_rad


def _tie_weak(
    work: Repair, image_ids: dict[int, int], descriptors: Descriptors, skip: frozenset[int], done: GuidedResult
) -> None:
    """Images that hang on the rig: they are searched for points where the rig says these are."""
    scene, model, tuning = work.scene, work.model, work.tuning.guided
    poses = image_poses(model, scene)
    weak = [
        k
        for k in np.flatnonzero(np.isfinite(poses).all(axis=(1, 2))).tolist()
        if model.image(image_ids[k]).num_points3D < tuning.min_points
        and int(scene.sensor_key[k]) not in skip
        and len(work.verified.xy.get(k, ()))
    ]
    if not weak:
        return
    seen = work.seen()
    for k in weak:
        sight = ExpectedView(
            image=k,
            cam_from_world=poses[k],
            camera=model.camera(model.image(image_ids[k]).camera_id),
            slack_px=tuning.near_px,
        )
        found = guided_matches(sight, seen, work.verified, descriptors, tuning)
        good = _off_px(found, sight, seen, work.verified.xy[k]) < tuning.agree_px
        if good.sum() >= tuning.min_points and good.mean() >= tuning.agree_share:
            added = add_observations(model, found, image_ids[k], tuning.agree_px)
            if added:
                done.tied[k] = int(model.image(image_ids[k]).num_points3D)


def _off_px(found: GuidedMatches, sight: ExpectedView, seen: ImageObservations, xy: np.ndarray) -> np.ndarray:
    """(K,) how far what was found lies from its place."""
    if not len(found.key):
        return np.zeros(0)
    local = transforms.apply(sight.cam_from_world, np.array([seen.xyz[int(p)] for p in found.point]))
    place_px = np.asarray(sight.camera.img_from_cam(local), float)
    return np.asarray(np.linalg.norm(place_px - xy[found.key], axis=1))
