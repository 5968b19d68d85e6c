"""The verified pairs and matches of a database, and which of the matches a model explains."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity, cross
from tiegraph.scene.colmapdatabase import Rows, image_ids
from tiegraph.scene.colmapmodel import matrix, registered_images
from tiegraph.scene.graph import parts as connected
from tiegraph.scene.rig import rays_or_axis
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.placement import AgreementTuning, ConsistencyTuning


class ViewGraph:
    """The key points and verified pairs of each image in the database, and its connected component."""

    def __init__(
        self, database_path: Path, scene: Scene, min_matches: int, refused: Sequence[tuple[int, int]] = ()
    ) -> None:
        """Read the counts. Indices are those of the scene; ``component`` -1 = no verified pair except ``refused``
        ones."""
        with Rows(database_path) as rows:
            names, features, table = rows.image_names(), rows.feature_counts(), rows.inlier_counts()
        index = {image_id: scene.image_index.get(name, -1) for image_id, name in names.items()}
        count = len(scene)
        self.features = np.zeros(count, int)
        for image_id, number in features.items():
            if index.get(image_id, -1) >= 0:
                self.features[index[image_id]] = number
        table = table[table[:, 2] >= min_matches]
        ends = np.array([[index.get(a, -1), index.get(b, -1)] for a, b, _ in table], int).reshape(-1, 2)
        away = {(min(pair), max(pair)) for pair in refused}
        inside = (ends >= 0).all(axis=1) & np.array([(min(e), max(e)) not in away for e in ends.tolist()], bool)
        self.pairs, self.inliers = ends[inside], table[inside, 2]
        self.i, self.j = self.pairs.T
        self.degree = np.bincount(self.pairs.ravel(), minlength=count)
        self.component = np.where(self.degree > 0, connected(self.i, self.j, count), -1)

    def counts(self) -> np.ndarray:
        """(P,) matches of the pairs."""
        return self.inliers

    @property
    def components(self) -> list[int]:
        """Sizes of the components of images with verified pairs, largest first."""
        return sorted(np.bincount(self.component[self.component >= 0]).tolist(), reverse=True)


@dataclass(frozen=True)
class VerifiedMatches:
    """Image pairs (P, 2), scene indices, lower first, their matches (M, 2) and the images' key points (K, 2) px."""

    pairs: np.ndarray
    matches: tuple[np.ndarray, ...]
    xy: dict[int, np.ndarray]

    def where(self, rows: np.ndarray) -> VerifiedMatches:
        """A subset of the pairs (boolean or index array)."""
        chosen = np.flatnonzero(rows) if rows.dtype == bool else rows
        return VerifiedMatches(self.pairs[chosen], tuple(self.matches[k] for k in chosen), self.xy)


def read_verified(database: Path, scene: Scene, refused: Sequence[tuple[int, int]] = ()) -> VerifiedMatches:
    """All verified matches except those of refused pairs (scene indices)."""
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
class MatchSource:
    """A database with verified matches, pairs (scene indices) that do not count, and what a mapper sees of the rest:
    pairs with at least ``least`` matches, and the images ``only`` (scene indices; None = all)."""

    database: Path
    refused: Sequence[tuple[int, int]] = ()
    least: int = 0
    only: np.ndarray | None = None

    def read(self, scene: Scene) -> VerifiedMatches:
        """All matches of the pairs that count."""
        return read_verified(self.database, scene, self.refused)


