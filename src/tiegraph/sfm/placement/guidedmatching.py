"""Guided matching: the key points of an image that has no place, or sees nothing, against the points it should see.

Matching without geometry compares every key point of an image with every one of another, and keeps what is far better
than the second best: on walls that repeat, under other light, nothing is. Where a pose is predicted, a point of the
model must lie within some pixels of one place; there it has few rivals for the ratio test (Lowe 2004, section 7.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms
from tiegraph.scene.colmapdatabase import Rows as Database
from tiegraph.scene.colmapmodel import matrix
from tiegraph.sfm.placement.resection import Correspondences
from tiegraph.sfm.tuning.placement import GuidedTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches

_MOST_HELD = 48  # images whose descriptors are kept: memory


@dataclass
class Descriptors:
    """SIFT descriptors of a database, read when asked for. ``of(k)``: (K, 128) f4 of unit length, by scene index."""

    database: Path
    ids: dict[int, int]  # COLMAP's image ids by scene index
    _held: dict[int, np.ndarray] = field(default_factory=dict)

    def of(self, image: int) -> np.ndarray:
        """Of an image; none if the database holds none."""
        if image not in self._held:
            with Database(self.database) as rows:
                table = rows.descriptors_of(self.ids.get(image, -1)).astype(np.float32)
            if len(self._held) > _MOST_HELD:
                self._held.clear()
            self._held[image] = table / np.maximum(np.linalg.norm(table, axis=1, keepdims=True), 1e-6)
        return self._held[image]


@dataclass(frozen=True)
class GuidedMatches:
    """Key points of one image and points of the model that look alike where they should: image, key (K,), point (K,)
    ids, partner (K,) image whose descriptor it was."""

    image: int
    key: np.ndarray
    point: np.ndarray
    partner: np.ndarray


@dataclass(frozen=True)
class ExpectedView:
    """Where an image is thought to look from: cam_from_world (4, 4), its camera, and how far off points may then be."""

    image: int
    cam_from_world: np.ndarray
    camera: pycolmap.Camera
    slack_px: float


def guided_matches(
    sight: ExpectedView,
    seen: ImageObservations,
    verified: VerifiedMatches,
    descriptors: Descriptors,
    tuning: GuidedTuning,
) -> GuidedMatches:
    """Search the key points of an image for points of the model, near where its pose puts them."""
    image, cam_from_world, camera, slack_px = sight.image, sight.cam_from_world, sight.camera, sight.slack_px
    none = np.zeros(0, np.int64)
    xy = verified.xy.get(image, np.zeros((0, 2)))
    own = descriptors.of(image)
    point, partner, look = _expected(image, cam_from_world, seen, descriptors, tuning)
    if not len(xy) or len(own) != len(xy) or not len(point):
        return GuidedMatches(image=image, key=none, point=none, partner=none)
    local = transforms.apply(cam_from_world, np.array([seen.xyz[int(p)] for p in point]))
    ahead = local[:, 2] > 1e-6
    place = np.full((len(point), 2), np.nan)
    place[ahead] = np.asarray(camera.img_from_cam(local[ahead]), float)
    inside = (place > -slack_px).all(axis=1) & (place < [camera.width + slack_px, camera.height + slack_px]).all(axis=1)
    rows = np.flatnonzero(inside)
    near = cKDTree(xy).query_ball_point(place[rows], slack_px) if len(rows) else []
    best = _best(rows, near, own, look, xy, tuning)
    return GuidedMatches(image=image, key=best[:, 1], point=point[best[:, 0]], partner=partner[best[:, 0]])


def _expected(
    image: int, cam_from_world: np.ndarray, seen: ImageObservations, descriptors: Descriptors, tuning: GuidedTuning
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (K,) that images near and turned alike see, one image (K,) that sees each, and its descriptors there."""
    others = np.array([k for k in seen.point if k != image and len(seen.point[k])], int)
    empty = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 128), np.float32)
    if not len(others):
        return empty
    poses = np.stack([seen.cam_from_world[int(k)] for k in others])
    alike = poses[:, 2, :3] @ cam_from_world[2, :3] > np.cos(np.radians(tuning.turn_deg))
    distance = np.linalg.norm(transforms.centre(poses) - transforms.centre(cam_from_world), axis=1)
    usual = np.median(list(seen.reach.values()), axis=0) if seen.reach else np.array([0.0, np.inf])
    chosen = np.flatnonzero(alike & (distance < seen.tuning.reach * usual[1]))
    chosen = chosen[np.argsort(distance[chosen], kind="stable")[: tuning.partners]]
    points, partners, looks = [], [], []
    taken: set[int] = set()
    for k in others[chosen].tolist():
        keys = np.flatnonzero(seen.point[k] >= 0)
        table = descriptors.of(k)
        fresh = [n for n in keys.tolist() if int(seen.point[k][n]) not in taken and n < len(table)]
        taken |= {int(seen.point[k][n]) for n in fresh}
        points.append(seen.point[k][fresh])
        partners.append(np.full(len(fresh), k))
        looks.append(table[fresh])
    if not points:
        return empty
    return np.concatenate(points), np.concatenate(partners), np.concatenate(looks)


