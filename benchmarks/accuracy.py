"""What a model is worth against the truth: registered images, components, trajectory error, counted over all images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pycolmap

from benchmarks.datasets import Dataset, Mark, pose_centre
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin, geodetic_from_world, world_from_geodetic
from tiegraph.geometry.transforms import Similarity, robust_umeyama, umeyama
from tiegraph.scene.colmapmodel import agreeing_points
from tiegraph.scene.tuning import RegisteredTuning

WITHIN_M = (0.01, 0.05, 0.1, 0.3, 1.0)
"""Recall thresholds: share of ALL images (the unregistered count as missed) whose centre is nearer than this."""
_ROBUST_SIGMA_SHARE = 0.003
"""Sigma of the robust fit, as a share of the extent of the true path, at least 2 cm."""


def evaluate(models: list[Path], dataset: Dataset, world: Origin | None = None) -> dict[str, Any]:
    """Figures of the models (COLMAP folders, any order) of one run against the truth of ``dataset``.

    ``registered`` counts images that see points and agree with them, ``placed_by_rig`` the others that have a pose; the
    trajectory error is that of all poses.
    ``world``: origin of a georeferenced model; adds the error without any alignment. A model of fewer than three images
    with known truth has no trajectory error (None).
    """
    found = [pycolmap.Reconstruction(m) for m in models]
    held = {id(r): _registered(r) for r in found}
    reconstructions = sorted(found, key=lambda r: len(held[id(r)]), reverse=True)
    poses, registered = [_poses(r) for r in reconstructions], [held[id(r)] for r in reconstructions]
    everything = set().union(*registered) if poses else set()
    figures: dict[str, Any] = {
        "images": len(dataset.cam_from_world),
        "registered": len(everything),
        "components": len(poses),
        "placed_by_rig": len(set().union(*poses) - everything) if poses else 0,
        "largest": len(registered[0]) if poses else 0,
        "registered_in_models": [len(p) for p in registered],
        "registered_by_folder": dict(sorted(Counter(str(PurePosixPath(n).parent) for n in everything).items())),
    }
    if not poses:
        return {**figures, **trajectory_error({}, dataset.cam_from_world)}
    figures |= {
        "points": sum(r.num_points3D() for r in reconstructions),
        "reprojection_px": _number(reconstructions[0].compute_mean_reprojection_error()),
        "track_length": _number(reconstructions[0].compute_mean_track_length()),
    }
    figures |= trajectory_error(poses[0], dataset.cam_from_world)
    if dataset.marks:
        figures["marks"] = mark_error(reconstructions[0], dataset.marks)
    if world is not None and dataset.truth_origin is not None:
        figures |= _absolute_error(poses[0], dataset, world)
    return figures


def _registered(reconstruction: pycolmap.Reconstruction) -> set[str]:
    asked = RegisteredTuning()
    return {name for name, points in agreeing_points(reconstruction, asked).items() if points >= asked.min_points}


def _poses(reconstruction: pycolmap.Reconstruction) -> dict[str, np.ndarray]:
    out = {}
    for image in reconstruction.images.values():
        if image.has_pose:
            pose = image.cam_from_world()
            out[image.name] = transforms.rigid(pose.rotation.matrix(), pose.translation)
    return out


def trajectory_error(model: Mapping[str, np.ndarray], truth: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """ATE of one model's camera poses (name -> cam_from_world (4, 4)) against the truth.

    ``ate_m``: RMSE of the centres after the least-squares similarity (Umeyama), over the registered images;
    ``ate_rigid_m``: the same with the scale held at 1; ``robust``: medians and shares under the similarity that fits
    most images, where an unregistered image counts as infinitely far (median None: half of them are).
    """
    names = sorted(set(model) & set(truth))
    blank = {"ate_m": None, "ate_rigid_m": None, "scale": None, "rotation_median_deg": None}
    share = {f"{limit:g}": 0.0 for limit in WITHIN_M}
    if len(names) < 3:
        return {**blank, "robust": {"median_m": None, "median_of_all_m": None, "within_m": share}}
    source = np.stack([pose_centre(model[n]) for n in names])
    target = np.stack([pose_centre(truth[n]) for n in names])
    plain = umeyama(source, target)
    extent = float(np.linalg.norm(np.ptp(target, axis=0)))
    robust, _ = robust_umeyama(source, target, max(0.02, _ROBUST_SIGMA_SHARE * extent))
    error = np.linalg.norm(robust(source) - target, axis=1)
    of_all = np.full(len(truth), np.inf)
    of_all[: len(names)] = error
    return {
        "ate_m": _number(_rms(plain(source) - target)),
        "ate_rigid_m": _number(_rms(umeyama(source, target, with_scale=False)(source) - target)),
        "scale": _number(plain.scale),
        "rotation_median_deg": _rotation_median_deg(model, truth, names, robust),
        "robust": {
            "median_m": _number(np.median(error)),
            "median_of_all_m": _number(np.median(of_all)),
            "within_m": {key: float(np.mean(of_all < float(key))) for key in share},
        },
    }


def _rotation_median_deg(
    model: Mapping[str, np.ndarray], truth: Mapping[str, np.ndarray], names: list[str], fit: Similarity
) -> float | None:
    a = np.stack([model[n][:3, :3] for n in names]) @ fit.rotation.T
    b = np.stack([truth[n][:3, :3] for n in names])
    known = np.isfinite(b).all(axis=(1, 2))
    return _number(np.median(transforms.angle_deg(a[known], b[known]))) if known.any() else None


def _absolute_error(model: Mapping[str, np.ndarray], dataset: Dataset, world: Origin) -> dict[str, Any]:
    """Error of the georeferenced centres, with no alignment at all."""
    names = sorted(set(model) & set(dataset.cam_from_world))
    truth_enu = np.stack([pose_centre(dataset.cam_from_world[n]) for n in names])
    assert dataset.truth_origin is not None
    target = world_from_geodetic(geodetic_from_world(truth_enu, dataset.truth_origin), world)
    difference = np.stack([pose_centre(model[n]) for n in names]) - target
    return {
        "absolute_rmse_m": _number(_rms(difference)),
        "absolute_median_m": _number(np.median(np.linalg.norm(difference, axis=1))),
        "absolute_mean_enu_m": [_number(v) for v in difference.mean(axis=0)],
    }


def mark_error(model: pycolmap.Reconstruction, marks: tuple[Mark, ...]) -> dict[str, Any]:
    """Surveyed points, intersected from the rays of their marks: how well the rays meet, and the scale.

    ``median_px`` is the distance of the marks from the projection of their intersected point; ``scale`` is the surveyed
    length over the model's (1 = metric), None below two points; ``rmse_m`` that of the points after the least-squares
    similarity, None below four.
    """
    images = {image.name: image for image in model.images.values() if image.has_pose}
    seen: dict[tuple[float, float, float], list[Mark]] = {}
    for mark in marks:
        if mark.image in images:
            seen.setdefault(mark.surveyed_m, []).append(mark)
    seen = {point: rows for point, rows in seen.items() if len(rows) >= 2}
    placed = {point: _intersect(rows, images) for point, rows in seen.items()}
    residuals = [_residual_px(mark, images[mark.image], placed[p]) for p, rows in seen.items() for mark in rows]
    surveyed, found = np.array(list(placed)), np.array(list(placed.values()))
    spread = [float(np.linalg.norm(x - x.mean(axis=0))) for x in (surveyed, found)] if len(placed) > 1 else None
    return {
        "points": len(placed),
        "marks": len(residuals),
        "median_px": _number(np.median(residuals)) if residuals else None,
        "scale": spread[0] / spread[1] if spread else None,
        "rmse_m": _number(_rms(umeyama(found, surveyed)(found) - surveyed)) if len(placed) > 3 else None,
    }


def _intersect(marks: list[Mark], images: dict[str, pycolmap.Image]) -> np.ndarray:
    """Point (3,) nearest to the rays of the marks; the rays are weighted anew by their distance from it (L1)."""
    centres, normals = [], []
    for mark in marks:
        image = images[mark.image]
        assert image.camera is not None
        ray = np.append(image.camera.cam_from_img(mark.pixel(image.camera)), 1.0)
        direction = image.cam_from_world().rotation.matrix().T @ (ray / np.linalg.norm(ray))
        centres.append(image.projection_center())
        normals.append(np.eye(3) - np.outer(direction, direction))
    c, n, weight = np.stack(centres), np.stack(normals), np.ones(len(marks))
    for _ in range(20):
        a = np.einsum("k,kij->ij", weight, n)
        point = np.linalg.solve(a, np.einsum("k,kij,kj->i", weight, n, c))
        off = np.linalg.norm(np.einsum("kij,kj->ki", n, point - c), axis=1)
        weight = 1 / np.maximum(off, 0.01 * np.median(off) + 1e-12)
    return point


def _residual_px(mark: Mark, image: pycolmap.Image, point: np.ndarray) -> float:
    projected = image.project_point(point)
    return float("inf") if projected is None else float(np.linalg.norm(projected - mark.pixel(image.camera)))


def _rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