@dataclass(frozen=True)
class ImageObservations:
    """The observations of a model's images: by scene index camera, pose, row of the point of each key point (-1 =
    none), reach (nearest, farthest); the points ``xyz`` (P, 3), the number of ``frames`` (P,) that see each, and
    their list (``seen``, sorted numbers that combine point and frame); and ``tuning``: the tolerances of the test of
    matches."""

    cameras: dict[int, pycolmap.Camera]
    cam_from_world: dict[int, np.ndarray]
    point: dict[int, np.ndarray]
    reach: dict[int, np.ndarray]
    xyz: np.ndarray
    frames: np.ndarray
    seen: np.ndarray
    frame: np.ndarray  # (N,) of each image of the scene
    tuning: AgreementTuning

    def elsewhere(self, image: np.ndarray, point: np.ndarray) -> np.ndarray:
        """(K,) bool: two frames other than that of an image (K,) see a point (K,) (row, -1 = none)."""
        count = np.where(point >= 0, self.frames[point], 0)
        out, open_ = count > 2, np.flatnonzero(count == 2)
        key = point[open_] * len(self.frame) + self.frame[image[open_]]
        at = np.searchsorted(self.seen, key)
        out[open_] = self.seen[np.minimum(at, len(self.seen) - 1)] != key
        return np.asarray(out)

    def alone(self, frames: Collection[int]) -> ImageObservations:
        """The images of some frames, with the points that no other frames see."""
        inside = set(frames)
        own = {k for k in self.cameras if self.frame[k] in inside}
        shared = np.zeros(len(self.xyz) + 1, bool)  # the last: no point
        for k in self.cameras.keys() - own:
            shared[self.point[k]] = True
        shared[-1] = True
        return replace(
            self,
            cameras={k: self.cameras[k] for k in own},
            cam_from_world={k: self.cam_from_world[k] for k in own},
            point={k: np.where(shared[self.point[k]], -1, self.point[k]) for k in own},
            reach={k: r for k, r in self.reach.items() if k in own},
        )

    def moved(self, move: Similarity) -> ImageObservations:
        """The same at another place."""
        poses = {k: pose_after(pose, move) for k, pose in self.cam_from_world.items()}
        reach = {k: move.scale * r for k, r in self.reach.items()}
        return replace(self, cam_from_world=poses, xyz=move(self.xyz), reach=reach)


def pose_after(cam_from_world: np.ndarray, move: Similarity) -> np.ndarray:
    """A pose (4, 4) after its camera was moved with what it sees."""
    pose = transforms.invert(cam_from_world)
    return transforms.invert(transforms.rigid(move.rotation @ pose[:3, :3], move(pose[None, :3, 3])[0]))


def together_seen(parts: Sequence[ImageObservations]) -> ImageObservations:
    """Parts of one scene that share no image and no point."""
    start = np.cumsum([0, *(len(p.xyz) for p in parts)])
    return replace(
        parts[0],
        cameras={k: c for p in parts for k, c in p.cameras.items()},
        cam_from_world={k: pose for p in parts for k, pose in p.cam_from_world.items()},
        point={k: np.where(v >= 0, v + n, -1) for n, p in zip(start, parts) for k, v in p.point.items()},
        reach={k: r for p in parts for k, r in p.reach.items()},
        xyz=np.concatenate([p.xyz for p in parts]),
        frames=np.concatenate([p.frames for p in parts]),
        seen=np.concatenate([p.seen + n * len(p.frame) for n, p in zip(start, parts)]),
    )


def image_observations(model: pycolmap.Reconstruction, scene: Scene, tuning: AgreementTuning) -> ImageObservations:
    """The registered images of a model that are in the scene."""
    ids = np.array(sorted(model.point3D_ids()), np.int64)
    xyz = np.array([model.point3D(int(k)).xyz for k in ids] or np.zeros((1, 3)))
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
    return ImageObservations(
        cameras=cameras, cam_from_world=poses, point=point, reach=reach, xyz=xyz, frames=frames, seen=seen,
        frame=scene.frame, tuning=tuning,
    )  # fmt: skip


def agreement(verified: VerifiedMatches, seen: ImageObservations) -> np.ndarray:
    """(P, 3): matches of each pair that the model explains, by its first image and by its second image, and all of
    them; all capped; 0, 0, 0 = no verdict.

    If a match belongs to a point that two other frames see, that point must project onto the key point: two rays
    alone meet wherever an image slides along the line to the other. Rays are tested only where there is no such
    point, and none contradicts the key point.
    """
    all_ = _Matched(verified, seen)
    at = all_.at
    told = np.stack([_in_parts(all_.at_points, at[:, end], at[:, 1 - end]) for end in (0, 1)])
    yes, asked = (np.bincount(at.T[of], minlength=len(all_.point)) for of in (told == 1, told >= 0))
    told[(told < 0) & ((yes == 0) & (asked > 0))[at.T]] = 0
    left = np.flatnonzero((told < 0).any(axis=0))
    meets = np.zeros(len(at), bool)
    meets[left] = _in_parts(all_.meet, left)
    return all_.of_pairs(*(np.where(t < 0, meets, t > 0) for t in told))


