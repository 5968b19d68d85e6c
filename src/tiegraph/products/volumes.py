"""Volumes between a surface and a base inside a polygon, with a sigma that includes common errors of many pixels; and
heights along a line.

A volume is a sum over pixels, V = sum c_i (h_i - b_i), c_i being the area of a pixel inside the polygon; cut is the sum
where h > b, fill where h < b. Its variance is the sum of independent parts:

* ``noise``: sum_ij c_i c_j s_i s_j r_ij = N sum c_i^2 s_i^2, with the stated sigmas s and N, the sum of the correlation
  r over all lags, in pixels (Rolstad, Haug and Denby, "Spatially integrated geodetic glacier mass balance and its
  uncertainty based on geostatistical analysis", Journal of Glaciology 55, 2009). N is measured on the heights about
  local planes. The excess of the stated variance over this scatter is common to an unknown number of farther
  neighbours, and counts as one error of all: (sum c_i s_i)^2 times its share.
* ``base``: g' C g, g the derivative by the parameters of the base, C their covariance. That of a plane fitted to the
  ground around the polygon is the sandwich of the means of its sectors (Liang and Zeger, "Longitudinal data analysis
  using generalized linear models", Biometrika 73, 1986): it includes noise, common noise and ground that is no plane.
* ``world``: g' C g, C the covariance (7, 7) of the placement in the world. The polygon was drawn on the map and moves
  with it: dV is the sum of c (dz - grad b . (dx, dy) + (h - b) div (dx, dy)), less the change of the base. A base of
  the same survey moves too, so that of a heap on its own ground hardly more than three times the scale is left.
* ``shape``: the model may be bent: the sigma of a height against one as far away as the polygon is wide, or, for a base
  from another source, that of the model as a whole, times the area.
* ``near_base`` (cut and fill, not net): noise about a surface on the base is cut here and fill there. Its contribution
  to each is the expected loss s (phi(t) - |t| Phi(-|t|)), t = (h - b) / s, of the true h; by the measured ones,
  which include the noise once already, it is sqrt(2) - 1 of that where the surface lies on the base. It is added whole.
"""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import rasterio
from rasterio.features import rasterize
from scipy import ndimage
from scipy.stats import norm

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import PlacementError, motions
from tiegraph.products.heights import planes
from tiegraph.products.surface import Window
from tiegraph.products.tuning import VolumeTuning

_FINER = 4  # parts of a pixel along its edge for its share inside a polygon
_SAMPLE = 512  # pixels along the edge of the sample for common errors
_FITS = 2.0  # planes do not fit where the scatter about them is larger than the usual one by this factor
_AT_ONCE = 1000  # places that are read together: a window of so many pixels along its edge at most
_SIZE = (10.0, 4.5)  # inches
_DRAWN = {"dsm": ("surface", "0.45"), "dtm": ("terrain", "tab:brown")}
_FEWEST = 12  # pixels of the ground around, and sectors with some


@dataclass(frozen=True, eq=False)
class Patch:
    """Heights and their sigma (rows, columns), NaN = not known, in pixels of an edge, of which the upper left corner of
    the first lies at ``corner`` (2,), east and north."""

    w: np.ndarray
    sigma: np.ndarray
    corner: np.ndarray
    pixel: float

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """East and north (rows, columns) of the centres."""
        rows, columns = self.w.shape
        east = self.corner[0] + (np.arange(columns) + 0.5) * self.pixel
        return np.meshgrid(east, self.corner[1] - (np.arange(rows) + 0.5) * self.pixel)  # type: ignore[return-value]

    def share(self, polygon: np.ndarray) -> np.ndarray:
        """Share (rows, columns) of each pixel inside a polygon (N, 2)."""
        fine, (rows, columns) = self.pixel / _FINER, self.w.shape
        to_world = rasterio.Affine(fine, 0, self.corner[0], 0, -fine, self.corner[1])
        ring = {"type": "Polygon", "coordinates": [[*polygon.tolist(), polygon[0].tolist()]]}
        found = rasterize([ring], out_shape=(rows * _FINER, columns * _FINER), transform=to_world, dtype="uint8")
        return found.reshape(rows, _FINER, columns, _FINER).mean(axis=(1, 3))


