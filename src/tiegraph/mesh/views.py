"""Which image each face has its colour from.

Neighbours agree on few images by a Potts field over the faces, solved by its mean field.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from tiegraph.geometry import transforms
from tiegraph.geometry.stereo import Pinhole
from tiegraph.mesh.surface import Mesh, hanging, pieces
from tiegraph.mesh.tuning import ViewTuning
from tiegraph.scene.results import APART_SIGMAS, DepthMap, border_share
from tiegraph.scene.sorting import Arrays, spread

UNSEEN = -1
_STEEPEST = 5.0  # tangent of the angle at which a face is seen, for how far its depth may be off
_AROUND_PX = 16  # pixels of a buffer along the edge of a cell, in which places are counted whose depth it confirms
_FACES = 200_000  # drawn at once
_PIXELS = 4_000_000  # pixels that are looked at together: bounds the memory to some 300 MB


@dataclass(frozen=True, eq=False)
class Seen(Arrays):
    """The faces (N,) that an image sees whole, and how well (N,) f4 it shows each: pixels in a unit of length,
    weighted."""

    face: np.ndarray
    quality: np.ndarray


def seen_by(camera: Pinhole, mesh: Mesh, mask: np.ndarray, own: DepthMap | None, tuning: ViewTuning) -> Seen:
    """The faces of a mesh that an image sees whole, through the pixels of ``mask`` (H, W) bool; ``own``: its depth map,
    if it has one."""
    xy, z = camera.project(mesh.xyz)
    shrunk = min(1.0, 1600 / max(camera.size))  # pixels along the longer side of a buffer: bounds its memory and time
    size = (max(1, round(camera.size[0] * shrunk)), max(1, round(camera.size[1] * shrunk)))
    scale = np.array(camera.size) / size
    corners = mesh.corners
    with np.errstate(invalid="ignore"):
        out = [xy[:, 0] < 0, xy[:, 1] < 0, xy[:, 0] > camera.size[0], xy[:, 1] > camera.size[1]]
    faces = np.flatnonzero(camera.inside(xy)[corners].all(axis=1))
    beside = np.any([side[corners].all(axis=1) for side in out], axis=0)
    touching = (z > 0)[corners].all(axis=1) & ~beside
    depth = _drawn(xy / scale, z, corners[touching], size[::-1])
    middle = mesh.xyz[corners[faces]].mean(axis=1)
    towards = transforms.centre(camera.cam_from_world) - middle
    distance = np.linalg.norm(towards, axis=1)
    front = np.einsum("nk,nk->n", towards, mesh.normals[faces]) / np.where(distance > 0, distance, 1.0)
    faces, middle, front = faces[front > 0], middle[front > 0], front[front > 0]
    steep = np.minimum(np.sqrt(np.maximum(1 - front**2, 0)) / front, _STEEPEST)
    at, deep = camera.project(middle)
    pixel = deep / camera.focal
    play = pixel * scale.max() * (1 + 2 * steep)
    rough = float(np.sqrt(np.median(np.linalg.norm(mesh.across, axis=1)))) if len(mesh.corners) else 0.0
    free, plain = np.ones(len(faces), bool), np.ones(len(faces), bool)
    for k in range(4):  # corners and middle
        place, there = (xy[corners[faces, k]], z[corners[faces, k]]) if k < 3 else (at, deep)
        column, row = (np.clip((place / scale).astype(int)[:, a], 0, size[a] - 1) for a in (0, 1))
        plain &= there <= depth[row, column] + play
        free &= there <= depth[row, column] + play + rough
    confirmed = _confirmed(own, at, deep, play, camera.size)
    away = border_share(mask, size)[tuple(np.clip((at / scale).astype(int)[:, a], 0, size[a] - 1) for a in (1, 0))]
    free &= (away > 0) & (confirmed >= 0)
    inner = np.minimum(1.0, away / tuning.border)
    share = _share_around(at / scale, confirmed, size)
    quality = front**tuning.angle_power / pixel * inner * (tuning.unsure + share)
    quality *= np.where(plain, 1.0, tuning.unsure)
    return Seen(faces[free], quality[free].astype(np.float32))


def _drawn(xy: np.ndarray, z: np.ndarray, corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Depths (rows, columns) of the nearest faces; pixels at an edge have those of what lies before it."""
    depth = np.full(shape, np.inf)
    for k in range(0, len(corners), _FACES):
        some = corners[k : k + _FACES]
        for drawn in fragments(xy[some], shape, slack=0.01):
            inverse = np.einsum("nk,nk->n", drawn.weight, 1 / z[some[drawn.triangle]])
            np.minimum.at(depth, (drawn.row, drawn.column), 1 / inverse)
    return cv2.erode(depth, np.ones((3, 3), np.uint8))


