"""The verified matches of a database, and which of them a model explains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    """What the images of a model know: camera, pose, row of the point of each key point (-1 = none), reach (nearest,
    farthest) by scene index; the points ``xyz`` (P, 3), how many ``frames`` (P,) see each, and which (``seen``, sorted
    numbers of point and frame in one); and ``tuning``: by what their matches are judged."""

    cameras: dict[int, pycolmap.Camera]
    cam_from_world: dict[int, np.ndarray]
    point: dict[int, np.ndarray]
    reach: dict[int, np.ndarray]
    xyz: np.ndarray
    frames: np.ndarray
    seen: np.ndarray
    frame: np.ndarray  # (N,) of each image of the scene
    tuning: AgreementTuning

    def elsewhere(self, image: int, point: np.ndarray) -> np.ndarray:
        """(K,) how many frames beside that of an image see points (rows, -1 = none: 0)."""
        key = point * len(self.frame) + self.frame[image]
        own = np.searchsorted(self.seen, key, side="right") > np.searchsorted(self.seen, key)
        return np.where(point >= 0, self.frames[point] - own, 0)


def image_observations(model: pycolmap.Reconstruction, scene: Scene, tuning: AgreementTuning) -> ImageObservations:
    """The registered images of a model that the scene knows."""
    ids = np.array(sorted(model.point3D_ids()), np.int64)
    xyz = np.array([model.point3D(int(k)).xyz for k in ids]).reshape(-1, 3)
    cameras, poses, point, reach, keys = {}, {}, {}, {}, [np.zeros(0, np.int64)]
    for k, image in registered_images(model, scene):
        cameras[k] = model.camera(image.camera_id)
        poses[k] = matrix(image.cam_from_world())
        point[k] = np.full(image.num_points2D(), -1)
        rows = np.searchsorted(ids, [p.point3D_id for p in image.get_observation_points2D()])
        point[k][image.get_observation_point2D_idxs()] = rows
        keys.append(rows * len(scene) + scene.frame[k])
        if len(rows) >= tuning.least_matches:
            depth = np.linalg.norm(transforms.apply(poses[k], xyz[rows]), axis=1)
            reach[k] = np.percentile(depth, tuning.reach_percent)
    seen = np.unique(np.concatenate(keys).astype(np.int64))
    frames = np.bincount(seen // len(scene), minlength=max(len(ids), 1))
    return ImageObservations(cameras, poses, point, reach, xyz, frames, seen, scene.frame, tuning)


def agreement(verified: VerifiedMatches, seen: ImageObservations) -> np.ndarray:
    """(P, 3): matches of each pair that the model explains, as its first and as its second image tell, and all of
    them, all capped; 0, 0, 0 = no opinion.

    Where a match belongs to a point that two frames beside the image's see, that must lie where the key point is: two
    rays alone meet wherever one image slides along the line to the other. They are asked where no such point tells and
    none speaks against the key point.
    """
    out = np.zeros((len(verified.pairs), 3))
    count = np.array([len(m) for m in verified.matches], int)
    known = np.isin(verified.pairs, list(seen.cameras)).all(axis=1)
    rows = np.flatnonzero(known & (count >= seen.tuning.least_matches))
    if not len(rows):
        return out
    keys = _KeyPoints(verified, seen)
    at = np.concatenate([verified.matches[k] + keys.start[verified.pairs[k]] for k in rows])
    pair = np.repeat(rows, count[rows])
    told = np.stack([_in_parts(keys.at_points, at[:, end], at[:, 1 - end]) for end in (0, 1)])
    yes, asked = (np.bincount(at.T[of], minlength=len(keys.point)) for of in (told == 1, told >= 0))
    told[(told < 0) & ((yes == 0) & (asked > 0))[at.T]] = 0
    meets = _in_parts(keys.meet, at, verified.pairs[pair])
    share = [np.bincount(pair, np.where(t < 0, meets, t > 0), len(out))[rows] / count[rows] for t in told]
    out[rows] = np.minimum(count[rows], seen.tuning.matches_a_pair)[:, None] * np.column_stack(
        [*share, share[0] * 0 + 1]
    )
    return out


_OTHERS = 2  # frames that make a point
_PART = 1 << 18  # matches that are looked at at once: bounds the memory


def _in_parts(function: Callable[..., np.ndarray], *arrays: np.ndarray) -> np.ndarray:
    return np.concatenate([function(*(a[k : k + _PART] for a in arrays)) for k in range(0, len(arrays[0]), _PART)])


class _KeyPoints:
    """All key points of a model's images in one row: ``start`` (N,) of each image, ``point`` (K,) row or -1."""

    def __init__(self, verified: VerifiedMatches, seen: ImageObservations) -> None:
        images, self._seen = sorted(seen.cameras), seen
        count = [len(seen.point[k]) for k in images]
        self.start = np.zeros(len(seen.frame), int)
        self.start[images] = np.cumsum([0, *count[:-1]])
        self.point = np.concatenate([seen.point[k] for k in images])
        self._image = np.repeat(images, count)
        none = np.zeros((0, 2))
        self._ray = np.concatenate([rays_or_axis(seen.cameras[k], verified.xy.get(k, none)) for k in images])
        usual = np.median(list(seen.reach.values()), axis=0) if seen.reach else np.array([0.0, np.inf])
        self._pose, self._reach = np.full((len(seen.frame), 4, 4), np.nan), np.tile(usual, (len(seen.frame), 1))
        for table, values in ((self._pose, seen.cam_from_world), (self._reach, seen.reach)):
            table[list(values)] = list(values.values())

    def at_points(self, own: np.ndarray, matched: np.ndarray) -> np.ndarray:
        """(M,) whether key points lie where the points of those matched to them are: 1, 0; -1 = too few made these."""
        point, seen, image = self.point[matched], self._seen, self._image[own]
        local = np.einsum("mij,mj->mi", self._pose[image, :3, :3], seen.xyz[point]) + self._pose[image, :3, 3]
        along = np.sum(local * self._ray[own], axis=1)
        there = along > np.cos(seen.tuning.tolerance_rad) * np.linalg.norm(local, axis=1)
        return np.where(seen.elsewhere(image, point) < _OTHERS, -1, there)

    def meet(self, at: np.ndarray, images: np.ndarray) -> np.ndarray:
        """(M,) bool: the rays of matches (M, 2) of images (M, 2) meet, ahead of both and within reach (or far off,
        without parallax)."""
        tuning, (a, b) = self._seen.tuning, self._ray[at.T]
        turn = np.swapaxes(self._pose[images, :3, :3], -1, -2)
        centre = -np.einsum("mnij,mnj->mni", turn, self._pose[images, :3, 3])
        a, b = (np.einsum("mij,mj->mi", turn[:, n], ray) for n, ray in enumerate((a, b)))
        step = centre[:, 0] - centre[:, 1]
        normal = cross(a, b)
        squared = np.maximum(np.sum(normal**2, axis=1), 1e-18)
        # a * s + step = b * t in least squares
        s, t = (np.sum(cross(ray, step) * normal, axis=1) / squared for ray in (b, a))
        gap = np.linalg.norm(a * s[:, None] + step - b * t[:, None], axis=1)
        meets = gap < tuning.tolerance_rad * np.maximum(np.abs(s), np.abs(t))
        near, far = self._reach[images, 0] / tuning.reach, self._reach[images, 1] * tuning.reach
        inside = np.all((np.stack([s, t], axis=1) > near) & (np.stack([s, t], axis=1) < far), axis=1)
        parallel = (np.sqrt(squared) < tuning.tolerance_rad) & (np.sum(a * b, axis=1) > 0)
        parallel &= np.linalg.norm(step, axis=1) < tuning.tolerance_rad * tuning.parallax * far.max(axis=1)
        return (meets & inside) | parallel