@dataclass(frozen=True)
class Known:
    """Accuracy of a survey: its placement, the sigma of heights against each other over the polygon, and that of
    the model as a whole, both of its shape."""

    placed: PlacementError | None = None
    over_polygon: float = 0.0
    whole: float = 0.0


@dataclass(frozen=True, eq=False)
class Base:
    """The base of a volume: heights (rows, columns) = sum of ``design`` (K, rows, columns) times parameters
    with a covariance (K, K), which the placement moves by ``moved`` (K, 7). ``own``: it is of the same survey;
    ``other``: it is another survey's surface."""

    w: np.ndarray
    said: str
    design: np.ndarray
    covariance: np.ndarray
    moved: np.ndarray
    own: bool = False
    other: tuple[Patch, Known] | None = None


@dataclass(frozen=True)
class Volume:
    """A volume, its sigma, and the parts of that by name."""

    value: float
    sigma: float
    parts: dict[str, float] = field(default_factory=dict)


def level(patch: Patch, height: float, said: str) -> Base:
    """A base at a given height, which has no error."""
    none = np.zeros((0, *patch.w.shape))
    return Base(np.full(patch.w.shape, height), said, none, covariance=np.zeros((0, 0)), moved=np.zeros((0, 7)))


def epoch(other: Patch, known: Known, said: str) -> Base:
    """The surface of another survey, on the same pixels."""
    return replace(level(other, 0.0, said), w=other.w, other=(other, known))


def lowest(ground: Patch, polygon: np.ndarray, known: Known, tuning: VolumeTuning) -> Base:
    """A level base at the lowest ground around a polygon. Raises InputError where no ground was seen there."""
    rim = _rim(ground, polygon, tuning)
    height = float(np.quantile(ground.w[rim], tuning.lowest))
    at = np.argmin(np.where(rim, np.abs(ground.w - height), np.inf))
    moved = _moved(ground, np.zeros((2, *ground.w.shape)), known).reshape(7, -1)[:, at]
    said = "level at the lowest ground around"
    variance = np.full((1, 1), ground.sigma.flat[at] ** 2)
    flat = np.full(ground.w.shape, height)
    return Base(flat, said, np.ones((1, *flat.shape)), covariance=variance, moved=moved[None], own=True)


def plane(ground: Patch, polygon: np.ndarray, known: Known, tuning: VolumeTuning) -> Base:
    """The plane of least squares through the ground around a polygon. Raises InputError where too little was seen."""
    rim = _rim(ground, polygon, tuning)
    east, north = ground.places()
    middle, size = polygon.mean(axis=0), float(np.ptp(polygon, axis=0).max())
    design = np.stack([np.ones_like(east), (east - middle[0]) / size, (north - middle[1]) / size])
    rows, height = design[:, rim].T, ground.w[rim]
    sector = np.floor(np.arctan2(rows[:, 2], rows[:, 1]) / (2 * np.pi) * tuning.sectors).astype(int) % tuning.sectors
    there = len(np.unique(sector))
    if there < min(_FEWEST, tuning.sectors):
        text = (
            f"the ground around the polygon was seen on {there / tuning.sectors:.0%} of its length: draw it elsewhere"
        )
        raise InputError(f"{text}, or give --base HEIGHT")
    inverse = np.linalg.inv(rows.T @ rows)
    zero = float(np.mean(height))
    found = inverse @ rows.T @ (height - zero)
    pull = rows * (height - zero - rows @ found)[:, None]
    sums = np.stack([np.bincount(sector, p, minlength=tuning.sectors) for p in pull.T], axis=1)
    covariance = inverse @ (sums.T @ sums) @ inverse * there / (there - 3)
    slope = np.broadcast_to((found[1:] / size)[:, None, None], (2, *east.shape))
    moved = inverse @ rows.T @ _moved(ground, slope, known)[:, rim].T
    scatter = np.std(height - zero - rows @ found)
    said = f"plane through the ground around, slope {np.hypot(*found[1:]) / size:.1%}, scatter {scatter:.3f}"
    w = np.tensordot(found, design, 1) + zero
    return Base(w, said, design, covariance=covariance, moved=moved, own=True)