def _confirmed(
    own: DepthMap | None, at: np.ndarray, deep: np.ndarray, play: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """(N,) 1 where the image's own depth is that of the places, 0 where it has none, -1 where it lies before them."""
    if own is None:
        return np.zeros(len(at))
    high, wide = own.depth_m.shape
    ratio = np.array([wide, high]) / np.array(size)
    column, row = (np.clip((at * ratio).astype(int)[:, a], 0, (wide, high)[a] - 1) for a in (0, 1))
    behind = deep - own.depth_m[row, column]
    close = play * max(1.0, 1 / float(ratio.min())) + APART_SIGMAS * own.sigma_m[row, column]
    with np.errstate(invalid="ignore"):
        return np.where(behind > close, -1.0, np.where(np.abs(behind) <= close, 1.0, 0.0))


def _share_around(at: np.ndarray, confirmed: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(N,) share of the places around each, pixels (N, 2) of the buffer, whose depth the image confirms: whether it has
    a depth in just one place says little."""
    wide, high = (s // _AROUND_PX + 1 for s in size)
    column, row = (np.clip((at[:, a] // _AROUND_PX).astype(int), 0, (wide, high)[a] - 1) for a in (0, 1))
    there = [np.bincount(row * wide + column, w, wide * high).reshape(high, wide) for w in (confirmed > 0, None)]
    total = [cv2.GaussianBlur(t.astype(float), (0, 0), 1.0, borderType=cv2.BORDER_CONSTANT) for t in there]
    smooth = cv2.resize(total[0] / np.maximum(total[1], 1e-12), None, fx=_AROUND_PX, fy=_AROUND_PX)
    return np.asarray(smooth[tuple(np.clip(at[:, a].astype(int), 0, size[a] - 1) for a in (1, 0))])


def chosen(seen: list[Seen], mesh: Mesh, tuning: ViewTuning) -> np.ndarray:
    """(F,) number of the image that each face has its colour from, UNSEEN = none sees it."""
    table = _best(seen, len(mesh.corners))
    pairs = mesh.neighbours()
    label = _agreed(table, pairs, tuning)
    for _ in range(3):  # small patches go to their neighbours
        label = _absorbed(label, table, pairs, tuning.least_faces)
    return label


def _best(seen: list[Seen], faces: int) -> csr_matrix:
    """(F, K) how well the best images show a face, 1 = the best; what is stored is seen."""
    face = np.concatenate([s.face for s in seen]) if seen else np.zeros(0, int)
    view = np.repeat(np.arange(len(seen)), [len(s.face) for s in seen])
    quality = np.concatenate([s.quality for s in seen]) if seen else np.zeros(0)
    quality = np.maximum(quality, 1e-12)
    order = np.lexsort((view, -quality, face))
    face, view, quality = face[order], view[order], quality[order]
    first = np.searchsorted(face, face)
    kept = np.arange(len(face)) - first < 8  # the best views of a face are compared
    shape = (faces, max(len(seen), 1))
    return coo_matrix(((quality / quality[first])[kept], (face[kept], view[kept])), shape).tocsr()


def _agreed(table: csr_matrix, pairs: np.ndarray, tuning: ViewTuning) -> np.ndarray:
    """The best label of each face beside its neighbours': the mean field of a Potts model."""
    faces = table.shape[0]
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    beside = coo_matrix((np.ones(len(ends)), ends.T), (faces, faces)).tocsr()
    beside.data /= np.maximum(np.diff(beside.indptr), 1)[np.repeat(np.arange(faces), np.diff(beside.indptr))]
    row = np.repeat(np.arange(faces), np.diff(table.indptr))
    belief = _normalised(table.data, row, faces)
    for k in range(tuning.rounds):  # ever more strongly, or each would hold on to what its next neighbours had at first
        around = beside @ csr_matrix((belief, table.indices, table.indptr), table.shape)
        wish = np.asarray(around[row, table.indices]).ravel() if len(row) else belief
        belief = _normalised(table.data * np.exp(tuning.together * (k + 1) / tuning.rounds * wish), row, faces)
    label = np.full(faces, UNSEEN)
    order = np.lexsort((table.indices, belief, row))  # the last of each row is its best
    label[row[order]] = table.indices[order]
    return label


def _normalised(values: np.ndarray, row: np.ndarray, rows: int) -> np.ndarray:
    total = np.bincount(row, values, rows)
    return np.asarray(values / total[row])


def _absorbed(label: np.ndarray, table: csr_matrix, pairs: np.ndarray, least: int) -> np.ndarray:
    """Small patches given to the neighbouring image that sees most of their faces, face by face where it sees them."""
    patch = patches(label, pairs)
    small = np.bincount(patch)[patch] < least
    out = label.copy()
    a, b = np.concatenate([pairs, pairs[:, ::-1]]).T
    across = small[a] & (label[a] != label[b]) & (label[b] != UNSEEN)
    where = (patch[a[across]], label[b[across]])
    wish = coo_matrix((np.ones(len(where[0])), where), (patch.max() + 1, table.shape[1])).tocsr()
    loud = np.asarray(wish.argmax(axis=1)).ravel()
    face = np.flatnonzero(small & (np.diff(wish.indptr)[patch] > 0))
    if len(face):
        sees = np.asarray(table[face, loud[patch[face]]]).ravel() > 0
        out[face[sees]] = loud[patch[face[sees]]]
    return out


def patches(label: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """(F,) number of the connected patch of one image that a face is of."""
    same = label[pairs[:, 0]] == label[pairs[:, 1]]
    return pieces(len(label), pairs[same])


def without_bubbles(mesh: Mesh, label: np.ndarray) -> np.ndarray:
    """(F,) bool, False for what no image sees and what reaches the border of the mesh: there it is a guess. What is
    unseen in the midst of seen faces, such as a crack, stays."""
    return ~hanging(mesh, label == UNSEEN)


@dataclass(frozen=True, eq=False)
class Fragments:
    """Pixels of triangles: triangle (N,), row (N,), column (N,), and the weights (N, 3) of the triangle's corners at
    the pixel's middle."""

    triangle: np.ndarray
    row: np.ndarray
    column: np.ndarray
    weight: np.ndarray


def fragments(xy: np.ndarray, shape: tuple[int, int], slack: float = 0.0) -> Iterator[Fragments]:
    """The pixels whose middles lie in triangles (T, 3, 2), whose corners are in pixels (0, 0 = the corner of the first
    pixel), of a raster of ``shape`` (rows, columns); a few million at a time. ``slack``: how far outside, as a weight,
    a middle may lie."""
    low = np.clip(np.ceil(xy.min(axis=1) - 0.5 - slack), 0, None).astype(np.int64)
    high = np.floor(xy.max(axis=1) - 0.5 + slack).astype(np.int64)
    size = np.maximum(np.minimum(high, np.array(shape[::-1]) - 1) - low + 1, 0)
    count = size[:, 0] * size[:, 1]
    ends = np.cumsum(count)
    start = 0
    while start < len(xy):
        done = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, done + _PIXELS, "right")), start + 1)
        triangle = np.repeat(np.arange(start, stop), count[start:stop])
        down, right = np.divmod(spread(np.zeros(stop - start, int), count[start:stop]), size[triangle, 0])
        column, row = low[triangle, 0] + right, low[triangle, 1] + down
        a, b, c = (xy[start:stop, k] for k in range(3))
        own = triangle - start
        with np.errstate(divide="ignore", invalid="ignore"):  # a triangle without an area has none
            area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
            dx, dy = column + 0.5 - a[own, 0], row + 0.5 - a[own, 1]
            second = (dx * (c[:, 1] - a[:, 1])[own] - dy * (c[:, 0] - a[:, 0])[own]) / area[own]
            third = (dy * (b[:, 0] - a[:, 0])[own] - dx * (b[:, 1] - a[:, 1])[own]) / area[own]
        weight = np.stack([1 - second - third, second, third], axis=1)  # barycentric
        inside = (weight >= -slack).all(axis=1)
        if inside.any():
            yield Fragments(triangle[inside], row=row[inside], column=column[inside], weight=weight[inside])
        start = stop
