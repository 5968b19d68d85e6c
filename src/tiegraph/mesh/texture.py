"""Textures: the parts of images that faces have their colours from, laid out on a few pictures.

Faces that no image sees have 2 x 2 pixels each, between whose corners the colours of their vertices are interpolated.

Colours of patches are made equal where they meet: what is added to those of a patch varies smoothly over it, so that
two patches agree along their border (Lempitsky and Ivanov 2007; Waechter, Moehrle and Goesele 2014), by least squares
over all vertices of all patches.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags, identity
from scipy.sparse.linalg import cg

from tiegraph.errors import ReconstructionError
from tiegraph.geometry.stereo import Pinhole
from tiegraph.mesh.surface import Mesh
from tiegraph.mesh.tuning import TextureTuning
from tiegraph.mesh.views import UNSEEN, fragments, patches
from tiegraph.scene.sorting import Arrays

PAD = 2
"""Pixels around a patch, so that viewers that interpolate and reduce find its own colours."""
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 92)
_BARE = 4  # pixels along the edge of what an unseen face has, with its border
_FULL = 0.9  # share of the textures that rectangles may fill
_ALONG = 8  # places along the edge of a seam whose colours are compared
_ROWS = 1 << 14  # places that OpenCV takes at once


@dataclass(frozen=True, eq=False)
class Layout(Arrays):
    """Where patches are. patch (F,) of each face, UNSEEN = none; of each patch image (P,), its rectangle there by low
    (P, 2) and size (P, 2) in whole pixels; its rectangle on the textures by page (P,), at (P, 2) and inner (P, 2)
    pixels, without the border. Of the unseen faces in their order bare_page (U,) and bare_at (U, 2). pages (T, 2):
    width and height of the textures."""

    patch: np.ndarray
    image: np.ndarray
    low: np.ndarray
    size: np.ndarray
    page: np.ndarray
    at: np.ndarray
    inner: np.ndarray
    bare_page: np.ndarray
    bare_at: np.ndarray
    pages: np.ndarray


@dataclass(frozen=True, eq=False)
class Nodes(Arrays):
    """The places whose colours are levelled: vertex (N,) and patch (N,), sorted by patch; corner (F, 3) the node of
    each face's corners, -1 of an unseen one; seam (S, 4) the nodes of the edges where two patches meet: both ends in
    one and both in the other; beside (S, 2) the vertices that these edges' faces have beside them."""

    vertex: np.ndarray
    patch: np.ndarray
    corner: np.ndarray
    seam: np.ndarray
    beside: np.ndarray