def _rim(ground: Patch, polygon: np.ndarray, tuning: VolumeTuning) -> np.ndarray:
    """The pixels just outside of a polygon whose height is known."""
    inside = (ground.share(polygon) > 0).astype(np.uint8)
    size = 2 * tuning.local_px + 1
    near = cv2.dilate(inside, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    rim = (near > inside) & np.isfinite(ground.w) & np.isfinite(ground.sigma)
    if rim.sum() < _FEWEST:
        raise InputError("no ground was seen around the polygon: draw it elsewhere, or give --base HEIGHT")
    return rim


def _moved(patch: Patch, slope: np.ndarray, known: Known) -> np.ndarray:
    """(7, rows, columns): rise of places of a surface above one of a ``slope`` (2, rows, columns), to the east and
    north, when it is moved by rotation, shift and log scale of the world."""
    out = np.zeros((7, *patch.w.shape))
    if known.placed is None:
        return out
    east, north = patch.places()
    for row in range(len(east)):  # seven columns by three for each pixel are too many to keep
        by = motions(np.stack([east[row], north[row], np.nan_to_num(patch.w[row])], axis=-1) - known.placed.middle)
        out[:, row] = (by[:, 2] - slope[0, row, :, None] * by[:, 0] - slope[1, row, :, None] * by[:, 1]).T
    return out


def _slope(w: np.ndarray, pixel: float) -> np.ndarray:
    """(2, rows, columns) to the east and north; 0 where it is not known."""
    if min(w.shape) < 2:
        return np.zeros((2, *w.shape))
    down, right = np.gradient(w, pixel)
    return np.nan_to_num(np.stack([right, -down]))


def _wider(slope: np.ndarray) -> np.ndarray:
    """(7, rows, columns): widening in plan of a surface with a slope by rotation, shift and log scale."""
    none = np.zeros(slope.shape[1:])
    return np.stack([-slope[1], slope[0], *[none] * 4, none + 2])


def shared_errors(patch: Patch, tuning: VolumeTuning) -> tuple[float, float]:
    """Pixels that have one error together, and the share of the stated variance that does not show as scatter.

    Both by the heights about the planes through their neighbours, which remove the longer waves, where these fit: not
    where the surface itself bends or steps.
    """
    ratio = _off_planes(patch, tuning.local_px)
    if not np.isfinite(ratio).any():
        return 1.0, 0.0
    seen, together = float(np.nanmean(ratio**2)), 1.0
    for lag in range(1, 2 * tuning.local_px):
        pairs = [ratio[lag:] * ratio[:-lag], ratio[:, lag:] * ratio[:, :-lag]]
        found = np.concatenate([p[np.isfinite(p)] for p in pairs])
        alike = float(found.mean()) / max(seen, 1e-12) if len(found) else 0.0
        if alike < 0.1:  # correlation below which two pixels share nothing
            break
        together += 2 * np.pi * lag * alike
    lost = together / (4 * np.pi * tuning.local_px**2)  # of the variance, to the planes
    rest = 1 - seen * (1 + lost)
    return together, rest if rest > tuning.least_shared else 0.0


def _off_planes(patch: Patch, bell: int) -> np.ndarray:
    """Deviations of heights from the planes through their neighbours (rows, columns), in sigmas, NaN where unknown or
    where the planes do not fit; of the middle of a large patch."""
    middle = tuple(slice(max(0, (n - _SAMPLE) // 2), max(0, (n - _SAMPLE) // 2) + _SAMPLE) for n in patch.w.shape)
    w, sigma = patch.w[middle], patch.sigma[middle]
    known = np.isfinite(w) & np.isfinite(sigma)
    if not known.any():
        return np.full(w.shape, np.nan)
    off = np.zeros(w.shape)
    off[known] = (w[known] - planes(w, sigma, bell, known)[0]) / sigma[known]
    off = np.nan_to_num(off)
    size = (4 * bell + 1, 4 * bell + 1)
    total, share = (cv2.GaussianBlur(v, size, bell) for v in (off**2, known.astype(float)))
    around = total / np.maximum(share, 1e-9)
    return np.where(known & (around <= _FITS * np.median(around[known])), off, np.nan)


def volumes(patch: Patch, base: Base, polygon: np.ndarray, known: Known, tuning: VolumeTuning) -> dict[str, Volume]:
    """``cut``, ``fill`` and ``net`` = cut - fill between a surface and a base inside a polygon (N, 2), in cubic units,
    over the pixels where both are known. Raises InputError where there are none."""
    area = patch.share(polygon) * patch.pixel**2
    high = patch.w - base.w
    area = np.where(np.isfinite(high) & np.isfinite(patch.sigma), area, 0.0)
    high = np.where(area > 0, high, 0.0)
    if not area.any():
        raise InputError("no height is known inside the polygon")
    under = _slope(base.w, patch.pixel)
    moved = _moved(patch, under, known) + high * _wider(_slope(patch.w, patch.pixel))
    surfaces = [(patch, *shared_errors(patch, tuning))]
    if base.other is not None:
        surfaces.append((base.other[0], *shared_errors(base.other[0], tuning)))
    own = np.sqrt(sum(np.nan_to_num(p.sigma) ** 2 for p, *_ in surfaces))
    away = np.abs(high) / np.maximum(own, 1e-9)
    near_base = float(np.sum(area * own * (norm.pdf(away) - away * norm.sf(away)))) / (np.sqrt(2) - 1)
    out = {}
    for name, sign, there in (("cut", 1, high > 0), ("fill", -1, high < 0), ("net", 1, area > 0)):
        c = np.where(there, area, 0.0)
        by_base = -np.tensordot(base.design, c, 2)
        world = np.tensordot(moved, c, 2) + base.moved.T @ by_base
        bent = known.over_polygon if base.own else known.whole
        variance = {
            "noise": sum(_noise(c, p.sigma, together, rest) for p, together, rest in surfaces),
            "base": by_base @ base.covariance @ by_base,
            "world": 0.0 if known.placed is None else world @ known.placed.covariance @ world,
            "shape": (bent * c.sum()) ** 2,
        }
        if base.other is not None:
            theirs, how = base.other
            by_other = np.tensordot(_moved(theirs, under, how), c, 2)
            variance["world"] += 0.0 if how.placed is None else by_other @ how.placed.covariance @ by_other
            variance["shape"] += (how.whole * c.sum()) ** 2
        parts = {k: float(np.sqrt(max(v, 0.0))) for k, v in variance.items()}
        parts["near_base"] = 0.0 if name == "net" else near_base
        sigma = float(np.sqrt(sum(variance.values()))) + parts["near_base"]
        out[name] = Volume(float(sign * np.sum(c * high)), sigma, parts)
    return out


def _noise(c: np.ndarray, sigma: np.ndarray, together: float, rest: float) -> float:
    each = c * np.nan_to_num(sigma)
    all_one = float(each.sum()) ** 2
    return min(together * float(np.sum(each**2)) * (1 - rest), all_one) + rest * all_one


def area_of(polygon: np.ndarray) -> float:
    """Area of a polygon (N, 2)."""
    x, y = (polygon - polygon.mean(axis=0)).T
    return abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))) / 2


def crossing(polygon: np.ndarray) -> tuple[int, int] | None:
    """Two sides of a polygon (N, 2) that cross or touch, by their first vertices; None if none do."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    along, low, high, count = b - a, np.minimum(a, b), np.maximum(a, b), len(polygon)

    def side(k: int, points: np.ndarray) -> np.ndarray:
        off = points - a[k]
        return np.sign(along[k, 0] * off[:, 1] - along[k, 1] * off[:, 0])

    turns = np.array([side(k, a) * side(k, b) <= 0 for k in range(count)])
    overlap = (low[:, None] <= high).all(axis=2)  # of the boxes around the sides, if it holds both ways
    for i, j in np.argwhere(turns & turns.T & overlap & overlap.T):
        if i < j and min(j - i, (i - j) % count) > 1:
            return int(i), int(j)
    return None


# --- profiles ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Profile:
    """Places (N, 2), east and north, along a line, their distances (N,) from its beginning, and the values of the
    rasters there, (N,) each by name, NaN = not known; lengths in ``unit``."""

    distance: np.ndarray
    places: np.ndarray
    values: Mapping[str, np.ndarray]
    unit: str = "m"

    @property
    def table(self) -> tuple[list[str], list[list[float | None]]]:
        """Columns with their unit, and rows; None = not known."""
        names = ["distance", "east", "north", *self.values]
        columns = [self.distance, *self.places.T, *self.values.values()]
        rows = [[None if np.isnan(v) else round(float(v), 4) for v in row] for row in zip(*columns)]
        return [f"{name}_{self.unit}" for name in names], rows


def along(line: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,) and places (N, 2) along a line (K, 2), at most a spacing apart, with all its vertices."""
    parts = []
    for a, b in zip(line[:-1], line[1:]):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing - 1e-9)))
        parts.append(a + (b - a) * (np.arange(count) / count)[:, None])
    places = np.concatenate([*parts, line[-1:]])
    return np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))], places


