"""True orthophotos: each pixel from the image that shows it best, exposures compensated, seams blended.

The view of a surface in an image: a buffer of depths, and a score for every pixel of the raster that it sees."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from tiegraph.geometry import transforms
from tiegraph.geometry.stereo import Pinhole
from tiegraph.products.surface import Surface, Window, project
from tiegraph.products.tuning import OrthoTuning
from tiegraph.scene.results import APART_SIGMAS, DepthMap, border_share

_NOTHING = np.float32(1e30)  # a depth
_STEEPEST = 5.0  # tangent of the incidence angle, for the tolerance of its depth
_SMOOTH = 3  # blocks over which the slope of the surface is taken
_COVER = 2.0  # raster pixels in one of the buffer, whose pixels are as far apart as the points that are drawn
_AGREE = 7  # blocks for the share of those whose depth the image confirms
_LOOK = 16  # raster pixels between those that give the distance of the surface, and the most between points
_ANYWHERE = 1e9  # a sigma of w with which nothing hides a pixel
_BLOCKS = 2  # raster pixels along the edge of the blocks that are of one image, no larger than a pixel of a buffer
_TILE = 1024  # raster pixels along the edge of what is drawn at once, ...
_PIECE = 128  # ... and of the pieces of it that an image may see

Heights = Callable[[Window, int], np.ndarray]
"""w (rows, columns) of a window, or of its blocks of so many pixels; NaN = not known."""
_BLOCK, _FEW = 8, 500  # raster pixels along the edge of blocks whose colours tell exposures, of so many images ...
_MOST = 10_000  # ... and images whose exposures are told at all: a matrix of them all is solved

Seen = tuple[np.ndarray, float]
"""Of an image in a window: which of its blocks it sees, and its ``Buffer.fine``."""


@dataclass(frozen=True, eq=False)
class Buffer:
    """The view of an image: depth (h, w) f4 of the nearest surface; own (h, w) f4 the image's own depth and
    own_sigma (h, w) f2, NaN = not known; border (h, w) f2 the distance to the image border or mask as a share of the
    image's shorter side, 0 = masked; ``scale`` (2,) image pixels, across and down, of one of the buffer's, and how many
    image pixels a pixel of the raster has where it is nearest (``fine``)."""

    depth: np.ndarray
    own: np.ndarray
    own_sigma: np.ndarray
    border: np.ndarray
    scale: np.ndarray
    fine: float


def meets(camera: Pinhole, surface: Surface, window: Window) -> bool:
    """Whether a camera may see something of the box of a window."""
    low, high = surface.box(window)
    return bool(_meets(camera, low[None], high[None])[0])


def _meets(camera: Pinhole, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(M,) bool: whether a camera may see something of boxes with these corners (M, 3) in the world: it lies not
    outside one side of the field of view."""
    sides = np.stack([low, high])
    at = np.array(list(np.ndindex(2, 2, 2)))
    corners = np.stack([sides[at[:, k], :, k] for k in range(3)], axis=-1)  # (8, M, 3)
    x, y, z = np.moveaxis(transforms.transformed(camera.K @ camera.cam_from_world[:3], corners), -1, 0)
    width, height = camera.size
    outside = [z <= 0, x < 0, y < 0, x > width * z, y > height * z]
    return ~np.any([side.all(axis=0) for side in outside], axis=0)


def windows_met(camera: Pinhole, surface: Surface) -> list[Window]:
    """The tiles of a surface of which a camera may see something."""
    return [t for t in surface.windows(_TILE) if meets(camera, surface, t)]