def laid_out(mesh: Mesh, label: np.ndarray, views: Sequence[Pinhole], edge: int, most: int) -> Layout:
    """The patches of a mesh on at most ``most`` textures with an ``edge`` of so many pixels. Raises ReconstructionError
    if there are too many for any size."""
    pairs = mesh.neighbours()
    number = patches(label, pairs)
    seen = label != UNSEEN
    patch = np.full(len(label), UNSEEN)
    _, first, patch[seen] = np.unique(number[seen], return_index=True, return_inverse=True)
    image = label[seen][first]
    low, size, pixel = _rectangles(mesh, patch, image, views)
    bare = int(np.count_nonzero(~seen))
    columns = int(np.clip(np.ceil(np.sqrt(bare)), 1, edge // _BARE))
    block = np.array([[_BARE * columns, _BARE * -(-bare // columns)]] if bare else np.zeros((0, 2)), int)
    inner, (page, at, pages) = _fitting(size, pixel, block, edge, most)
    k = np.arange(bare)
    return Layout(
        patch=patch,
        image=image,
        low=low,
        size=size,
        page=page[: len(size)],
        at=at[: len(size)] + PAD,
        inner=inner,
        bare_page=np.full(bare, page[-1] if bare else 0),
        bare_at=(at[-1] if bare else 0) + _BARE * np.stack([k % columns, k // columns], axis=1) + 1,
        pages=pages,
    )


def _rectangles(
    mesh: Mesh, patch: np.ndarray, image: np.ndarray, views: Sequence[Pinhole]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each patch the rectangle in its image, low (P, 2) and size (P, 2), and how large (P,) a pixel of it is."""
    low, high = np.full((len(image), 2), np.inf), np.full((len(image), 2), -np.inf)
    total = np.zeros((2, len(image)))
    of_image = np.where(patch == UNSEEN, UNSEEN, image[patch] if len(image) else UNSEEN)
    for k in np.unique(image):
        face = np.flatnonzero(of_image == k)
        xy, z = views[k].project(mesh.xyz[mesh.corners[face]])
        np.minimum.at(low, patch[face], xy.min(axis=1))
        np.maximum.at(high, patch[face], xy.max(axis=1))
        np.add.at(total[0], patch[face], z.mean(axis=1) / views[k].focal)
        np.add.at(total[1], patch[face], 1.0)
    first = np.maximum(np.floor(low), 0).astype(int)
    return first, np.maximum(np.ceil(high).astype(int) - first, 1), total[0] / np.maximum(total[1], 1.0)


def _fitting(
    size: np.ndarray, pixel: np.ndarray, block: np.ndarray, edge: int, most: int
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Sizes (P, 2) of the patches with which they and a block (0 or 1, 2) fit on the textures, and where all are
    (``pack``)."""
    texel = _texel(size, pixel, _FULL * most * edge**2)
    while True:
        scale = np.minimum(1.0, pixel / texel if texel else 1.0)
        scale = np.minimum(scale, (edge - 2 * PAD) / size.max(axis=1, initial=1))
        inner = np.maximum(np.floor(size * scale[:, None] + 1e-9), 1).astype(int)
        packed = pack(np.concatenate([inner + 2 * PAD, block]), edge)
        if len(packed[2]) <= most:
            return inner, packed
        if inner.max(initial=1) == 1:
            raise ReconstructionError(
                f"{len(size)} patches do not fit on {most} textures of {edge} pixels: raise --mesh.texture-px"
            )
        texel = max(texel, float(pixel.min())) * 1.05  # how much coarser it is tried again where they do not fit


def _texel(size: np.ndarray, pixel: np.ndarray, area: float) -> float:
    """The size of a pixel of the textures at which all patches have an area; 0 = as in the images."""

    def filled(texel: float) -> float:
        scale = np.minimum(1.0, pixel / texel)
        return float(np.prod(size * scale[:, None] + 2 * PAD, axis=1).sum())

    if not len(size) or filled(float(pixel.min())) <= area:
        return 0.0
    low, high = float(pixel.min()), float(pixel.max()) * 1e3
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if filled(middle) > area else (low, middle)
    return high


def pack(size: np.ndarray, edge: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rectangles (P, 2) put on shelves, the highest first: the texture (P,) and the place (P, 2) of each, and the sizes
    (T, 2) of the textures."""
    area = float(np.prod(size, axis=1).sum())
    wide = int(min(edge, max(np.ceil(np.sqrt(area / _FULL)), size.max(initial=4))))
    page, at = np.zeros(len(size), int), np.zeros((len(size), 2), int)
    shelf_page, shelf_y, shelf_x = ([] for _ in range(3))  # type: list[int], list[int], list[int]
    room = np.zeros(0, int)
    top = [0]
    for k in np.lexsort((np.arange(len(size)), -size[:, 0], -size[:, 1])):
        width, height = size[k]
        fits = np.flatnonzero(room >= width)
        if not len(fits):
            if top[-1] + height > edge:
                top.append(0)
            shelf_page.append(len(top) - 1)
            shelf_y.append(top[-1])
            shelf_x.append(0)
            top[-1] += height
            room = np.append(room, wide)
            fits = np.array([len(room) - 1])
        s = int(fits[0])
        page[k], at[k] = shelf_page[s], (shelf_x[s], shelf_y[s])
        shelf_x[s] += int(width)
        room[s] -= width
    return page, at, np.array([[wide, max(t, 1)] for t in top])


def places(mesh: Mesh, layout: Layout, views: Sequence[Pinhole]) -> tuple[np.ndarray, np.ndarray]:
    """Where the corners of faces are on the textures: (F, 3, 2) pixels, and the texture (F,) of each face."""
    uv, page = np.zeros((len(mesh.corners), 3, 2)), np.zeros(len(mesh.corners), int)
    for k in np.unique(layout.image):
        face = own_faces(layout, k)
        patch = layout.patch[face]
        xy = views[k].project(mesh.xyz[mesh.corners[face]])[0]
        scale = layout.inner[patch] / layout.size[patch]
        uv[face] = layout.at[patch][:, None] + (xy - layout.low[patch][:, None]) * scale[:, None]
        page[face] = layout.page[patch]
    bare = np.flatnonzero(layout.patch == UNSEEN)
    uv[bare] = layout.bare_at[:, None] + np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]])
    page[bare] = layout.bare_page
    return uv, page


def nodes_of(mesh: Mesh, layout: Layout) -> Nodes:
    """The vertices of each patch."""
    seen = layout.patch != UNSEEN
    count = np.int64(max(len(mesh.xyz), 1))
    found, back = np.unique(layout.patch[seen][:, None] * count + mesh.corners[seen], return_inverse=True)
    corner = np.full(mesh.corners.shape, UNSEEN)
    corner[seen] = back.reshape(-1, 3)
    pairs = mesh.neighbours()
    patch = layout.patch[pairs]
    pairs = pairs[(patch[:, 0] != patch[:, 1]) & (patch != UNSEEN).all(axis=1)]
    a, b = mesh.corners[pairs[:, 0]], mesh.corners[pairs[:, 1]]
    same = a[:, :, None] == b[:, None, :]  # (S, 3, 3) which corners are one vertex
    ends = np.argsort(~same.any(axis=2), axis=1, kind="stable")[:, :2]
    row = np.arange(len(pairs))[:, None]
    others = same[row, ends].argmax(axis=2)
    seam = np.concatenate([corner[pairs[:, :1], ends], corner[pairs[:, 1:], others]], axis=1)
    beside = np.stack([a[row[:, 0], 3 - ends.sum(axis=1)], b[row[:, 0], 3 - others.sum(axis=1)]], axis=1)
    return Nodes(vertex=found % count, patch=found // count, corner=corner, seam=seam, beside=beside)


def cut_out(rgb: np.ndarray, layout: Layout, k: int) -> list[np.ndarray]:
    """The rectangles (h, w, 3) u1 of the patches of image ``k``, with their borders, in their order."""
    out = []
    for p in np.flatnonzero(layout.image == k):
        (x, y), (width, height) = layout.low[p], layout.size[p]
        scale = layout.size[p] / layout.inner[p]
        wide = np.ceil(PAD * scale).astype(int)
        whole = cv2.copyMakeBorder(
            rgb[max(y - wide[1], 0) : y + height + wide[1], max(x - wide[0], 0) : x + width + wide[0]],
            max(wide[1] - y, 0),
            max(y + height + wide[1] - rgb.shape[0], 0),
            max(wide[0] - x, 0),
            max(x + width + wide[0] - rgb.shape[1], 0),
            cv2.BORDER_REPLICATE,
        )
        # of the border just the share that PAD pixels of the texture have
        size = layout.inner[p] + 2 * PAD
        shift = wide - PAD * scale
        move = np.array([[scale[0], 0, shift[0] + scale[0] / 2 - 0.5], [0, scale[1], shift[1] + scale[1] / 2 - 0.5]])
        coarser = float(scale.max())
        if coarser > 1.2:  # smoothed to the distance of the pixels
            whole = cv2.GaussianBlur(whole, (0, 0), 0.45 * np.sqrt(coarser**2 - 1))
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        out.append(
            cv2.warpAffine(whole, move, (int(size[0]), int(size[1])), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        )
    return out


def own_faces(layout: Layout, k: int) -> np.ndarray:
    """Numbers of the faces that have their colours from image ``k``."""
    return np.flatnonzero((layout.patch != UNSEEN) & (layout.image[layout.patch] == k))


def own_sides(layout: Layout, nodes: Nodes, k: int) -> np.ndarray:
    """(M, 2) numbers of the seams that patches of image ``k`` have, and of which side, 0 or 1, they are."""
    return np.argwhere(layout.image[nodes.patch[nodes.seam[:, [0, 2]]]] == k)


def edge_colours(rgb: np.ndarray, mesh: Mesh, nodes: Nodes, sides: np.ndarray, view: Pinhole) -> np.ndarray:
    """RGB (M, 3) f4 that an image has along the edges of seams on its sides (M, 2), the mean of each; within its own
    face, by 0.15 of its height, for beyond the edge may be the background."""
    ends = mesh.xyz[nodes.vertex[nodes.seam[sides[:, 0], :2]]]
    share = (np.arange(_ALONG) + 0.5) / _ALONG
    places = ends[:, :1] + share[:, None] * (ends[:, 1:] - ends[:, :1])
    places += 0.15 * (mesh.xyz[nodes.beside[tuple(sides.T)]] - ends.mean(axis=1))[:, None]
    return _sampled(rgb, view.project(places.reshape(-1, 3))[0]).reshape(-1, _ALONG, 3).mean(axis=1)


def face_colours(rgb: np.ndarray, mesh: Mesh, faces: np.ndarray, view: Pinhole) -> np.ndarray:
    """RGB (M, 3) f4 that an image has in the middle of faces."""
    return _sampled(rgb, view.project(mesh.xyz[mesh.corners[faces]].mean(axis=1))[0])


def _sampled(rgb: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """RGB (N, 3) f4 of an image between its pixels."""
    at = xy.astype(np.float32) - np.float32(0.5)
    parts = [at[s : s + _ROWS] for s in range(0, len(at), _ROWS)]
    out = [cv2.remap(rgb, p[:, :1], p[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for p in parts]
    return np.concatenate([np.zeros((0, 3), np.float32), *(o.reshape(-1, 3).astype(np.float32) for o in out)])


def levelled_chart(chart: np.ndarray, xy: np.ndarray, change: np.ndarray) -> np.ndarray:
    """A patch's rectangle with what levelling adds: faces (N, 3, 2) in its pixels, changes (N, 3, 3) of the colours at
    their corners. Around the faces as at the nearest."""
    shape = chart.shape[:2]
    total = np.zeros((*shape, 3), np.float32)
    known = np.zeros(shape, bool)
    for drawn in fragments(xy, shape, slack=0.01):
        total[drawn.row, drawn.column] = np.einsum("nk,nkc->nc", drawn.weight, change[drawn.triangle])
        known[drawn.row, drawn.column] = True
    if not known.any():  # smaller than a pixel
        total[:] = change.mean(axis=(0, 1))
    elif not known.all():
        away = (~known).astype(np.uint8)
        near = cv2.distanceTransformWithLabels(away, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[1]
        of_label = np.zeros((near.max() + 1, 3), np.float32)
        of_label[near[known]] = total[known]
        total = of_label[near]
    return np.clip(np.rint(chart + total), 0, 255).astype(np.uint8)


def bare_blocks(rgb: np.ndarray) -> np.ndarray:
    """(U, 4, 4, 3) u1 pixels of unseen faces whose corners have the colours (U, 3, 3) u1."""
    a, b, c = (rgb[:, k].astype(float) for k in range(3))
    inner = np.stack([np.stack([a, b], axis=1), np.stack([c, b + c - a], axis=1)], axis=1)
    return np.clip(np.rint(np.pad(inner, ((0, 0), (1, 1), (1, 1), (0, 0)), mode="edge")), 0, 255).astype(np.uint8)


def levelled(nodes: Nodes, edges: np.ndarray, tuning: TextureTuning) -> np.ndarray:
    """(N, 3) what is added to the colours of nodes, by the colours (S, 2, 3) that both patches of each seam have along
    it."""
    count = len(nodes.vertex)
    if not count:
        return np.zeros((0, 3))
    corner = nodes.corner[nodes.corner[:, 0] != UNSEEN]
    inside = np.unique(np.sort(corner[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    across = _rows(nodes.seam, np.array([0.5, 0.5, -0.5, -0.5]), count)
    along = _rows(inside, np.sqrt(tuning.smooth) * np.array([1.0, -1.0]), count)
    # 1e-4: colours stay where no border tells
    system = (across.T @ across + along.T @ along + 1e-4 * identity(count)).tocsr()
    wanted = across.T @ (edges[:, 1] - edges[:, 0])
    inverse = diags(1 / system.diagonal())
    solved = [cg(system, wanted[:, c], rtol=1e-4, maxiter=1000, M=inverse)[0] for c in range(3)]
    return np.stack(solved, axis=1)


def _rows(nodes: np.ndarray, weights: np.ndarray, count: int) -> csr_matrix:
    """(M, count) of equations between nodes (M, K) with weights (K,)."""
    row = np.repeat(np.arange(len(nodes)), nodes.shape[1])
    return coo_matrix((np.tile(weights, len(nodes)), (row, nodes.ravel())), (len(nodes), count)).tocsr()


def vertex_mean(mesh: Mesh, nodes: Nodes, change: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) u1 colours of the vertices: the mean of the colours (F, 3) of the faces around, NaN = not known, with what
    was added to them; that of the mesh where none is known."""
    known = np.isfinite(faces[:, 0])
    level = faces[known] + change[nodes.corner[known]].mean(axis=1)
    total = np.zeros(mesh.rgb.shape)
    for k in range(3):
        np.add.at(total, mesh.corners[known, k], level)
    count = np.bincount(mesh.corners[known].ravel(), minlength=len(total))[:, None]
    mean = np.where(count > 0, total / np.maximum(count, 1), mesh.rgb)
    return np.clip(np.rint(mean), 0, 255).astype(np.uint8)