def sampled(read: Callable[[Window], np.ndarray], pixels: np.ndarray) -> np.ndarray:
    """Values (N,) at places (N, 2), columns and rows in pixels from the corner of a raster, between the centres of four
    known pixels, elsewhere NaN; ``read`` gives a window of it. Windows are as large as needed for one reading."""
    out = np.full(len(pixels), np.nan)
    for start in range(0, len(pixels), _AT_ONCE):
        column, row = pixels[start : start + _AT_ONCE].T - 0.5
        left, top = int(np.floor(column.min())), int(np.floor(row.min()))
        rows, columns = int(np.floor(row.max())) - top + 2, int(np.floor(column.max())) - left + 2
        values = read(Window(top, left, rows=rows, columns=columns)).astype(float)
        at = np.stack([row - top, column - left])
        known = np.isfinite(values)
        mean = ndimage.map_coordinates(np.where(known, values, 0.0), at, order=1)
        share = ndimage.map_coordinates(known.astype(float), at, order=1)
        out[start : start + _AT_ONCE] = np.where(share > 1 - 1e-9, mean, np.nan)
    return out


def chart(profile: Profile) -> bytes:
    """The profile as SVG: surface and terrain, each with a band of two sigmas; heights are exaggerated, as stated."""
    import matplotlib  # a second
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.add_subplot()
    for name, (label, colour) in _DRAWN.items():
        if name in profile.values and np.isfinite(profile.values[name]).any():
            height, sigma = profile.values[name], profile.values[f"{name}_sigma"]
            axes.fill_between(profile.distance, height - 2 * sigma, height + 2 * sigma, color=colour, alpha=0.25, lw=0)
            axes.plot(profile.distance, height, color=colour, lw=1.2, label=f"{label} ± 2 sigma")
    axes.set_xlim(0, float(profile.distance[-1]))
    axes.set_xlabel(f"distance ({profile.unit})")
    axes.set_ylabel(f"height ({profile.unit})")
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.grid(alpha=0.3)
    if axes.lines:
        axes.legend(loc="best", frameon=False)
    FigureCanvasAgg(figure).draw()  # which lays it out
    box, (low, high) = axes.get_window_extent(), axes.get_ylim()
    larger = box.height / (high - low) / (box.width / float(profile.distance[-1]))
    axes.set_title(f"heights {larger:.2g} times as large as lengths", loc="right", fontsize=9)
    out = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "tiegraph"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
