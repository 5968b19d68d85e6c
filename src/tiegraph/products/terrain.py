"""Terrain below trees, cars and houses, from the heights of a map, and its contour lines (contourpy).

Ground cells of a coarse grid are found by the simple morphological filter (Pingel, Clarke and McBride, "An
improved simple morphological filter for the terrain classification of airborne LIDAR data", ISPRS Journal of
Photogrammetry and Remote Sensing 77, 2013): openings by discs that grow cell by cell, each of the previous result,
remove first cars and crowns, then houses; a step larger than a slope allows is an object. It works
directly on a raster. The cloth simulation of Zhang et al. (2016) was tried: on slopes of 1 in 2 it kept a quarter to
half of the ground, this filter nine tenths; its library runs on OpenMP threads that write to each other's nodes, so
that two runs may differ (its issues 21 and 52), and prints to standard output.

The pixels near the ground of the cells are ground and keep their height; elsewhere the terrain is interpolated
from cell to cell by planes, small holes by their surroundings, and then to the pixels. The grid covers the
whole map, but with a bounded number of cells; all pixels are processed tile by tile.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from contourpy import contour_generator
from scipy import ndimage

from tiegraph.products.heights import filled, planes
from tiegraph.products.surface import Surface, Window
from tiegraph.products.tuning import ContourTuning, TerrainTuning
from tiegraph.scene.results import APART_SIGMAS, Cloud
from tiegraph.text import round_above

MOST_CELLS = 4_000_000
"""Cells of the whole grid at most: some 0.5 GB while holes are filled. Larger maps have larger cells."""
_ACROSS = 40  # cells across the widest object at least, where that has so many pixels
_JOINED = 2  # cells; twice that is a gap that is closed
_EVEN = 2.0  # cells over which interpolated terrain is smoothed: where holes of two sizes meet it steps
_INDEX = 5  # every so many lines one is an index line, drawn thick
_TAILS = 0.002  # share of the heights at either end that is no relief
_FADE = 0.01  # share of a full window of pixels at which the offset of the ground counts half


@dataclass(frozen=True, eq=False)
class Terrain:
    """The terrain in cells of ``step`` pixels of the map: heights w and their sigma (rows, columns), of the nearest
    known cell where it is not ``known``."""

    step: int
    w: np.ndarray
    sigma: np.ndarray
    known: np.ndarray

    def at(self, window: Window) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """w, sigma f4 and known bool at the pixels of a window, between the centres of the cells."""
        rows, columns = (
            ((start + np.arange(count) + 0.5) / self.step - 0.5).astype(np.float32)
            for start, count in ((window.row, window.rows), (window.column, window.columns))
        )
        x, y = np.meshgrid(columns, rows)
        w, sigma = (cv2.remap(v, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for v in (self.w, self.sigma))
        known = cv2.remap(self.known.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return w, sigma, known >= 0.5


def step_of(shape: tuple[int, int], pixel_m: float, widest_m: float) -> int:
    """Pixels along a cell, a power of two: the most of which ``_ACROSS`` lie across the widest object, or more, so that
    the whole grid (rows, columns of pixels) does not have too many."""
    step = 1
    while 2 * step * pixel_m <= widest_m / _ACROSS * 1.0001 or shape[0] * shape[1] > MOST_CELLS * step**2:
        step *= 2
    return step


def low_cells(w: np.ndarray, step: int, tuning: TerrainTuning) -> np.ndarray:
    """Heights (rows, columns) f4 of cells of ``step`` pixels: a low quantile of their pixels' w, NaN = none known."""
    ordered = np.sort(_blocks(w, step), axis=-1)  # NaN last
    count = np.isfinite(ordered).sum(axis=-1)
    at = np.floor(tuning.lowest * np.maximum(count - 1, 0)).astype(int)
    return np.take_along_axis(ordered, at[..., None], axis=-1)[..., 0].astype(np.float32)


