"""Contour lines of a terrain: an equidistance that fits its relief, and smooth lines by contourpy."""

from dataclasses import dataclass

import numpy as np
from contourpy import contour_generator

from tiegraph.products.heights import planes
from tiegraph.products.tuning import ContourTuning

_SERIES = (1.0, 2.0, 5.0)
_INDEX = 5  # every so many lines one is an index line, drawn thick
_TAILS = 0.002  # share of the heights at either end that is no relief


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
    least = max((high - low) / tuning.most_lines, tuning.sigmas * float(np.median(sigma[known])), 1e-3)
    power = 10.0 ** np.floor(np.log10(least))
    return float(f"{next(k * power for k in (*_SERIES, 10.0) if k * power >= least * 0.9999):.3g}")


def contour_lines(
    w: np.ndarray, sigma: np.ndarray, places: tuple[np.ndarray, np.ndarray], every: float, tuning: ContourTuning
) -> list[Line]:
    """The lines at the multiples of ``every``, by height, of heights and their sigma (rows, columns) at ``places``: u
    (columns,) and v (rows,).

    They are drawn on heights smoothed by planes, exact on slopes. Rings and pieces shorter than a few pixels, which a
    map would show as dots, are left out.
    """
    smooth = smoothed(w, sigma, tuning.smooth_cells)
    if every <= 0 or min(w.shape) < 2:
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
