"""The verified matches of a database, and which of them a model explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.rays import cross
from tiegraph.scene.colmapdatabase import Rows, image_ids
from tiegraph.scene.colmapmodel import matrix, registered_images
from tiegraph.scene.rays import rays_or_axis
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.placement import AgreementTuning


@dataclass(frozen=True)
class VerifiedMatches:
    """Image pairs (P, 2), scene indices, low first, their matches (M, 2) and the images' key points (K, 2) px."""

    pairs: np.ndarray
    matches: tuple[np.ndarray, ...]
    xy: dict[int, np.ndarray]

    def where(self, rows: np.ndarray) -> VerifiedMatches:
        """Some of the pairs (boolean or index array)."""
        chosen = np.flatnonzero(rows) if rows.dtype == bool else rows
        return VerifiedMatches(self.pairs[chosen], tuple(self.matches[k] for k in chosen), self.xy)


def read_verified(database: Path, scene: Scene, refused: Sequence[tuple[int, int]] = ()) -> VerifiedMatches:
    """All verified matches but those of refused pairs (scene indices)."""
    away = {(min(p), max(p)) for p in refused}
    index = {image_id: k for k, image_id in image_ids(database, scene).items()}
    with Rows(database) as rows:
        found: dict[tuple[int, int], np.ndarray] = {}
        for a, b, matches in rows.verified():
            ends = index.get(a), index.get(b)
            if ends[0] is None or ends[1] is None:
                continue
            key = (min(ends[0], ends[1]), max(ends[0], ends[1]))
            if key not in away:
                found[key] = matches if ends[0] < ends[1] else matches[:, ::-1]
        xy = {index[image_id]: points for image_id, points in rows.keypoints() if image_id in index}
    pairs = np.array(sorted(found), int).reshape(-1, 2)
    return VerifiedMatches(pairs, tuple(found[int(a), int(b)] for a, b in pairs), xy)


@dataclass(frozen=True)
class ImageObservations:
    """What the images of a model know: camera, pose, point of each key point (-1 = none), reach (nearest, farthest);
    and ``tuning``: by what their matches are judged."""

    cameras: dict[int, pycolmap.Camera]  # by scene index
    cam_from_world: dict[int, np.ndarray]
    point: dict[int, np.ndarray]
    reach: dict[int, np.ndarray]
    xyz: dict[int, np.ndarray]
    tuning: AgreementTuning


def image_observations(model: pycolmap.Reconstruction, scene: Scene, tuning: AgreementTuning) -> ImageObservations:
    """The registered images of a model that the scene knows."""
    xyz = {int(k): p.xyz for k, p in model.points3D.items()}
    cameras, poses, point, reach = {}, {}, {}, {}
    for k, image in registered_images(model, scene):
        cameras[k] = model.camera(image.camera_id)
        poses[k] = matrix(image.cam_from_world())
        point[k] = np.full(image.num_points2D(), -1)
        point[k][image.get_observation_point2D_idxs()] = [p.point3D_id for p in image.get_observation_points2D()]
        own = np.array([xyz[int(p)] for p in point[k][point[k] >= 0]]).reshape(-1, 3)
        if len(own) >= tuning.least_matches:
            depth = np.linalg.norm(transforms.apply(poses[k], own), axis=1)
            reach[k] = np.percentile(depth, tuning.reach_percent)
    return ImageObservations(cameras=cameras, cam_from_world=poses, point=point, reach=reach, xyz=xyz, tuning=tuning)


def agreement(verified: VerifiedMatches, seen: ImageObservations) -> np.ndarray:
    """(P, 2): matches of each pair that the model's poses explain, and all of them, both capped; 0, 0 = no opinion."""
    tuning = seen.tuning
    rays: dict[int, np.ndarray] = {}

    def of(k: int) -> np.ndarray:
        if k not in rays:
            rays[k] = rays_or_axis(seen.cameras[k], verified.xy[k])
        return rays[k]

    usual = np.median(list(seen.reach.values()), axis=0) if seen.reach else np.array([0.0, np.inf])
    out = np.zeros((len(verified.pairs), 2))
    for row, ((i, j), matches) in enumerate(zip(verified.pairs.tolist(), verified.matches)):
        if i not in seen.cameras or j not in seen.cameras or len(matches) < tuning.least_matches:
            continue
        j_from_i = seen.cam_from_world[j] @ transforms.invert(seen.cam_from_world[i])
        far = (seen.reach.get(i, usual), seen.reach.get(j, usual))
        share = float(np.mean(_explained(of(i)[matches[:, 0]], of(j)[matches[:, 1]], j_from_i, far, tuning)))
        out[row] = min(len(matches), tuning.matches_a_pair) * np.array([share, 1.0])
    return out


def _explained(
    a: np.ndarray, b: np.ndarray, b_from_a: np.ndarray, reach: Sequence[np.ndarray], tuning: AgreementTuning
) -> np.ndarray:
    """(M,) bool: rays a and b (M, 3) meet, ahead of both and within reach (or far off, without parallax)."""
    turned = a @ b_from_a[:3, :3].T
    step = b_from_a[:3, 3]
    normal = cross(turned, b)
    squared = np.maximum(np.sum(normal**2, axis=1), 1e-18)
    # turned * s + step = b * t in least squares
    s = np.sum(cross(b, step[None]) * normal, axis=1) / squared
    t = np.sum(cross(turned, step[None]) * normal, axis=1) / squared
    gap = np.linalg.norm(turned * s[:, None] + step - b * t[:, None], axis=1)
    tolerance = tuning.tolerance_rad
    meets = gap < tolerance * np.maximum(np.abs(s), np.abs(t))
    near = np.array([reach[0][0], reach[1][0]]) / tuning.reach
    far = np.array([reach[0][1], reach[1][1]]) * tuning.reach
    inside = (s > near[0]) & (s < far[0]) & (t > near[1]) & (t < far[1])
    parallel = (np.sqrt(squared) < tolerance) & (np.sum(turned * b, axis=1) > 0)
    parallel &= np.linalg.norm(step) < tolerance * tuning.parallax * max(far)
    return (meets & inside) | parallel