def tears(
    verified: VerifiedMatches,
    agreed: np.ndarray,
    scene: Scene,
    doubtful: Collection[int],
    tuning: ConsistencyTuning,
) -> list[tuple[int, int, int, int]]:
    """Where a model is torn: two following frames (indices) of a pass, of the matches between the frames before and
    after the gap those that agree with the model, and all of them.

    ``agreed`` (P, 3) as by ``agreement``. Frames at most ``tuning.near_steps`` apart are compared, without
    ``doubtful`` ones, whose own place is wrong. Consecutive frames see the same surface, so the model must explain
    most of their matches.
    """
    order = np.lexsort((scene.sequence_index, scene.rig, scene.sequence))
    place, passes = np.argsort(order), np.stack([scene.sequence, scene.rig])
    a, b = np.sort(place[scene.frame[verified.pairs]], axis=1).T
    first, last = order[a], order[b]
    near = (a != b) & (passes[:, first] == passes[:, last]).all(axis=0) & (scene.sequence[first] >= 0)
    near &= scene.sequence_index[last] - scene.sequence_index[first] <= tuning.near_steps
    near &= ~np.isin(first, list(doubtful)) & ~np.isin(last, list(doubtful))
    votes = np.column_stack([agreed[near, :2].mean(axis=1), agreed[near, 2]])
    across = np.zeros((scene.frames + 1, 2))
    np.add.at(across, a[near], votes)
    np.add.at(across, b[near], -votes)
    right, all_ = np.cumsum(across, axis=0)[:-1].T
    torn = np.flatnonzero((all_ >= tuning.min_votes) & (right < (1 - tuning.explains) * all_))
    return [(int(order[k]), int(order[k + 1]), round(right[k]), round(all_[k])) for k in torn]


def share_explained(
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, tuning: AgreementTuning
) -> float:
    """Share of all verified matches, those of images without a pose too, that a model explains (``agreement``)."""
    right = agreement(verified, image_observations(model, scene, tuning))[:, :2].sum() / 2
    return float(right / max(sum(min(len(m), tuning.matches_a_pair) for m in verified.matches), 1))


@dataclass(frozen=True)
class Sightings:
    """For K key points of some images, the points that other frames made of their matches: ``image`` (K,) scene
    index, ``xy`` (K, 2) px, ``xyz`` (K, 3), and whether they project ``there`` (K,) bool."""

    image: np.ndarray
    xy: np.ndarray
    xyz: np.ndarray
    there: np.ndarray


def sightings(verified: VerifiedMatches, seen: ImageObservations, frame: int) -> Sightings:
    """The observations of a frame, each key point with each point once."""
    own = seen.frame[verified.pairs] == frame
    keys = _Matched(verified.where(own.any(axis=1)), seen)
    mine = own[own.any(axis=1)][keys.pair]
    both = np.unique(np.concatenate([keys.at[mine[:, 0]], keys.at[mine[:, 1]][:, ::-1]]), axis=0)
    told = _in_parts(keys.at_points, both[:, 0], both[:, 1])
    key, point, there = both[told >= 0, 0], keys.point[both[told >= 0, 1]], told[told >= 0] == 1
    first = np.unique(np.column_stack([key, point]), axis=0, return_index=True)[1]
    key, point, there = key[first], point[first], there[first]
    xy = np.array([verified.xy[i][k - keys.start[i]] for i, k in zip(keys.image[key], key)]).reshape(-1, 2)
    return Sightings(image=keys.image[key], xy=xy, xyz=seen.xyz[point], there=there)