def _blocks(values: np.ndarray, step: int) -> np.ndarray:
    """(rows / step, columns / step, step^2), with NaN beyond the last pixel."""
    rows, columns = (-(-n // step) for n in values.shape)
    padded = np.full((rows * step, columns * step), np.nan, np.float32)
    padded[: values.shape[0], : values.shape[1]] = values
    return padded.reshape(rows, step, columns, step).swapaxes(1, 2).reshape(rows, columns, step * step)


def bare(low: np.ndarray, noise: float, cell_m: float, objects_m: float, tuning: TerrainTuning) -> np.ndarray:
    """Heights of cells (rows, columns), NaN where there are none or an object of up to ``objects_m``; ``noise``:
    their sigma."""
    known = np.isfinite(low)
    if not known.any():
        return low
    last = (low - np.median(low[known])).astype(np.float32)
    stands, far = np.zeros(low.shape, bool), np.float32(1e9)
    for radius in range(1, int(np.ceil(objects_m / 2 / cell_m)) + 1):
        # The opening by a disc of so many cells, of the known ones alone
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        lowest = cv2.erode(np.where(known, last, far), disc, borderValue=float(far))
        highest = cv2.dilate(np.where(lowest < far / 2, lowest, -far), disc, borderValue=-float(far))
        opened = np.where(known, highest, np.nan)
        with np.errstate(invalid="ignore"):
            stands |= last - opened > tuning.slope * radius * cell_m + APART_SIGMAS * noise
        last = opened
    beside = cv2.dilate(stands.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0  # its other half, or adjoining objects
    return np.where(beside, np.nan, low)


def footprint(known: np.ndarray) -> np.ndarray:
    """Cells (rows, columns) bool in which the surface is ``known``, or which such cells surround: beyond there is no
    terrain."""
    closed = np.pad(known, _JOINED + 1)
    closed = ndimage.binary_closing(closed, ndimage.generate_binary_structure(2, 2), iterations=_JOINED)
    return ndimage.binary_fill_holes(closed)[(inner := slice(_JOINED + 1, -_JOINED - 1)), inner]


def through(w: np.ndarray, sigma: np.ndarray, step: int, reach: int, within: np.ndarray) -> Terrain:
    """The terrain through cells (rows, columns), NaN = not ground, to ``reach`` cells from the nearest and ``within``
    (rows, columns) bool."""
    wide = 2 * reach + 1  # beyond the border nothing is known
    w, sigma = (np.pad(np.asarray(v, float), wide, constant_values=np.nan) for v in (w, sigma))
    given = np.isfinite(w)
    for size in sorted({*(2**k for k in range(reach.bit_length())), reach}):
        w, sigma = filled(w, sigma, size)
    between = np.isfinite(w) & ~given
    w[between] = planes(w, sigma, _EVEN, between)[0]
    w, sigma = (v[wide:-wide, wide:-wide] for v in (w, sigma))
    known = np.isfinite(w)
    if not known.any():
        return Terrain(step=step, w=np.zeros(w.shape, np.float32), sigma=np.zeros(w.shape, np.float32), known=known)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    near_w, near_sigma = (v[tuple(nearest)].astype(np.float32) for v in (w, sigma))
    return Terrain(step=step, w=near_w, sigma=near_sigma, known=known & within)


def ground(w: np.ndarray, sigma: np.ndarray, low: Terrain, window: Window, tuning: TerrainTuning) -> np.ndarray:
    """Which pixels (rows, columns) of a window are ground: those near the ``low`` terrain through the cells, except
    the rims of objects."""
    level, _, known = low.at(window)
    slope = np.hypot(*np.gradient(level)) if min(level.shape) > 1 else np.zeros_like(level)
    with np.errstate(invalid="ignore"):
        above = np.maximum(tuning.above_m, APART_SIGMAS * sigma) + slope * low.step
        stands = w - level > above
    size = 2 * tuning.rim_px + 1
    rim = cv2.dilate(stands.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))) > 0
    return np.isfinite(w) & known & ~rim


def ground_cells(w: np.ndarray, sigma: np.ndarray, on_ground: np.ndarray, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean w and sigma (rows, columns) of the cells of which half of the pixels are ground, NaN = others."""
    blocks = [_blocks(np.where(on_ground, values, np.nan), step) for values in (w, sigma)]
    half = np.isfinite(blocks[0]).mean(axis=-1) >= 0.5
    counts = [np.maximum(np.isfinite(b).sum(axis=-1), 1) for b in blocks]
    found = [np.nansum(b, axis=-1, dtype=float) / n for b, n in zip(blocks, counts)]
    return np.where(half, found[0], np.nan), np.where(half, found[1], np.nan)


def margin(step: int, tuning: TerrainTuning) -> int:
    """Pixels around a window whose heights affect its terrain."""
    return 2 * step + tuning.rim_px + 1


def terrain_tile(
    w: np.ndarray, sigma: np.ndarray, low: Terrain, cells: Terrain, window: Window, tuning: TerrainTuning
) -> tuple[np.ndarray, np.ndarray]:
    """w of the terrain and its sigma (rows, columns) f4 of a window, NaN = not known, of the surface's w and sigma over
    it and its margin.

    Ground keeps its height and sigma. Elsewhere it is the terrain of the ``cells`` plus the offset of the ground pixels
    around, which fades with their distance: no step where an object begins.
    """
    wide = margin(cells.step, tuning)
    around = window.grown(wide)
    on_ground = ground(w, sigma, low, around, tuning)
    level, level_sigma, known = cells.at(around)
    off, share = np.where(on_ground, w - level, 0.0).astype(np.float64), on_ground.astype(np.float64)
    side = cells.step | 1
    for _ in range(3):  # nearly a Gaussian of half a cell, at a cost that does not grow with the cell
        off, share = (cv2.blur(v, (side, side), borderType=cv2.BORDER_CONSTANT) for v in (off, share))
    inner = slice(wide, wide + window.rows), slice(wide, wide + window.columns)
    between = np.where(known, level + off / (share + _FADE), np.nan)
    found = (
        np.where(on_ground, w, between)[inner],
        np.where(on_ground, sigma, np.where(known, level_sigma, np.nan))[inner],
    )
    return found[0].astype(np.float32), found[1].astype(np.float32)


def on_terrain(
    points: Cloud, surface: Surface, window: Window, w: np.ndarray, sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which points (N,) bool belong to a tile (those beyond the raster to the tiles at its border), and which of these
    (M,) bool are ground: they lie on the terrain w, given with a margin of a pixel, within the sigmas of the point and
    of the terrain (rows, columns) and its slope within a pixel."""
    uvw = surface.frame.uvw(points.xyz_m)
    pixel = np.stack([surface.high[1] - uvw[:, 1], uvw[:, 0] - surface.low[0]], axis=1) // surface.pixel_m
    within = np.clip(pixel, 0, np.array(surface.shape) - 1)
    at = (within - [window.row, window.column]).astype(int)
    here = np.asarray(((at >= 0) & (at < [window.rows, window.columns])).all(axis=1))
    row, column = at[here].T
    slopes = np.abs(w[2:, 1:-1] - w[:-2, 1:-1]) + np.abs(w[1:-1, 2:] - w[1:-1, :-2])
    rise = np.nan_to_num(slopes)[row, column] / 4
    off = APART_SIGMAS * np.hypot(np.nan_to_num(points.sigma_m[here]), sigma[row, column]) + rise
    with np.errstate(invalid="ignore"):
        lies = np.abs(uvw[here, 2] - w[1:-1, 1:-1][row, column]) <= off
    return here, np.asarray(lies & (pixel == within).all(axis=1)[here])


# --- contour lines ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Line:
    """A contour line: its height, its vertices (N, 2) in u and v, the first once more at the end of a ring, the sigma
    of the terrain's height along it, and whether it is an index line."""

    w: float
    uv: np.ndarray
    sigma: float
    index: bool


def equidistance(w: np.ndarray, sigma: np.ndarray, tuning: ContourTuning) -> float:
    """Interval of contour lines of heights (rows, columns) with their sigma, NaN = not known: the
    least of 1, 2 and 5 times a power of ten that gives no more lines than allowed, and is no finer than the
    accuracy of the heights. 0 where nothing is known."""
    known = np.isfinite(w) & np.isfinite(sigma)
    if not known.any():
        return 0.0
    low, high = np.quantile(w[known], [_TAILS, 1 - _TAILS])
    least = max((high - low) / tuning.most_lines, APART_SIGMAS * float(np.median(sigma[known])), 1e-3)
    return round_above(least)


def contour_lines(
    w: np.ndarray, sigma: np.ndarray, places: tuple[np.ndarray, np.ndarray], every: float, tuning: ContourTuning
) -> list[Line]:
    """The lines at the multiples of ``every``, by height, of heights and their sigma (rows, columns) at ``places``: u
    (columns,) and v (rows,).

    They are drawn on heights smoothed by planes, exact on slopes. Rings and pieces shorter than a few pixels, which a
    map would show as dots, are left out; where the known heights are too scattered for planes there is none.
    """
    smooth = smoothed(w, sigma, tuning.smooth_cells)
    if every <= 0 or min(w.shape) < 2 or not np.isfinite(smooth).any():
        return []
    pixel = abs(places[0][1] - places[0][0])
    drawn = contour_generator(*places, np.ma.masked_invalid(smooth), name="serial", line_type="Separate")
    found = []
    for number in range(int(np.ceil(np.nanmin(smooth) / every)), int(np.floor(np.nanmax(smooth) / every)) + 1):
        for uv in map(np.asarray, drawn.lines(number * every)):
            if np.linalg.norm(np.diff(uv, axis=0), axis=1).sum() < tuning.shortest_cells * pixel:
                continue
            column = np.rint((uv[:, 0] - places[0][0]) / pixel).astype(int)
            row = np.rint((places[1][0] - uv[:, 1]) / pixel).astype(int)
            height = float(f"{number * every:.6g}") if every < 1 else number * every
            near = float(np.nanmedian(sigma[row, column]))
            found.append(Line(height, uv, sigma=near, index=number % _INDEX == 0))
    return found


def smoothed(w: np.ndarray, sigma: np.ndarray, bell_px: float) -> np.ndarray:
    """w (rows, columns) of the planes through the pixels around each known one, by a Gaussian: exact on slopes, at
    borders too."""
    known = np.isfinite(w)
    out = np.full(w.shape, np.nan)
    if known.any():
        out[known] = planes(w, sigma, bell_px, known)[0]
    return out