def _best(
    rows: np.ndarray,
    near: Sequence[Sequence[int]],
    own: np.ndarray,
    look: np.ndarray,
    xy: np.ndarray,
    tuning: GuidedTuning,
) -> np.ndarray:
    """(K, 2) row of a point and key point that are each other's best, clearly so."""
    found: dict[int, tuple[float, int]] = {}
    for row, keys in zip(rows.tolist(), near):
        if not keys:
            continue
        angle = np.arccos(np.clip(own[keys] @ look[row], -1, 1))
        first, key = float(angle.min()), int(keys[int(np.argmin(angle))])
        rivals = angle[np.linalg.norm(xy[keys] - xy[key], axis=1) > tuning.same_px]
        if first > tuning.max_angle_rad or (len(rivals) and first > tuning.ratio * float(rivals.min())):
            continue
        if key not in found or first < found[key][0]:
            found[key] = (first, row)
    return np.array([(row, key) for key, (_, row) in found.items()], np.int64).reshape(-1, 2)


def rows_of(found: Sequence[GuidedMatches], verified: VerifiedMatches, seen: ImageObservations) -> Correspondences:
    """What the search found of the images of one frame, as correspondences for ``place``."""
    image = np.concatenate([np.full(len(f.key), f.image) for f in found] + [np.zeros(0, int)]).astype(int)
    xy = np.concatenate([verified.xy[f.image][f.key] for f in found if len(f.key)] + [np.zeros((0, 2))])
    points = [seen.xyz[int(p)] for f in found for p in f.point]
    partner = np.concatenate([f.partner for f in found] + [np.zeros(0, int)]).astype(int)
    return Correspondences(image=image, xy=xy, xyz=np.array(points).reshape(-1, 3), partner=partner)


def add_observations(model: pycolmap.Reconstruction, found: GuidedMatches, image_id: int, max_error_px: float) -> int:
    """Add what was found to the points' tracks, where the image's pose agrees; how many."""
    image = model.image(image_id)
    pose = matrix(image.cam_from_world())
    added = 0
    for key, point in zip(found.key.tolist(), found.point.tolist()):
        if point not in model.points3D or image.point2D(key).has_point3D():
            continue
        local = transforms.apply(pose, model.points3D[point].xyz[None])
        if local[0, 2] <= 0:
            continue
        off = np.asarray(model.camera(image.camera_id).img_from_cam(local), float)[0] - image.point2D(key).xy
        if float(np.linalg.norm(off)) < max_error_px:
            model.add_observation(point, pycolmap.TrackElement(image_id, key))
            added += 1
    return added
