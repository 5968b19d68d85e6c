"""True orthophotos: each pixel from the image that shows it best, exposures compensated, seams blended."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from tiegraph.products.surface import Surface, View, Window, project
from tiegraph.products.tuning import OrthoTuning
from tiegraph.products.visibility import Buffer, Ground, Heights, meets, score, windows_met

_BLOCK, _FEW = 8, 500  # raster pixels along the edge of blocks whose colours tell exposures, of so many images ...
_MOST = 10_000  # ... and images whose exposures are told at all: a matrix of them all is solved
_FEEDS = 5  # times the exposures are compensated, each of what the one before has left: each is drawn to 1
_LARGEST_GAIN = 2.0  # of an exposure, either way

Pictures = Callable[[int], np.ndarray]
"""RGB (H, W, 3) u1 of a view by its number."""


def ortho_margin(tuning: OrthoTuning) -> int:
    """Pixels around a window that decide about its colours."""
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
    """The images of an orthophoto: views, a buffer (None = sees nothing) and a picture of each by its number, and gains
    (N, 3) of their channels."""

    views: Sequence[View]
    buffer: Callable[[int], Buffer | None]
    picture: Pictures
    gains: np.ndarray


def block_px(images: int) -> int:
    """Raster pixels along the edge of the blocks whose colours tell the exposures: larger for many images, whose blocks
    are in memory together."""
    return _BLOCK << max(0, math.ceil(math.log(max(images, 1) / _FEW, 4)))


@dataclass(frozen=True, eq=False)
class _Seen:
    """Which pixels of a window an image sees, as packed bits, and its ``Buffer.fine``."""

    pixels: np.ndarray
    fine: float


def patch(
    view: View,
    buffer: Buffer,
    rgb: np.ndarray,
    surface: Surface,
    heights: Heights,
    block: int,
    tuning: OrthoTuning,
) -> Patch | None:
    """What an image shows of the blocks of so many pixels of a surface; None if it sees none."""
    tiles = windows_met(view.camera, surface)
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
    compensator = cv2.detail.ChannelsCompensator(_FEEDS)
    corners, colours = [(p.column, p.row) for _, p in there], [p.rgb for _, p in there]
    seen = [p.seen.astype(np.uint8) * 255 for _, p in there]
    compensator.feed(corners, colours, seen)  # type: ignore[arg-type]  # arrays are images too
    found = np.array([np.ravel(g)[:3] for g in compensator.getMatGains()])
    out[[k for k, _ in there]] = np.clip(found / np.median(found, axis=0), 1 / _LARGEST_GAIN, _LARGEST_GAIN)
    return out


def warp(view: View, rgb: np.ndarray, xyz: np.ndarray, fine: float) -> np.ndarray:
    """Colours (rows, columns, 3) u1 of world points (rows, columns, 3) in an image; ``fine``: of how many of its pixels
    a pixel of the result is the mean."""
    x, y, _ = project(view.camera, xyz)
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
    ground = Ground.of(surface, window.grown(wide), heights, sigma)
    best, source = np.zeros(heights.shape, np.float32), np.zeros(heights.shape, np.uint16)
    seen: dict[int, _Seen] = {}
    for k, view in enumerate(images.views):
        buffer = images.buffer(k) if meets(view.camera, surface, window.grown(wide)) else None
        if buffer is None:
            continue
        found = score(view, buffer, ground, surface, tuning)
        better = found > best
        if better.any():
            seen[k] = _Seen(np.packbits(found > 0), buffer.fine)
            best[better], source[better] = found[better], k + 1
    rgb = _blended(ground, source, seen, images, tuning)
    inner = slice(wide, wide + window.rows), slice(wide, wide + window.columns)
    alpha = np.where(source > 0, 255, 0).astype(np.uint8)
    return np.concatenate([rgb, alpha[..., None]], axis=-1)[inner].transpose(2, 0, 1), source[inner]


def _blended(
    ground: Ground, source: np.ndarray, seen: dict[int, _Seen], images: Images, tuning: OrthoTuning
) -> np.ndarray:
    """RGB (rows, columns, 3) u1 by the sources (rows, columns), with blended seams.

    Where an image does not see a pixel it has the colour of the one that does, lest what hides it shines through; where
    none does all have that of the nearest pixel, lest what is not there does.
    """
    rgb = np.zeros((*source.shape, 3), np.uint8)
    warped: dict[int, np.ndarray] = {}
    for k in (int(s) - 1 for s in np.unique(source) if s):
        colours = warp(images.views[k], images.picture(k), ground.xyz, seen[k].fine)
        warped[k] = np.clip(np.rint(colours * images.gains[k]), 0, 255).astype(np.uint8)
        rgb[source == k + 1] = warped[k][source == k + 1]
    if len(warped) < 2:
        return rgb
    nearest = distance_transform_edt(source == 0, return_distances=False, return_indices=True)
    owner, around = source[tuple(nearest)], rgb[tuple(nearest)]
    blender = cv2.detail.MultiBandBlender(0, tuning.bands)
    blender.prepare((0, 0, source.shape[1], source.shape[0]))
    for k, colours in warped.items():
        visible = np.unpackbits(seen[k].pixels, count=source.size).reshape(source.shape) > 0
        filled = np.where((visible & (source > 0))[..., None], colours, around).astype(np.int16)
        blender.feed(filled, np.where(owner == k + 1, 255, 0).astype(np.uint8), (0, 0))
    blended, _ = blender.blend(None, None)  # type: ignore[call-overload]  # it makes them
    return np.where(source[..., None] > 0, np.clip(blended, 0, 255), 0).astype(np.uint8)
