"""Which images see the same surface: overlap predicted from poses and a proxy of the scene, in linear time.

The proxy is a set of points: of a coarse model or an earlier one, or made from poses alone at an assumed range (paper
003). A point is visible in an image if it projects into it, is not behind a nearer point of its image cell, is not
seen from behind, and not from much further than its observers are. For the share of i that j sees, each occupied cell
of i has one vote, so that a cluster of points on one facade does not represent the whole image.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms
from tiegraph.network.coarse.proxy import Boxes, Proxy, View, assumed_proxy, views_of
from tiegraph.network.passes import places
from tiegraph.network.tuning import CoarseTuning, VisibleTuning
from tiegraph.scene.pairs import Visibility, pair_key
from tiegraph.scene.sorting import Columns, run_starts, spread

_BLOCK = 128  # rows of the pair table computed at once
_OWNERS = 256  # images whose assumed points are computed at once


@dataclass(frozen=True)
class Overlap(Columns):
    """K pairs of images i < j that share surface, sorted; columns (K,)."""

    i: np.ndarray
    j: np.ndarray
    share: np.ndarray  # share of the surface of one image that the other sees too: the larger of the two directions
    angle_deg: np.ndarray  # mean angle between the two rays to the shared surface; NaN = too little is shared
    scale: np.ndarray  # distance of i over distance of j to the shared surface, geometric mean; NaN likewise

    def between(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """(K,) share of image pairs in any order of their ends; 0 where they are not listed."""
        row = places(pair_key(self.i, self.j), pair_key(np.minimum(i, j), np.maximum(i, j)))
        return np.append(self.share, 0.0)[row]

    @staticmethod
    def together(parts: "Sequence[Overlap]") -> "Overlap":
        """One list from several that have no pair in common."""
        none = Overlap(*np.zeros((2, 0), np.int32), *np.zeros((3, 0)))
        found = Overlap.concatenate([*parts, none])
        return found.where(np.lexsort((found.j, found.i)))


@dataclass(frozen=True)
class _Eye:
    """One image: its pose cam_from_world (4, 4), camera, and angular uncertainty of its pose, radians."""

    pose: np.ndarray
    view: View
    slack: float


def in_view(
    view: View,
    slack: float,
    rays: tuple[np.ndarray, np.ndarray],
    proxy: Proxy,
    point: np.ndarray,
    tuning: VisibleTuning,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For points (K,) of a proxy: whether in view and not seen from behind (K,) bool, image cell, distance. ``rays``
    from images of one view to them: in the world (K, 3), in the image's frame (K, 3)."""
    half = view.half + slack
    (ray, local), towards = rays, proxy.towards[point]
    distance = np.linalg.norm(ray, axis=1)
    ahead = (local[:, 2] > max(np.cos(min(half, np.pi)), 1e-6) * distance) & (distance < proxy.reach[point])
    facing = -np.einsum("kc,kc->k", ray, towards) > -0.3 * distance  # below, its back is seen
    seen = ahead & (facing | ~towards.any(axis=1))
    shares = np.full((len(ray), 2), np.nan)
    shares[seen] = view.project(local[seen], slack)
    seen &= np.isfinite(shares).all(axis=1)
    return seen, (np.where(seen[:, None], shares, 0.0) * tuning.cells).astype(int) @ (1, tuning.cells[0]), distance


