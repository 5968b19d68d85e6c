"""Which images see the same surface: overlap predicted from poses and a proxy of the scene, in linear time.

The proxy is a set of points: of a preview model or an earlier one, or made from poses alone at an assumed range
(paper 003). A point is visible in an image if it projects into it, is not behind a nearer point of its image cell, is
not seen from behind, and not from much further than by those that observed it. The share of i that j sees gives each
occupied cell of i one vote, so that a cluster of points on one facade does not stand for the whole image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms

CELLS = (24, 18)  # image cells across and down: votes and occlusion
BEHIND = 1.2  # a point further than this times the nearest one of its cell is hidden
FAR_OBSERVERS = 2.0  # a point is not seen from further than this times its farthest observer
FRONT_COS = -0.3  # cosine between the ray and the mean direction to the observers; below it the back is seen
MIN_TRACK = 3  # observers a point needs, where enough points have so many
MEAN_VISIBLE = (700, 2500)  # points an image sees on average, in the largest surveys and in small ones
SIGHTS = 3_000_000  # of all images together: bounds memory
ANGLE_POINTS = 400  # points an image sees on average that the mean angles and scales are taken from
ASSUMED_GRID = (6, 5)  # rays across and down an image for a proxy at an assumed range
ASSUMED_RANGES = (0.5, 1.0, 2.0)  # of the assumed range
ASSUMED_REACH = 3.0  # ranges from which such a point is still seen
_LEAF = 64  # points of a box that is tested as one
_BLOCK = 128  # rows of the pair table worked out at once
_GUESSED_HALF_VIEW = np.radians(30)


@dataclass(frozen=True)
class Proxy:
    """P points that stand for the surface, with what is known of their observers.

    ``reach``: distance from which a point is still seen, inf = any; ``towards``: mean unit vector to its observers,
    zero = not known; ``image``/``point`` (O,): observations. ``assumed``: the points are not measured, each stands for
    the one image that observes it: they hide nothing, and an image votes with its own points only.
    """

    points: np.ndarray  # (P, 3)
    reach: np.ndarray  # (P,)
    towards: np.ndarray  # (P, 3)
    image: np.ndarray  # (O,)
    point: np.ndarray  # (O,)
    assumed: bool = False

    def __len__(self) -> int:
        return len(self.points)

    def keep(self, mask: np.ndarray) -> Proxy:
        """Only the points of a mask (P,)."""
        number = np.cumsum(mask) - 1
        seen = mask[self.point]
        return Proxy(
            self.points[mask],
            self.reach[mask],
            self.towards[mask],
            self.image[seen],
            number[self.point[seen]],
            self.assumed,
        )


@dataclass(frozen=True)
class Overlap:
    """K pairs of images i < j that share surface, sorted; columns (K,)."""

    i: np.ndarray
    j: np.ndarray
    share: np.ndarray  # of the surface one sees, the part the other sees too: the larger of the two directions
    angle_deg: np.ndarray  # between the two rays to the shared surface, on average; NaN = too little is shared to say
    scale: np.ndarray  # distance of i over distance of j to the shared surface, geometric mean; NaN likewise

    def __len__(self) -> int:
        return len(self.i)

    def between(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """(K,) share of image pairs in any order of their ends; 0 where they are not listed."""
        own = self.i.astype(np.int64) << 32 | self.j
        key = np.minimum(i, j).astype(np.int64) << 32 | np.maximum(i, j)
        if not len(own):
            return np.zeros(len(key))
        at = np.minimum(np.searchsorted(own, key), len(own) - 1)
        return np.where(own[at] == key, self.share[at], 0.0)

    def where(self, mask: np.ndarray) -> Overlap:
        """The rows of a mask (K,)."""
        return Overlap(*(getattr(self, n)[mask] for n in self.__dataclass_fields__))


def observed_proxy(points: np.ndarray, image: np.ndarray, point: np.ndarray, cam_from_world: np.ndarray) -> Proxy:
    """Proxy of model points (P, 3) and their observations: ``image`` (O,) sees ``point`` (O,).

    Points with fewer than MIN_TRACK observers are left out, unless that would take more than half of them.
    """
    centre = transforms.centre(cam_from_world)
    known = np.isfinite(centre[image]).all(axis=1)
    image, point = np.asarray(image)[known], np.asarray(point)[known]
    ray = centre[image] - points[point]
    distance = np.maximum(np.linalg.norm(ray, axis=1), 1e-12)
    towards = np.zeros((len(points), 3))
    np.add.at(towards, point, ray / distance[:, None])
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    reach = np.zeros(len(points))
    np.maximum.at(reach, point, FAR_OBSERVERS * distance)
    track = np.bincount(point, minlength=len(points))
    proxy = Proxy(points, np.where(track > 0, reach, np.inf), towards, image, point)
    good = track >= MIN_TRACK
    return proxy.keep(good) if good.sum() >= 0.5 * len(points) else proxy


def points_proxy(points: np.ndarray) -> Proxy:
    """Proxy of bare points (P, 3), such as a laser scan, of which no observer is known."""
    none = np.zeros(0, int)
    return Proxy(points, np.full(len(points), np.inf), np.zeros((len(points), 3)), none, none)


def assumed_proxy(
    cam_from_world: np.ndarray, cameras: Sequence[pycolmap.Camera | None], range_m: float | np.ndarray
) -> Proxy:
    """Proxy from poses alone (paper 003): points on a grid of rays of every image, about an assumed range.

    ``range_m`` one for all or (N,), in the unit of the poses.
    """
    known = np.flatnonzero(np.isfinite(cam_from_world[:, :3]).all(axis=(1, 2)))
    ranges = np.broadcast_to(np.asarray(range_m, float), (len(cam_from_world),))
    rays = {id(c): _grid_rays(c) for c in cameras}
    steps = np.array(ASSUMED_RANGES)
    points, towards, reach, image = [], [], [], []
    for k in known:
        world = rays[id(cameras[k])] @ cam_from_world[k, :3, :3]
        centre = transforms.centre(cam_from_world[k])
        points.append((centre + world[None] * (steps * ranges[k])[:, None, None]).reshape(-1, 3))
        towards.append(np.tile(-world, (len(steps), 1)))
        reach.append(np.full(len(world) * len(steps), ASSUMED_REACH * ranges[k]))
        image.append(np.full(len(world) * len(steps), k))
    if not points:
        return Proxy(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), np.zeros(0, int), np.zeros(0, int), True)
    count = len(points) * len(points[0])
    return Proxy(
        np.concatenate(points),
        np.concatenate(reach),
        np.concatenate(towards),
        np.concatenate(image),
        np.arange(count),
        True,
    )


def _grid_rays(camera: pycolmap.Camera | None) -> np.ndarray:
    """(G, 3) unit rays through the centres of a grid of the image; those the camera model cannot invert are left out."""
    u, v = (np.arange(n) + 0.5 for n in ASSUMED_GRID)
    grid = np.stack(np.meshgrid(u / ASSUMED_GRID[0], v / ASSUMED_GRID[1]), axis=-1).reshape(-1, 2)
    rays = _View.of(camera).rays(grid)
    return rays[np.isfinite(rays).all(axis=1)]


@dataclass(frozen=True)
class _View:
    """A camera as this module needs it: projection to image shares 0..1 and the half angle of a cone round it."""

    camera: pycolmap.Camera | None
    half: float  # radians, to the corners

    @staticmethod
    def of(camera: pycolmap.Camera | None) -> _View:
        if camera is None:
            return _View(None, float(np.arctan(np.sqrt(2) * np.tan(_GUESSED_HALF_VIEW))))
        rim = np.array([(x, y) for x in (0, 0.5, 1) for y in (0, 0.5, 1)])
        rays = _View(camera, 0.0).rays(rim)
        half = np.nanmax(np.arccos(np.clip(rays[:, 2], -1, 1)), initial=0.0)
        return _View(camera, float(half) if half > 0 else np.radians(89))

    def rays(self, shares: np.ndarray) -> np.ndarray:
        """(K, 3) unit rays of places given in shares of the image (K, 2); NaN where the model has no inverse."""
        if self.camera is None:
            xy = (2 * shares - 1) * np.tan(_GUESSED_HALF_VIEW)
        else:
            xy = np.asarray(self.camera.cam_from_img(shares * (self.camera.width, self.camera.height)), float)
        rays = np.column_stack([xy, np.ones(len(xy))])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def project(self, local: np.ndarray) -> np.ndarray:
        """(K, 2) shares of the image, NaN = not in it, of points (K, 3) in the camera frame with z > 0."""
        if self.camera is None:
            shares = (local[:, :2] / local[:, 2:] / np.tan(_GUESSED_HALF_VIEW) + 1) / 2
        else:
            shares = np.asarray(self.camera.img_from_cam(local), float) / (self.camera.width, self.camera.height)
        with np.errstate(invalid="ignore"):
            inside = ((shares >= 0) & (shares < 1)).all(axis=1)
        return np.where(inside[:, None], shares, np.nan)


class _Boxes:
    """Points in compact groups, so that an image looks only at the groups near its field of view."""

    def __init__(self, proxy: Proxy) -> None:
        self.order = np.asarray(cKDTree(proxy.points, leafsize=_LEAF).indices)
        self.starts = np.arange(0, len(proxy), _LEAF)
        sorted_ = proxy.points[self.order]
        low, high = np.minimum.reduceat(sorted_, self.starts), np.maximum.reduceat(sorted_, self.starts)
        self.middle, self.radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
        self.reach = np.maximum.reduceat(proxy.reach[self.order], self.starts)

    def near(self, centre: np.ndarray, axis: np.ndarray, half: float) -> np.ndarray:
        """Indices of the points whose group touches a cone of half angle ``half`` and is within reach."""
        way = self.middle - centre
        along = way @ axis
        distance = np.linalg.norm(way, axis=1)
        touches = distance - self.radius < self.reach
        if half < np.pi / 2:
            across = np.sqrt(np.maximum(distance**2 - along**2, 0))
            touches &= across * np.cos(half) - along * np.sin(half) < self.radius
        first = self.starts[touches]
        rows = (first[:, None] + np.arange(_LEAF)).ravel()
        return self.order[rows[rows < len(self.order)]]


@dataclass(frozen=True)
class _Sight:
    """What an image sees: points (K,), their cells (K,) and distances (K,)."""

    point: np.ndarray
    cell: np.ndarray
    distance: np.ndarray


def _sight(pose: np.ndarray, view: _View, proxy: Proxy, boxes: _Boxes, own: np.ndarray) -> _Sight:
    centre = transforms.centre(pose)
    near = boxes.near(centre, pose[2, :3], 1.05 * view.half)
    ray = proxy.points[near] - centre
    distance = np.linalg.norm(ray, axis=1)
    local = ray @ pose[:3, :3].T
    ahead = (local[:, 2] > max(np.cos(1.05 * view.half), 1e-6) * distance) & (distance < proxy.reach[near])
    facing = -np.einsum("kc,kc->k", ray, proxy.towards[near])
    known = proxy.towards[near].any(axis=1)
    rows = np.flatnonzero(ahead & (~known | (facing > FRONT_COS * distance)))
    shares = view.project(local[rows])
    inside = np.isfinite(shares).all(axis=1)
    rows, shares = rows[inside], shares[inside]
    cell = (shares * CELLS).astype(int) @ (1, CELLS[0])
    point, distance = near[rows], distance[rows]
    if not proxy.assumed:
        nearest = np.full(CELLS[0] * CELLS[1], np.inf)
        np.minimum.at(nearest, cell, distance)
        shown = (distance <= BEHIND * nearest[cell]) | np.isin(point, own)
        point, cell, distance = point[shown], cell[shown], distance[shown]
    return _Sight(point, cell, distance)


def shared_surface(
    cam_from_world: np.ndarray,
    cameras: Sequence[pycolmap.Camera | None],
    proxy: Proxy,
    floor: float = 0.02,
    max_angle_deg: float = 90.0,
    max_scale: float = 4.0,
) -> Overlap:
    """Pairs of images whose predicted overlap reaches ``floor``.

    ``cam_from_world`` (N, 4, 4), NaN = unknown (such images are in no pair); ``cameras`` one an image, None = unknown
    (60 degrees of view assumed). Pairs whose rays to the shared surface meet at more than ``max_angle_deg``, or whose
    distances to it differ by more than ``max_scale``, match no more and are left out.
    """
    known = np.flatnonzero(np.isfinite(cam_from_world[:, :3]).all(axis=(1, 2)))
    empty = Overlap(*(np.zeros(0, int),) * 2, *(np.zeros(0),) * 3)
    if len(known) < 2 or not len(proxy):
        return empty
    poses = cam_from_world[known]
    views = {id(c): _View.of(c) for c in cameras}
    seen = _all_sights(poses, [views[id(cameras[k])] for k in known], known, proxy)
    found = _pairs(seen, transforms.centre(poses), floor)
    too_much = (found.angle_deg > max_angle_deg) | (np.abs(np.log(found.scale)) > np.log(max_scale))
    found = found.where(~too_much)
    return Overlap(known[found.i], known[found.j], found.share, found.angle_deg, found.scale)


@dataclass(frozen=True)
class _Table:
    """All sights as entries (E,) sorted by image; ``vote`` sums to one over an image that sees anything."""

    shape: tuple[int, int]
    image: np.ndarray
    point: np.ndarray
    distance: np.ndarray
    vote: np.ndarray
    points: np.ndarray  # (P, 3)


def _all_sights(poses: np.ndarray, views: list[_View], images: np.ndarray, proxy: Proxy) -> _Table:
    proxy, boxes = _thinned(poses, views, proxy)
    own = _owned(proxy, images)
    sights = [_sight(poses[k], views[k], proxy, boxes, own[k]) for k in range(len(poses))]
    counts = [len(s.point) for s in sights]
    image = np.repeat(np.arange(len(poses), dtype=np.int32), counts)
    point = np.concatenate([s.point for s in sights]).astype(np.int32)
    cell = np.concatenate([s.cell for s in sights]).astype(np.int32)
    distance = np.concatenate([s.distance for s in sights]).astype(np.float32)
    voter = np.ones(len(point), bool)
    if proxy.assumed:
        owner = np.full(len(proxy), -1)
        owner[proxy.point] = proxy.image
        voter = owner[point] == images[image]
    return _Table((len(poses), len(proxy)), image, point, distance, _votes(image, cell, voter), proxy.points)


def _owned(proxy: Proxy, images: np.ndarray) -> list[np.ndarray]:
    """The points each image observes."""
    order = np.argsort(proxy.image, kind="stable")
    image, point = proxy.image[order], proxy.point[order]
    low, high = np.searchsorted(image, images), np.searchsorted(image, images, side="right")
    return [point[a:b] for a, b in zip(low, high)]


def _thinned(poses: np.ndarray, views: list[_View], proxy: Proxy) -> tuple[Proxy, _Boxes]:
    """A random part of the points, where images would see far more than is needed."""
    boxes = _Boxes(proxy)
    enough = float(np.clip(SIGHTS / len(poses), *MEAN_VISIBLE))
    if proxy.assumed or len(proxy) <= enough:
        return proxy, boxes
    rng = np.random.default_rng(0)
    sample = rng.choice(len(poses), min(len(poses), 40), replace=False)
    none = np.zeros(0, int)
    count = np.mean([len(_sight(poses[k], views[k], proxy, boxes, none).point) for k in sample])
    if count <= 1.2 * enough:
        return proxy, boxes
    proxy = proxy.keep(rng.random(len(proxy)) < enough / count)
    return proxy, _Boxes(proxy)


def _votes(image: np.ndarray, cell: np.ndarray, voter: np.ndarray) -> np.ndarray:
    """(E,) one vote a cell, shared by its points, all votes of an image together one; zero for entries without vote."""
    key = image.astype(np.int64) * (CELLS[0] * CELLS[1]) + cell
    rows = np.flatnonzero(voter)
    _, at, count = np.unique(key[rows], return_inverse=True, return_counts=True)
    vote = np.zeros(len(key))
    vote[rows] = 1 / count[at]
    total = np.bincount(image, vote)
    return (vote / np.maximum(total, 1e-12)[image]).astype(np.float32)


class _Products:
    """Sparse tables (images, points) and (points, images) of the same entries with different values."""

    def __init__(self, seen: _Table) -> None:
        self.shape = seen.shape
        self.starts = np.searchsorted(seen.image, np.arange(seen.shape[0] + 1))
        self.point = seen.point
        numbers = csr_array((np.arange(len(seen.point)), seen.point, self.starts), shape=seen.shape)
        turned = numbers.T.tocsr()
        self.order, self.image, self.point_starts = turned.data, turned.indices, turned.indptr

    def rows(self, values: np.ndarray, first: int, last: int) -> csr_array:
        """Images first..last by points."""
        a, b = self.starts[first], self.starts[last]
        part = (values[a:b], self.point[a:b], self.starts[first : last + 1] - a)
        return csr_array(part, shape=(last - first, self.shape[1]))

    def turned(self, values: np.ndarray) -> csr_array:
        """Points by images."""
        return csr_array((values[self.order], self.image, self.point_starts), shape=self.shape[::-1])


def _pairs(seen: _Table, centre: np.ndarray, floor: float) -> Overlap:
    """Sparse products of the votes with what is seen; for the angle and the scale, weighted by rays and distances."""
    sample = _sampled(seen)
    ray = ((sample.points[sample.point] - centre[sample.image]) / sample.distance[:, None]).astype(np.float32)
    log_distance = np.log(sample.distance)
    all_, few = _Products(seen), _Products(sample)
    share_right = all_.turned(np.ones(len(seen.image), np.float32))
    ones = few.turned(np.ones(len(sample.image), np.float32))
    right = [few.turned(ray[:, a]) for a in range(3)]
    depth = few.turned(log_distance)
    rows = []
    for start in range(0, seen.shape[0], _BLOCK):
        part = (start, min(start + _BLOCK, seen.shape[0]))
        share = (all_.rows(seen.vote, *part) @ share_right).toarray()
        a, b = np.nonzero(share >= floor)
        own = few.rows(sample.vote, *part)
        weight = np.where((w := (own @ ones).toarray()[a, b]) > 0, w, np.nan)
        cosine = sum((few.rows(sample.vote * ray[:, k], *part) @ right[k]).toarray()[a, b] for k in range(3)) / weight
        ratio = (few.rows(sample.vote * log_distance, *part) @ ones).toarray() - (own @ depth).toarray()
        rows.append(np.stack([a + start, b, share[a, b], cosine, ratio[a, b] / weight]))
    return _undirected(np.concatenate(rows, axis=1))


def _sampled(seen: _Table) -> _Table:
    """The sights of a random part of the points: mean angles need fewer than shares."""
    part = ANGLE_POINTS * seen.shape[0] / max(len(seen.image), 1)
    if part >= 0.7:
        return seen
    keep = (np.random.default_rng(1).random(len(seen.points)) < part)[seen.point]
    return _Table(seen.shape, seen.image[keep], seen.point[keep], seen.distance[keep], seen.vote[keep], seen.points)


def _undirected(rows: np.ndarray) -> Overlap:
    """Rows (5, K) i, j, share, cosine, log ratio of directed pairs as pairs i < j: the direction that shares more."""
    rows = rows[:, rows[0] != rows[1]]
    flip = rows[0] > rows[1]
    i, j = np.where(flip, rows[1], rows[0]).astype(int), np.where(flip, rows[0], rows[1]).astype(int)
    ratio = np.where(flip, -rows[4], rows[4])
    order = np.lexsort((-rows[2], j, i))
    i, j = i[order], j[order]
    first = np.ones(len(i), bool)
    first[1:] = (np.diff(i) != 0) | (np.diff(j) != 0)
    keep = order[first]
    angle = np.degrees(np.arccos(np.clip(rows[3, keep], -1, 1)))
    return Overlap(i[first], j[first], np.minimum(rows[2, keep], 1.0), angle, np.exp(ratio[keep]))