@dataclass(frozen=True, eq=False)
class _Pieces:
    """The pieces of a window in which heights are known: rows and columns (M,) of their first pixels in it, and the
    corners (M, 3) of their boxes in the world."""

    row: np.ndarray
    column: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @staticmethod
    def of(surface: Surface, window: Window, w: np.ndarray) -> "_Pieces":
        """Of heights w (rows, columns) of a window."""
        found = []
        for row, column in np.ndindex(*(-(-s // _PIECE) for s in w.shape)):
            top, left = row * _PIECE, column * _PIECE
            piece = w[max(top - 1, 0) : top + _PIECE + 1, max(left - 1, 0) : left + _PIECE + 1]
            if np.isfinite(piece).any():
                ends = np.nanmin(piece), np.nanmax(piece)
                low, high = (np.r_[edge[:2], end] for edge, end in zip((surface.low, surface.high), ends))
                place = Window(window.row + top, window.column + left, rows=_PIECE, columns=_PIECE)
                found.append((top, left, *replace(surface, low=low, high=high).box(place)))
        top, left, low, high = (np.array(values) for values in zip(*found)) if found else np.zeros((4, 0, 3))
        return _Pieces(top, left, low=low, high=high)

    def seen_by(self, view: Pinhole) -> tuple[slice, slice]:
        """Rows and columns of the blocks that surround the pieces of which an image may see something, with a margin;
        none if there is none."""
        met = _meets(view, self.low, self.high)
        if not met.any():
            return slice(0, 0), slice(0, 0)
        ends = ((at[met].min() // _BLOCKS, (at[met].max() + _PIECE) // _BLOCKS) for at in (self.row, self.column))
        rows, columns = (slice(max(int(first) - _AGREE, 0), int(last) + _AGREE) for first, last in ends)
        return rows, columns


def draw(
    view: Pinhole, surface: Surface, heights: Heights, mask: np.ndarray, own: DepthMap | None, tuning: OrthoTuning
) -> Buffer | None:
    """The buffer of an image whose pixels may be used by ``mask`` (H, W) bool; ``own``: its depth map, if it has one.
    None if it sees nothing of the surface."""
    tiles = windows_met(view, surface)
    seen = [project(view, _points(surface, t, heights(t, _LOOK), _LOOK))[2] for t in tiles]
    seen = [z[np.isfinite(z)] for z in seen]
    if not (depths := np.concatenate([np.zeros(0), *seen])).size:
        return None
    closest = float(np.percentile(depths, 1))
    fine = max(1.0, surface.pixel_m * view.focal / closest)
    wide, high = (int(np.ceil(s / (_COVER * fine))) for s in view.size)
    size = (wide, high)
    scale = np.array(view.size) / size
    depth = np.full(size[::-1], _NOTHING)
    for tile, z in zip(tiles, seen):
        nearest = max(z.min(), closest) if z.size else closest
        step = max(1, round(min(scale.min() * nearest / (surface.pixel_m * view.focal), _LOOK)))
        around = tile.grown(step)
        for points in _drawn(surface, around, heights(around, step), step):
            x, y, z = project(view, points)
            there = np.isfinite(z)
            column = np.minimum((x[there] / scale[0]).astype(int), size[0] - 1)
            row = np.minimum((y[there] / scale[1]).astype(int), size[1] - 1)
            np.minimum.at(depth, (row, column), z[there].astype(np.float32))
    # What falls between two points is filled, and pixels at an edge show some of the nearer surface.
    depth = cv2.erode(depth, np.ones((3, 3), np.uint8))
    measured = np.full((2, *size[::-1]), np.nan, np.float32)
    if own is not None:
        for k, values in enumerate((own.depth_m, own.sigma_m)):
            measured[k] = cv2.resize(values, size, interpolation=cv2.INTER_NEAREST)
    near = {"own": measured[0], "own_sigma": measured[1].astype(np.float16)}
    border = border_share(mask, size).astype(np.float16)
    return Buffer(depth=depth, **near, border=border, scale=scale, fine=fine)


def _points(surface: Surface, window: Window, w: np.ndarray, step: int) -> np.ndarray:
    """World points (N, 3) of the known pixels of a window."""
    u, v = np.meshgrid(*surface.places(window, step))
    known = np.isfinite(w)
    return surface.frame.in_world(u[known], v[known], w[known])


def _drawn(surface: Surface, window: Window, w: np.ndarray, step: int) -> list[np.ndarray]:
    """World points (N, 3) of the blocks of a window, of ``step`` pixels each, and of the faces between neighbours that
    lie more than a block apart in w, as dense as the blocks."""
    u, v = np.meshgrid(*surface.places(window, step))
    out = [_points(surface, window, w, step)]
    uvw = np.stack([u, v, w], axis=-1)
    for a, b in ((uvw[:, :-1], uvw[:, 1:]), (uvw[:-1], uvw[1:])):
        rise = np.abs(b[..., 2] - a[..., 2]) / (step * surface.pixel_m)
        parts = np.where(rise > 1, np.ceil(np.nan_to_num(rise)), 0).astype(int)
        at = np.nonzero(parts)
        many = parts[at] - 1  # between a and b, which are pixels themselves
        place = 1 + np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
        share = place / np.repeat(many + 1, many)
        low, high = np.repeat(a[at], many, axis=0), np.repeat(b[at], many, axis=0)
        out.append(surface.frame.in_world(*(low + share[:, None] * (high - low)).T))
    return out


@dataclass(frozen=True, eq=False)
class Ground:
    """A window of a surface as input for images: world points (rows, columns, 3), NaN = not known, normals
    (rows, columns, 3) and directions of w (rows, columns, 3) in the world, sigma (rows, columns) of w."""

    xyz: np.ndarray
    normal: np.ndarray
    outwards: np.ndarray
    sigma: np.ndarray

    def part(self, where: tuple[slice, slice]) -> "Ground":
        """Some rows and columns."""
        return Ground(*(values[where] for values in vars(self).values()))

    @staticmethod
    def of(surface: Surface, window: Window, w: np.ndarray, sigma: np.ndarray, step: int = 1) -> "Ground":
        """Of heights and their sigmas (rows, columns), of the window's pixels or of blocks of ``step`` of them."""
        u, v = np.meshgrid(*surface.places(window, step))
        known = np.isfinite(w)
        mean = cv2.blur(np.where(known, w, 0.0), (_SMOOTH, _SMOOTH), borderType=cv2.BORDER_REFLECT)
        share = cv2.blur(known.astype(float), (_SMOOTH, _SMOOTH), borderType=cv2.BORDER_REFLECT)
        smooth = np.where(known, mean / np.where(known, share, 1.0), 0.0)
        gaps = cv2.erode(known.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0
        down, right = np.gradient(smooth, surface.pixel_m * step) if min(w.shape) > 1 else np.zeros((2, *w.shape))
        slope = np.stack([np.where(gaps, 0, -right), np.where(gaps, 0, down), np.ones_like(w)], axis=-1)
        gradients = surface.frame.gradients(u, v, smooth)
        normal = np.einsum("...i,...ij->...j", slope, gradients)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        outwards = gradients[..., 2, :] / np.linalg.norm(gradients[..., 2, :], axis=-1, keepdims=True)
        xyz = surface.frame.in_world(u, v, w)
        return Ground(xyz, normal, outwards=outwards, sigma=np.nan_to_num(sigma))


def score(view: Pinhole, buffer: Buffer, ground: Ground, surface: Surface, tuning: OrthoTuning) -> np.ndarray:
    """Score of an image for each pixel (rows, columns), 0 = not visible, 1 = from straight in front, no coarser than
    the raster and far from its border."""
    x, y, z = project(view, ground.xyz)
    there = np.isfinite(z)
    x, y, z = x[there], y[there], z[there]
    high, wide = buffer.depth.shape
    column = np.minimum(x / buffer.scale[0], wide - 1).astype(int)
    row = np.minimum(y / buffer.scale[1], high - 1).astype(int)
    towards = transforms.centre(view.cam_from_world) - ground.xyz[there]
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    front = np.einsum("nk,nk->n", towards, ground.normal[there])
    steep = np.minimum(np.sqrt(np.maximum(1 - front**2, 0)) / np.maximum(front, 1e-9), _STEEPEST)
    size = z / view.focal
    play = size * buffer.scale.max() * (1 + 2 * steep) + APART_SIGMAS * ground.sigma[there]
    behind = z - buffer.own[row, column]  # NaN where the image has no depth, which neither hides nor confirms
    close = play + APART_SIGMAS * buffer.own_sigma[row, column]
    free = (front > 0) & (z <= buffer.depth[row, column] + play) & ~(behind > close)
    free &= size < tuning.coarsest * surface.pixel_m
    away = np.maximum(np.sum(towards * ground.outwards[there], axis=-1), 0)
    good, seen, agrees = np.zeros(there.shape), np.zeros(there.shape, bool), np.zeros(there.shape, np.float32)
    good[there] = np.minimum(1, surface.pixel_m / size) * away**tuning.angle_power
    good[there] *= np.minimum(1, buffer.border[row, column] / tuning.border)
    seen[there], agrees[there] = free, free & (np.abs(behind) <= close)
    seen &= cv2.medianBlur((seen | ~there).astype(np.uint8), 3) > 0  # without specks in hidden areas
    share = cv2.blur(agrees, (_AGREE, _AGREE), borderType=cv2.BORDER_REFLECT)
    return np.where(seen, good * (tuning.unconfirmed + share), 0.0).astype(np.float32)


def ortho_margin(tuning: OrthoTuning) -> int:
    """Pixels around a window that affect its colours."""
    return 4 << tuning.bands


@dataclass(frozen=True, eq=False)
class Patch:
    """How an image shows the blocks of a surface: row and column of its first block, RGB (rows, columns, 3) u1, and
    where it sees them (rows, columns) bool."""

    row: int
    column: int
    rgb: np.ndarray
    seen: np.ndarray


@dataclass(frozen=True, eq=False)
class Images:
    """The images of an orthophoto: views, a buffer (None = sees nothing) and RGB (H, W, 3) u1 of each by its number,
    gains (N, 3) of their channels, and whether what none is judged to see, such as rough crowns, is made of the best
    one that has it in its frame."""

    views: Sequence[Pinhole]
    buffer: Callable[[int], Buffer | None]
    picture: Callable[[int], np.ndarray]
    gains: np.ndarray
    whole: bool = False


def block_px(images: int) -> int:
    """Raster pixels along the edge of the blocks for the exposures: larger for many images, whose blocks
    are in memory together."""
    return _BLOCK << max(0, math.ceil(math.log(max(images, 1) / _FEW, 4)))


def patch(
    view: Pinhole,
    buffer: Buffer,
    rgb: np.ndarray,
    surface: Surface,
    heights: Heights,
    block: int,
    tuning: OrthoTuning,
) -> Patch | None:
    """The view of an image on the blocks of a surface, of so many pixels; None if it sees none."""
    tiles = windows_met(view, surface)
    row, column = min(t.row for t in tiles), min(t.column for t in tiles)
    bottom, right = max(t.row + t.rows for t in tiles), max(t.column + t.columns for t in tiles)
    around = Window(row, column, rows=bottom - row, columns=right - column)
    w = heights(around, block)
    ground = Ground.of(surface, around, w, np.full(w.shape, block * surface.pixel_m), block)
    seen = score(view, buffer, ground, surface, tuning) > 0
    if not seen.any():
        return None
    rows, columns = (np.flatnonzero(seen.any(axis=k)) for k in (1, 0))
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    warped = warp(view, rgb, ground.xyz[part], block * buffer.fine)
    at = row // block + int(rows[0]), column // block + int(columns[0])
    return Patch(row=at[0], column=at[1], rgb=warped, seen=seen[part])


def gains(patches: Sequence[Patch | None]) -> np.ndarray:
    """(N, 3) by what the red, green and blue of each image are multiplied so that images agree where they overlap;
    1 where there are more than 10 000."""
    out = np.ones((len(patches), 3))
    there = [(k, p) for k, p in enumerate(patches) if p is not None]
    if not 2 <= len(there) <= _MOST:
        return out
    compensator = cv2.detail.ChannelsCompensator(5)  # times, each of what the one before left: each is drawn to 1
    corners, colours = [(p.column, p.row) for _, p in there], [p.rgb for _, p in there]
    seen = [p.seen.astype(np.uint8) * 255 for _, p in there]
    compensator.feed(corners, colours, seen)  # type: ignore[arg-type]  # arrays are images too
    found = np.array([np.ravel(g)[:3] for g in compensator.getMatGains()])
    out[[k for k, _ in there]] = np.clip(found / np.median(found, axis=0), 1 / 2, 2)
    return out


def warp(view: Pinhole, rgb: np.ndarray, xyz: np.ndarray, fine: float) -> np.ndarray:
    """Colours (rows, columns, 3) u1 of world points (rows, columns, 3) in an image; ``fine``: of how many of its pixels
    a pixel of the result is the mean."""
    x, y, _ = project(view, xyz)
    step = max(1, round(fine))
    small = rgb if step == 1 else cv2.resize(rgb, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)
    scale = np.array(small.shape[1::-1]) / rgb.shape[1::-1]
    at = (np.nan_to_num(x * scale[0], nan=-9) - 0.5).astype(np.float32), (y * scale[1] - 0.5).astype(np.float32)
    return cv2.remap(small, at[0], np.nan_to_num(at[1], nan=-9), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def ortho_tile(
    surface: Surface, window: Window, heights: np.ndarray, sigma: np.ndarray, images: Images, tuning: OrthoTuning
) -> tuple[np.ndarray, np.ndarray]:
    """RGBA (4, rows, columns) u1 and source (rows, columns) u2 of a window: 1 + the number of the view that each pixel
    is of, 0 = of none. ``heights`` and ``sigma`` are those of the window with its margin."""
    wide = ortho_margin(tuning)
    around = window.grown(wide)
    pieces, lowest = _Pieces.of(surface, around, heights), heights
    for axis in (0, 1):  # the lowest pixel of a block: an image that sees it sees the others
        lowest = np.fmin.reduceat(lowest, np.arange(0, heights.shape[axis], _BLOCKS), axis=axis)
    ground = Ground.of(surface, around, lowest, sigma[::_BLOCKS, ::_BLOCKS], _BLOCKS)
    best, source = np.zeros(lowest.shape, np.float32), np.zeros(lowest.shape, np.uint16)
    seen: dict[int, Seen] = {}
    left = np.isfinite(lowest)
    for anywhere in (False, True)[: 1 + images.whole]:
        tried = replace(ground, sigma=np.full(best.shape, _ANYWHERE)) if anywhere else ground
        for k, view in enumerate(images.views):
            where = pieces.seen_by(view) if meets(view, surface, around) else (slice(0, 0), slice(0, 0))
            buffer = images.buffer(k) if left[where].any() else None
            if buffer is None:
                continue
            found = np.where(left[where], score(view, buffer, tried.part(where), surface, tuning), 0)
            better = found > best[where]
            if better.any():
                own, _ = seen.setdefault(k, (np.zeros(best.shape, bool), buffer.fine))
                own[where] |= found > 0
                best[where][better], source[where][better] = found[better], k + 1
        left &= best == 0
    source = np.where(np.isfinite(heights), _pixels(source, heights.shape), 0).astype(np.uint16)
    xyz = surface.frame.in_world(*np.meshgrid(*surface.places(around)), heights)
    rgb = _blended(xyz, source, seen, images, tuning)
    inner = slice(wide, wide + window.rows), slice(wide, wide + window.columns)
    alpha = np.where(source > 0, 255, 0).astype(np.uint8)
    return np.concatenate([rgb, alpha[..., None]], axis=-1)[inner].transpose(2, 0, 1), source[inner]


def _pixels(blocks: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The values of blocks at their pixels (rows, columns)."""
    return blocks.repeat(_BLOCKS, axis=0).repeat(_BLOCKS, axis=1)[: shape[0], : shape[1]]


def _blended(
    xyz: np.ndarray, source: np.ndarray, seen: dict[int, Seen], images: Images, tuning: OrthoTuning
) -> np.ndarray:
    """RGB (rows, columns, 3) u1 of points (rows, columns, 3) by their sources (rows, columns), with blended seams;
    ``seen``: by image.

    Where an image does not see a pixel it gets the colour of the one that does, so that occlusions do not show; where
    none does all have that of the nearest pixel.
    """
    rgb = np.zeros((*source.shape, 3), np.uint8)
    if not (source > 0).any():
        return rgb
    nearest = distance_transform_edt(source == 0, return_distances=False, return_indices=True)
    owner, wide = source[tuple(nearest)], ortho_margin(tuning)
    warped: dict[int, tuple[tuple[slice, slice], np.ndarray]] = {}
    for k in (int(s) - 1 for s in np.unique(owner)):
        ends = (np.flatnonzero((owner == k + 1).any(axis=axis))[[0, -1]] for axis in (1, 0))
        rows, columns = (slice(max(0, first - wide), last + 1 + wide) for first, last in ends)
        part = rows, columns
        colours = warp(images.views[k], images.picture(k), xyz[part], seen[k][1])
        warped[k] = part, np.clip(np.rint(colours * images.gains[k]), 0, 255).astype(np.uint8)
        own = source[part] == k + 1
        rgb[part][own] = warped[k][1][own]
    if len(warped) < 2:
        return rgb
    around = rgb[tuple(nearest)].astype(np.int16)
    blender = cv2.detail.MultiBandBlender(0, tuning.bands)
    blender.prepare((0, 0, source.shape[1], source.shape[0]))
    for k, (part, colours) in warped.items():
        known = (source[part] > 0) & _pixels(seen[k][0], source.shape)[part]
        filled = np.where(known[..., None], colours, around[part])
        mask = np.where(owner[part] == k + 1, 255, 0).astype(np.uint8)
        blender.feed(filled, mask, (part[1].start, part[0].start))
    blended, _ = blender.blend(None, None)  # type: ignore[call-overload]  # it makes them
    return np.where(source[..., None] > 0, np.clip(blended, 0, 255), 0).astype(np.uint8)