def _sight(
    eye: _Eye, proxy: Proxy, boxes: Boxes, own: np.ndarray, tuning: VisibleTuning
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points (K,) that an image sees, their cells (K,) and distances (K,)."""
    half = eye.view.half + eye.slack
    near = boxes.near(transforms.centre(eye.pose), eye.pose[2, :3], half)
    ray = proxy.points[near] - transforms.centre(eye.pose)
    seen, cell, distance = in_view(eye.view, eye.slack, (ray, ray @ eye.pose[:3, :3].T), proxy, near, tuning)
    point, cell, distance = near[seen], cell[seen], distance[seen]
    if not proxy.assumed:
        nearest = np.full(tuning.cells[0] * tuning.cells[1], np.inf)
        np.minimum.at(nearest, cell, distance)
        shown = (distance <= tuning.behind * nearest[cell]) | np.isin(point, own)
        point, cell, distance = point[shown], cell[shown], distance[shown]
    return point, cell, distance


def shared_surface(
    cam_from_world: np.ndarray,
    cameras: Sequence[pycolmap.Camera | None],
    proxy: Proxy,
    tuning: VisibleTuning,
    max_angle_deg: float,
    slack_rad: np.ndarray | float = 0.0,
) -> Overlap:
    """Pairs of images with a predicted overlap of at least ``min_share``.

    ``cam_from_world`` (N, 4, 4), NaN = unknown (such images are in no pair); ``cameras`` one for each image, None =
    unknown (a field of view is assumed). Pairs whose rays to the shared surface meet at more than ``max_angle_deg``,
    or whose distances to it differ by more than the factor ``max_scale``, no longer match and are left out.
    ``slack_rad`` (N,): extension of the images on every side, for uncertain poses.
    """
    known = np.flatnonzero(np.isfinite(cam_from_world[:, :3]).all(axis=(1, 2)))
    if len(known) < 2 or not len(proxy):
        return Overlap.together(())
    eyes = _eyes(cam_from_world, cameras, known, slack_rad, tuning.guessed_view_deg)
    centre = transforms.centre(cam_from_world[known])
    parts = [proxy]
    if proxy.assumed:  # by neighbourhoods of images, to bound memory
        order = known[np.asarray(cKDTree(centre, leafsize=16).indices)]
        owner = np.full(len(proxy), -1)
        owner[proxy.point] = proxy.image
        near = (np.isin(owner, order[k : k + _OWNERS]) for k in range(0, len(order), _OWNERS))
        parts = [proxy.keep(mask) for mask in near if mask.any()]
    sights = (_all_sights(eyes, known, p, tuning) for p in parts)
    found = _undirected(np.concatenate([_directed(seen, centre, tuning) for seen in sights], axis=1))
    too_much = (found.angle_deg > max_angle_deg) | (np.abs(np.log(found.scale)) > np.log(tuning.max_scale))
    found = found.where(~too_much)
    return Overlap(i=known[found.i], j=known[found.j], share=found.share, angle_deg=found.angle_deg, scale=found.scale)


def visible_points(
    cam_from_world: np.ndarray, cameras: Sequence[pycolmap.Camera | None], proxy: Proxy, tuning: VisibleTuning
) -> Visibility:
    """The points of a proxy that each image sees; of very many points a random sample."""
    centre = transforms.centre(cam_from_world)
    known = np.flatnonzero(np.isfinite(cam_from_world[:, :3]).all(axis=(1, 2)))
    if not len(known) or not len(proxy):
        start = np.zeros(len(cam_from_world) + 1, np.int64)
        return Visibility(start=start, point=np.zeros(0, np.int32), xyz=np.zeros((0, 3)), centre=centre)
    eyes = _eyes(cam_from_world, cameras, known, 0.0, tuning.guessed_view_deg)
    seen = _all_sights(eyes, known, proxy, tuning)
    image = known[seen.image]
    order = np.lexsort((seen.point, image))
    start = np.searchsorted(image[order], np.arange(len(cam_from_world) + 1))
    return Visibility(start=start, point=seen.point[order].astype(np.int32), xyz=seen.points, centre=centre)


def _eyes(
    cam_from_world: np.ndarray,
    cameras: Sequence[pycolmap.Camera | None],
    known: np.ndarray,
    slack_rad: np.ndarray | float,
    guessed_view_deg: float,
) -> list[_Eye]:
    views = views_of(cameras, guessed_view_deg)
    slack = np.broadcast_to(np.asarray(slack_rad, float), (len(cam_from_world),))
    return [_Eye(cam_from_world[k], views[id(cameras[int(k)])], float(slack[k])) for k in known]


@dataclass(frozen=True)
class _Table:
    """All observations as entries (E,) sorted by image; ``vote`` sums to one for an image that sees anything."""

    shape: tuple[int, int]
    image: np.ndarray
    point: np.ndarray
    distance: np.ndarray
    vote: np.ndarray
    points: np.ndarray  # (P, 3)


def _all_sights(eyes: list[_Eye], images: np.ndarray, proxy: Proxy, tuning: VisibleTuning) -> _Table:
    proxy, boxes = _thinned(eyes, proxy, tuning)
    order = np.argsort(proxy.image, kind="stable")
    ends = (np.searchsorted(proxy.image[order], images, side) for side in ("left", "right"))
    own = (proxy.point[order[a:b]] for a, b in zip(*ends))
    points, cells, distances = zip(*(_sight(eye, proxy, boxes, seen, tuning) for eye, seen in zip(eyes, own)))
    image = np.repeat(np.arange(len(eyes), dtype=np.int32), [len(p) for p in points])
    point = np.concatenate(points).astype(np.int32)
    cell = np.concatenate(cells).astype(np.int32)
    distance = np.concatenate(distances).astype(np.float32)
    voter = np.ones(len(point), bool)
    if proxy.assumed:
        owner = np.full(len(proxy), -1)
        owner[proxy.point] = proxy.image
        voter = owner[point] == images[image]
    vote = _votes(image, cell, voter, tuning.cells[0] * tuning.cells[1])
    return _Table((len(eyes), len(proxy)), image=image, point=point, distance=distance, vote=vote, points=proxy.points)


def _thinned(eyes: list[_Eye], proxy: Proxy, tuning: VisibleTuning) -> tuple[Proxy, Boxes]:
    """A random sample of the points, if images would see far more than needed."""
    boxes = Boxes(proxy)
    enough = float(np.clip(3_000_000 / len(eyes), *tuning.mean_visible))  # of all images together: bounds memory
    if proxy.assumed or len(proxy) <= enough:
        return proxy, boxes
    rng = np.random.default_rng(0)
    sample = rng.choice(len(eyes), min(len(eyes), 40), replace=False)
    none = np.zeros(0, int)
    count = np.mean([len(_sight(eyes[k], proxy, boxes, none, tuning)[0]) for k in sample])
    if count <= 1.2 * enough:
        return proxy, boxes
    # At random: an even spread over the surface predicted worse on ``canal`` (textured near surfaces tie).
    proxy = proxy.keep(rng.random(len(proxy)) < enough / count)
    return proxy, Boxes(proxy)


def _votes(image: np.ndarray, cell: np.ndarray, voter: np.ndarray, cells: int) -> np.ndarray:
    """(E,) one vote for each cell, shared by its points, less those without vote; all votes of an image sum to one."""
    key = image.astype(np.int64) * cells + cell
    rows = np.flatnonzero(voter)
    _, at, count = np.unique(key[rows], return_inverse=True, return_counts=True)
    vote = np.zeros(len(key))
    vote[rows] = 1 / count[at]
    total = np.bincount(image, vote)
    return (vote / np.maximum(total, 1e-12)[image]).astype(np.float32)


class _Products:
    """Sparse tables of the same entries with different values: those that vote, and all of them transposed."""

    def __init__(self, seen: _Table) -> None:
        self.shape = seen.shape
        self.votes = np.flatnonzero(seen.vote > 0)
        self.point = seen.point[self.votes]
        every = np.arange(seen.shape[0] + 1)
        self.starts = np.searchsorted(seen.image[self.votes], every)
        starts = np.searchsorted(seen.image, every)
        turned = csr_array((np.arange(len(seen.point)), seen.point, starts), shape=seen.shape).T.tocsr()
        self.order, self.image, self.point_starts = turned.data, turned.indices, turned.indptr

    def rows(self, values: np.ndarray, first: int, last: int) -> csr_array:
        """Images first..last by points."""
        a, b = self.starts[first], self.starts[last]
        part = (values[self.votes[a:b]], self.point[a:b], self.starts[first : last + 1] - a)
        return csr_array(part, shape=(last - first, self.shape[1]))

    def turned(self, values: np.ndarray) -> csr_array:
        """Points by images."""
        return csr_array((values[self.order], self.image, self.point_starts), shape=self.shape[::-1])


def _directed(seen: _Table, centre: np.ndarray, tuning: VisibleTuning) -> np.ndarray:
    """Rows (5, K) i, j, share of i that j sees, cosine of the rays, log ratio of the distances; without small shares.

    Sparse products of votes and visibility; for angle and scale weighted by rays and distances.
    """
    sample = _sampled(seen)
    ray = ((sample.points[sample.point] - centre[sample.image]) / sample.distance[:, None]).astype(np.float32)
    log_distance = np.log(sample.distance)
    all_, few = _Products(seen), _Products(sample)
    share_right = all_.turned(np.ones(len(seen.image), np.float32))
    vote, ones = sample.vote, few.turned(np.ones(len(sample.image), np.float32))
    products = [(vote, ones), *((vote * ray[:, k], few.turned(ray[:, k])) for k in range(3))]
    products += [(vote * log_distance, ones), (vote, few.turned(log_distance))]
    rows: list[np.ndarray] = [np.zeros((5, 0))]
    met, place = np.zeros(seen.shape[0], bool), np.zeros(seen.shape[0], np.int32)
    for start in range(0, seen.shape[0], _BLOCK):
        part = (start, min(start + _BLOCK, seen.shape[0]))
        if all_.starts[part[0]] == all_.starts[part[1]]:
            continue
        shared = all_.rows(seen.vote, *part) @ share_right
        met[shared.indices] = True
        others = np.flatnonzero(met)  # few in a long survey: tables of all images would grow with its square
        met[others], place[others] = False, np.arange(len(others))
        share = _dense(shared, place, len(others))
        a, b = np.nonzero(share >= tuning.min_share)
        sums = [_dense(few.rows(left, *part) @ right, place, len(others))[a, b] for left, right in products]
        weight = np.where(sums[0] > 0, sums[0], np.nan)
        cosine, ratio = (sums[1] + sums[2] + sums[3]) / weight, (sums[4] - sums[5]) / weight
        rows.append(np.stack([a + start, others[b], share[a, b], cosine, ratio]))
    return np.concatenate(rows, axis=1)


def _dense(table: csr_array, place: np.ndarray, width: int) -> np.ndarray:
    """(rows, width) a sparse table (rows, N) with its column k at ``place[k]`` (N,)."""
    return csr_array((table.data, place[table.indices], table.indptr), shape=(table.shape[0], width)).toarray()


def _sampled(seen: _Table) -> _Table:
    """The observations of a random sample of the points: mean angles need fewer points than shares."""
    part = 400 * seen.shape[0] / max(len(seen.image), 1)
    if part >= 0.7 or np.any(seen.vote == 0):  # assumed points are few
        return seen
    keep = (np.random.default_rng(1).random(len(seen.points)) < part)[seen.point]
    columns = {name: getattr(seen, name)[keep] for name in ("image", "point", "distance", "vote")}
    return replace(seen, **columns)


def _undirected(rows: np.ndarray) -> Overlap:
    """Rows (5, K) i, j, share, cosine, log ratio of directed pairs as pairs i < j, the larger share of both."""
    rows = rows[:, rows[0] != rows[1]]
    flip = rows[0] > rows[1]
    i, j = np.where(flip, rows[1], rows[0]).astype(int), np.where(flip, rows[0], rows[1]).astype(int)
    ratio = np.where(flip, -rows[4], rows[4])
    order = np.lexsort((-rows[2], j, i))
    keep = order[run_starts(pair_key(i[order], j[order]))]
    return Overlap(
        i=i[keep],
        j=j[keep],
        share=np.minimum(rows[2, keep], 1.0),
        angle_deg=np.degrees(np.arccos(np.clip(rows[3, keep], -1, 1))),
        scale=np.exp(ratio[keep]),
    )


def pair_share(
    cam_from_world: np.ndarray,
    cameras: Sequence[pycolmap.Camera | None],
    i: np.ndarray,
    j: np.ndarray,
    range_m: float,
    tuning: CoarseTuning,
) -> np.ndarray:
    """(K,) predicted overlap of a few given pairs from poses alone, at an assumed range; NaN where a pose is unknown.

    The same measure as ``shared_surface`` of an ``assumed_proxy``.
    """
    asked = np.isin(np.arange(len(cameras)), np.concatenate([i, j]))
    proxy = assumed_proxy(np.where(asked[:, None, None], cam_from_world, np.nan), cameras, range_m, tuning)
    known = np.all(np.isfinite(cam_from_world[:, :3]), axis=(1, 2))
    there = np.flatnonzero(known[i] & known[j])
    owner, looking = np.concatenate([i[there], j[there]]), np.concatenate([j[there], i[there]])
    starts = np.searchsorted(proxy.image, np.arange(len(cameras) + 1))  # an assumed proxy is in the order of its images
    count = np.diff(starts)[owner]
    point, look = spread(starts[owner], count), np.repeat(np.arange(len(owner)), count)
    pose, camera = cam_from_world[looking[look]], np.array([id(c) for c in cameras])[looking[look]]
    ray = proxy.points[point] - transforms.centre(pose)
    local = np.einsum("kab,kb->ka", pose[:, :3, :3], ray)
    seen = np.zeros(len(point), bool)
    for key, view in views_of(cameras, tuning.visible.guessed_view_deg).items():
        own = np.flatnonzero(camera == key)
        seen[own] = in_view(view, 0.0, (ray[own], local[own]), proxy, point[own], tuning.visible)[0]
    share = np.bincount(look, seen, minlength=len(owner)) / np.maximum(count, 1)
    out = np.full(len(i), np.nan)
    out[there] = share.reshape(2, -1).max(axis=0)
    return out