def rays_meet(verified: VerifiedMatches, seen: ImageObservations) -> np.ndarray:
    """(P, 2): matches of each pair whose two rays meet, whatever other images see, and all of them; both capped."""
    all_ = _Matched(verified, seen)
    return all_.of_pairs(_in_parts(all_.meet, np.arange(len(all_.at))))


_PART = 1 << 18  # matches tested at once: bounds the memory


def _in_parts(function: Callable[..., np.ndarray], *arrays: np.ndarray) -> np.ndarray:
    starts = range(0, max(len(arrays[0]), 1), _PART)
    return np.concatenate([function(*(a[k : k + _PART] for a in arrays)) for k in starts])


class _Matched:
    """All key points of a model's images in one array: ``start`` (N,) of each image; ``image`` (K,); ``point`` (K,)
    row, -1 = none. All matches of pairs with a verdict: the ``pair`` (M,) and the key points ``at`` (M, 2)."""

    def __init__(self, verified: VerifiedMatches, seen: ImageObservations) -> None:
        images, self._seen = sorted(seen.cameras.keys() & verified.xy.keys()), seen
        count = [len(seen.point[k]) for k in images]
        self.start = np.zeros(len(seen.frame), int)
        self.start[images] = np.cumsum([0, *count])[:-1]
        self.point = np.concatenate([np.zeros(0, int), *(seen.point[k] for k in images)])
        self.image = np.repeat(np.array(images, int), count)
        rays = [rays_or_axis(seen.cameras[k], verified.xy[k]) for k in images]
        self._ray = np.concatenate([np.zeros((0, 3)), *rays])
        usual = np.median(list(seen.reach.values()), axis=0) if seen.reach else np.array([0.0, np.inf])
        self._pose, self._reach = np.full((len(seen.frame), 4, 4), np.nan), np.tile(usual, (len(seen.frame), 1))
        for table, values in ((self._pose, seen.cam_from_world), (self._reach, seen.reach)):
            table[list(values)] = np.reshape(list(values.values()), (-1, *table.shape[1:]))

        enough = np.array([len(m) >= seen.tuning.least_matches for m in verified.matches], bool)
        rows = np.flatnonzero(np.isin(verified.pairs, images).all(axis=1) & enough)
        at = [verified.matches[k] + self.start[verified.pairs[k]] for k in rows]
        self.pair = np.repeat(rows, np.array([len(a) for a in at], int))
        self.at = np.concatenate([np.zeros((0, 2), int), *at])
        self._pairs = verified.pairs

    def of_pairs(self, *right: np.ndarray) -> np.ndarray:
        """(P, K + 1): number of matches of each pair that pass each of K tests (M,), and of all matches; capped."""
        count = np.bincount(self.pair, minlength=len(self._pairs))
        all_ = np.minimum(count, self._seen.tuning.matches_a_pair)
        found = [np.bincount(self.pair, r, len(count)) / np.maximum(count, 1) * all_ for r in right]
        return np.column_stack([*found, all_])

    def at_points(self, own: np.ndarray, matched: np.ndarray) -> np.ndarray:
        """(M,) whether the points of matched key points project onto the key points: 1, 0; -1 = too few frames see
        the points."""
        point, seen, image = self.point[matched], self._seen, self.image[own]
        local = np.einsum("mij,mj->mi", self._pose[image, :3, :3], seen.xyz[point]) + self._pose[image, :3, 3]
        along = np.sum(local * self._ray[own], axis=1)
        there = along > np.cos(seen.tuning.tolerance_rad) * np.linalg.norm(local, axis=1)
        return np.where(seen.elsewhere(image, point), there, -1)

    def meet(self, rows: np.ndarray) -> np.ndarray:
        """(M,) bool: the rays of matches (rows of ``at``) meet in front of both cameras and within reach (or are
        parallel and far away)."""
        tuning, (a, b), images = self._seen.tuning, self._ray[self.at[rows].T], self._pairs[self.pair[rows]]
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
        parallel &= np.linalg.norm(step, axis=1) < tuning.tolerance_rad * tuning.reach * far.max(axis=1)
        return (meets & inside) | parallel
