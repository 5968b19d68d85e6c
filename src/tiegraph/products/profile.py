"""Heights along a line over a map: sampled between the pixels, as a table and as a chart."""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from tiegraph.products.surface import Window

_AT_ONCE = 1000  # places that are read together: a window of so many pixels along its edge at most
_SIZE = (10.0, 4.5)  # inches
_DRAWN = {"dsm": ("surface", "0.45"), "dtm": ("terrain", "tab:brown")}


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
