"""From the points over a window of a reference surface to heights and their standard deviations."""

import cv2
import numpy as np

from tiegraph.products.surface import Surface, Window
from tiegraph.products.tuning import HeightTuning
from tiegraph.scene.results import APART_SIGMAS, Cloud
from tiegraph.scene.sorting import run_starts

_LEAST_SUPPORT = 1.0  # sum of the weights of the cells around a pixel of a hole, ...
_LEAST_SPREAD = 1e-2  # ... which are not collinear: squared deviations along their axes, multiplied, in pixels^4


def margin(tuning: HeightTuning) -> int:
    """Pixels around a window whose points affect its heights."""
    return 6 * tuning.hole_px


def height_tile(points: Cloud, surface: Surface, window: Window, tuning: HeightTuning) -> tuple[np.ndarray, np.ndarray]:
    """w and its sigma (rows, columns) f4 of a window, NaN = not known, of the points over it and its margin."""
    wide = margin(tuning)
    w, sigma = cells(points, surface, window.grown(wide), tuning)
    size = 2 * tuning.hole_px + 1
    known = np.isfinite(w).astype(np.float32)
    around = cv2.boxFilter(known, -1, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT)
    w = np.where(around < tuning.lone + 0.5, np.nan, w)  # without nearly isolated cells
    w, sigma = filled(w, sigma, tuning.hole_px)
    inner = slice(wide, wide + window.rows), slice(wide, wide + window.columns)
    return w[inner].astype(np.float32), sigma[inner].astype(np.float32)


def cells(points: Cloud, surface: Surface, window: Window, tuning: HeightTuning) -> tuple[np.ndarray, np.ndarray]:
    """w and its sigma (rows, columns) f8 of the cells of a window in which there are points.

    The top of a cell is its highest point with another one just below it, which a stray lacks; the height
    is the mean by 1 / sigma^2 of the points that lie there. Its sigma is that of the mean of points with independent
    errors, times the ratio of their scatter to their sigmas if that exceeds 1.
    """
    uvw = surface.frame.uvw(points.xyz_m)
    column = np.floor((uvw[:, 0] - surface.low[0]) / surface.pixel_m).astype(int) - window.column
    row = np.floor((surface.high[1] - uvw[:, 1]) / surface.pixel_m).astype(int) - window.row
    use = (row >= 0) & (column >= 0) & (row < window.rows) & (column < window.columns)
    use &= (uvw[:, 2] >= surface.low[2]) & (uvw[:, 2] <= surface.high[2])
    facing = np.sum(points.normal * surface.frame.gradients(*uvw.T)[:, 2], axis=1)
    use &= facing > tuning.backward if surface.from_below else ~(facing < -tuning.backward)
    w, cell = uvw[use, 2], (row * window.columns + column)[use]
    known = np.nan_to_num(points.sigma_m[use].astype(float), nan=surface.pixel_m)
    order = np.lexsort((points.xyz_m[use, 1], points.xyz_m[use, 0], -w, cell))
    w, cell, sigma = w[order], cell[order], np.maximum(known[order], 1e-3 * surface.pixel_m)
    out = np.full((2, window.rows, window.columns), np.nan)
    if not len(w):
        return out[0], out[1]
    start = run_starts(cell)
    of = np.repeat(np.arange(len(start)), np.diff(start, append=len(cell)))
    below = np.r_[1 : len(w), len(w) - 1]  # the next lower point, where it is of the same cell
    held = (cell[below] == cell) & (below > np.arange(len(w)))
    held &= w - w[below] <= APART_SIGMAS * np.hypot(sigma, sigma[below]) + surface.pixel_m
    at = np.flatnonzero(held)
    top = np.r_[at, len(w)][np.searchsorted(at, start)]
    top = np.where(top < np.append(start[1:], len(w)), top, start)
    near = APART_SIGMAS * np.hypot(sigma, sigma[top][of]) + surface.pixel_m
    weight = np.where(np.abs(w - w[top][of]) <= near, sigma**-2.0, 0.0)
    count, total = np.add.reduceat((weight > 0).astype(float), start), np.add.reduceat(weight, start)
    mean = np.add.reduceat(weight * w, start) / total
    scatter = np.add.reduceat(weight * (w - mean[of]) ** 2, start) / np.maximum(count - 1, 1)
    alike = np.minimum(count, tuning.shared)
    out.reshape(2, -1)[:, cell[start]] = mean, np.sqrt(np.maximum(scatter, 1) * alike / total)
    return out[0], out[1]


def filled(w: np.ndarray, sigma: np.ndarray, hole_px: int) -> tuple[np.ndarray, np.ndarray]:
    """w and its sigma (rows, columns), NaN = not known, with holes of up to about twice ``hole_px`` filled by the plane
    of the cells around each of their pixels, by a Gaussian of their distance.

    The variance is the mean one of the cells or, if they scatter more about the plane because the surface is rough or
    steps, that scatter. It is not reduced by their number: neighbours share their errors.
    """
    known = np.isfinite(w)
    size = 2 * hole_px + 1
    closed = cv2.morphologyEx(
        known.astype(np.uint8), cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    )
    wanted = (closed > 0) & ~known
    sigma = np.where(known, sigma, np.nan)
    if wanted.any():
        plane, w = planes(w, sigma, hole_px / 2, wanted), w.copy()
        w[wanted], sigma[wanted] = plane
    return w, sigma


def planes(w: np.ndarray, sigma: np.ndarray, bell_px: float, wanted: np.ndarray) -> np.ndarray:
    """(2, M): w at the pixels ``wanted`` (rows, columns) bool, and its sigma, by the plane through the known cells
    around each, weighted by a Gaussian of ``bell_px``; NaN where there are too few."""
    known = np.isfinite(w)
    zero = np.median(w[known]) if known.any() else 0.0
    there, height = known.astype(float), np.where(known, w - zero, 0.0)
    wide = round(4 * bell_px)
    at = np.arange(-wide, wide + 1.0)
    bell = np.exp(-0.5 * (at / bell_px) ** 2)

    def moment(values: np.ndarray, x: int, y: int) -> np.ndarray:
        return cv2.sepFilter2D(values, cv2.CV_64F, bell * at**x, bell * at**y, borderType=cv2.BORDER_CONSTANT)[wanted]

    powers = ((0, 0), (1, 0), (0, 1))
    normal = np.stack([np.stack([moment(there, a + c, b + d) for c, d in powers], -1) for a, b in powers], -2)
    right = np.stack([moment(height, a, b) for a, b in powers], -1)
    enough = (normal[:, 0, 0] > _LEAST_SUPPORT) & (np.linalg.det(normal) > _LEAST_SPREAD * normal[:, 0, 0] ** 3)
    normal[~enough] = np.eye(3)
    support, inverse = normal[:, 0, 0], np.linalg.inv(normal)
    plane = np.einsum("nij,nj->ni", inverse, right)
    scatter = np.maximum(moment(height**2, 0, 0) - np.einsum("ni,ni->n", plane, right), 0) / support
    own = moment(np.where(known, sigma**2, 0.0), 0, 0) / support
    found = np.stack([plane[:, 0] + zero, np.sqrt(np.maximum(scatter, own))])
    return np.where(enough, found, np.nan)
