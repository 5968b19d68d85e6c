"""Maps: where the cameras went over the cloud from above, which frames are missing, with scale bar and north; overlap;
error ellipses.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from tiegraph.report.svg import WIDTH, dots, legend, line, pass_colour, svg, text
from tiegraph.report.texts import t
from tiegraph.report.thumbnails import png
from tiegraph.scene.scene import Scene, between_neighbours
from tiegraph.text import round_below


@dataclass(frozen=True)
class Track:
    """A pass on the map: name, positions (T, 3) of its frames in order (NaN = not registered), and where the missing
    ones probably are (M, 3)."""

    name: str
    positions: np.ndarray
    missing: np.ndarray


def frame_positions(scene: Scene, centres: np.ndarray) -> np.ndarray:
    """(F, 3) mean of the registered projection centres (N, 3) of each frame, NaN where none is registered."""
    seen = np.isfinite(centres).all(axis=1)
    count = np.bincount(scene.frame[seen], minlength=scene.frames)
    sums = [np.bincount(scene.frame[seen], weights=centres[seen, c], minlength=scene.frames) for c in range(3)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack(sums, axis=1) / np.where(count > 0, count, np.nan)[:, None]


def tracks(scene: Scene, positions: np.ndarray) -> list[Track]:
    """The passes with the places of their missing frames, interpolated along the pass or taken from the prior."""
    between = between_neighbours(positions, scene)
    guess = np.where(np.isfinite(between), between, scene.world_from_rig[:, :3, 3])
    out = []
    for sequence in [*range(len(scene.sequences)), -1]:
        frames = scene.in_order(scene.sequence == sequence)
        if not len(frames):
            continue
        at = positions[frames]
        missing = guess[frames][~np.isfinite(at[:, 0]) & np.isfinite(guess[frames, 0])]
        out.append(Track(scene.sequences[sequence] if sequence >= 0 else "images", at, missing))
    return out


def _extent(tracks: Sequence[Track], gnss: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner (2,) of the passes and their surroundings."""
    points = np.concatenate([np.zeros((0, 3)), *(at for track in tracks for at in (track.positions, track.missing))])
    points = points[:, :2]
    points = points[np.isfinite(points[:, 0])]
    if not len(points):
        points = gnss[:, :2] if len(gnss) else np.zeros((1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float(np.max(high - low)), 1e-6)
    pad = 0.22 * size + np.maximum(0, 0.6 * size - (high - low)) / 2
    return low - pad, high + pad


_PIXELS = 560  # of the backdrop's width
_SAMPLE, _STRAYS = 100_000, 0.03  # points that tell the extent of the surface; share of them that may lie beyond it
_FAR = 1.5  # times the size of the passes: surface further from them is not shown
_TALLEST, _FLATTEST = 1.15, 0.45  # height over width of a map


@dataclass(frozen=True)
class Place:
    """The part of the world that a map shows: lower left and upper right corner (2,), and its unit."""

    low: np.ndarray
    high: np.ndarray
    unit: str

    @property
    def zoom(self) -> float:
        """Units of the drawing for one of the world."""
        return WIDTH / float(self.high[0] - self.low[0])

    @property
    def height(self) -> float:
        """Of the drawing."""
        return self.zoom * float(self.high[1] - self.low[1])

    def at(self, xy: np.ndarray) -> np.ndarray:
        """(K, 2) places of the drawing of places of the world (K, 2+)."""
        return np.column_stack([xy[:, 0] - self.low[0], self.high[1] - xy[:, 1]]) * self.zoom


def place_of(tracks: Sequence[Track], gnss: np.ndarray, surface: np.ndarray, unit: str) -> Place:
    """What a map of these passes shows: them, their surroundings, and most of the surface (K, 2+) that they survey, as
    far as it is not far off; neither too tall nor too flat."""
    low, high = _extent(tracks, gnss)
    if len(surface):
        most = np.quantile(surface[:: max(1, len(surface) // _SAMPLE), :2], [_STRAYS, 1 - _STRAYS], axis=0)
        reach, pad = _FAR * float(np.max(high - low)), _STRAYS * float(np.max(most[1] - most[0]))
        low, high = (
            np.minimum(low, np.maximum(most[0] - pad, low - reach)),
            np.maximum(high, np.minimum(most[1] + pad, high + reach)),
        )
    size = high - low
    wanted = np.array([max(size[0], size[1] / _TALLEST), max(size[1], _FLATTEST * size[0])])
    pad = (wanted - size) / 2
    return Place(low - pad, high + pad, unit)


def survey_map(
    place: Place, tracks: Sequence[Track], gnss: np.ndarray, backdrop: str, north: bool, ellipses: Sequence[str] = ()
) -> Markup:
    """The passes over a backdrop (data URI, "" for none), missing frames and given positions, scale bar, north arrow
    (``north``: up is north), and what else is drawn on it."""
    parts = [f'<svg width="{WIDTH:g}" height="{place.height:.1f}" overflow="hidden">', _picture(place, backdrop)]
    if len(gnss):
        parts.append(dots(place.at(gnss), "var(--soft)", 2.5))
    for k, track in enumerate(tracks):
        at = place.at(track.positions[:, :2])
        if track.name != "images":
            parts.append(line(at, pass_colour(k), "way"))
        parts.append(dots(at, pass_colour(k), 4))
    missing = np.concatenate([t_.missing for t_ in tracks]) if tracks else np.zeros((0, 3))
    for x, y in place.at(missing):
        parts.append(line([(x - 4, y - 4), (x + 4, y + 4)], "var(--alert)"))
        parts.append(line([(x - 4, y + 4), (x + 4, y - 4)], "var(--alert)"))
    parts += [*ellipses, "</svg>", scale_bar(place), north_arrow() if north else ""]
    entries = [(t_.name if t_.name != "images" else t("images"), pass_colour(k)) for k, t_ in enumerate(tracks[:8])]
    if len(gnss):
        inside = np.all((gnss[:, :2] >= place.low) & (gnss[:, :2] <= place.high), axis=1)
        outside = t(" ({} of {} outside the map)", int(np.sum(~inside)), len(gnss)) if not inside.all() else ""
        entries.append((t("given position") + outside, "var(--soft)"))
    entries += [(t("frame not registered"), "var(--alert)")] if len(missing) else []
    drawn, height = legend(entries, place.height + 18)
    return svg(height, [*parts, drawn], t("Map of the survey"))


def cells_map(place: Place, picture: str, key: Sequence[tuple[str, str]], label: str, north: bool) -> Markup:
    """A picture of cells with its key, scale bar and north arrow."""
    drawn, height = legend(key, place.height + 18)
    parts = [_picture(place, picture), scale_bar(place), north_arrow() if north else "", drawn]
    return svg(height, parts, label)


def raster(place: Place, xy: np.ndarray, rgb: np.ndarray, pixels: int = _PIXELS) -> str:
    """Points (K, 2+) with colours (K, 3) u1 from above as a PNG data URI, clear where there are none; the last point of
    a pixel is seen."""
    column, row, size = _cells(place, xy, pixels)
    inside = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
    out = np.zeros((size[1], size[0], 4), np.uint8)
    out[row[inside], column[inside], :3] = rgb[inside]
    out[row[inside], column[inside], 3] = 255
    return png(out)


def median_cells(place: Place, xy: np.ndarray, values: np.ndarray, pixels: int) -> tuple[np.ndarray, np.ndarray]:
    """(K, 2) middles in the world of the cells, ``pixels`` across, that points lie in, and their median values (K,)."""
    column, row, size = _cells(place, xy, pixels)
    inside = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
    cell, values = (row * size[0] + column)[inside], values[inside]
    order = np.lexsort((values, cell))
    cell, values = cell[order], values[order]
    found, start, count = np.unique(cell, return_index=True, return_counts=True)
    middle = np.column_stack([found % size[0] + 0.5, found // size[0] + 0.5]) * (WIDTH / pixels) / place.zoom
    xy = np.column_stack([place.low[0] + middle[:, 0], place.high[1] - middle[:, 1]])
    return xy, values[start + count // 2]


def _cells(place: Place, xy: np.ndarray, pixels: int) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    at = np.floor(place.at(xy) * (pixels / WIDTH)).astype(int)
    return at[:, 0], at[:, 1], (pixels, max(1, round(place.height * pixels / WIDTH)))


def ellipse(place: Place, centre: np.ndarray, covariance: np.ndarray, factor: float) -> str:
    """One standard deviation of a place, covariance (2, 2) in the plane, enlarged."""
    values, axes = np.linalg.eigh(covariance)
    (x, y), (a, b) = place.at(centre[None, :2])[0], np.sqrt(np.clip(values, 0, None)) * place.zoom * factor
    turn = -math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
    at = f'cx="{x:.1f}" cy="{y:.1f}" rx="{b:.1f}" ry="{a:.1f}" transform="rotate({turn:.1f} {x:.1f} {y:.1f})"'
    return f'<ellipse {at} fill="none" style="stroke:var(--alert)" class="thin"/>'


def scale_bar(place: Place) -> str:
    """A round length at the lower left."""
    length = round_below(0.25 * WIDTH / place.zoom)
    x, y, end = 12.0, place.height - 12, 12 + length * place.zoom
    unit = place.unit.removesuffix("s") if length == 1 else place.unit
    bar = line([(x, y - 5), (x, y), (end, y), (end, y - 5)], look="bar")
    return _halo(12, place.height - 42, max(end, 70) - 6, 36) + bar + text(x, y - 9, f"{length:g} {unit}")


def north_arrow() -> str:
    """At the upper right; up is north."""
    x = WIDTH - 20
    arrow = f'<path d="M{x} 8l7 20l-7 -5l-7 5z" class="solid"/>'
    return _halo(x - 12, 4, 24, 42) + arrow + text(x, 42, "N", "middle")


def _halo(x: float, y: float, width: float, height: float) -> str:
    return f'<rect x="{x - 6:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" rx="3" class="halo"/>'


def _picture(place: Place, uri: str) -> str:
    frame = f'<rect x="0" y="0" width="{WIDTH:g}" height="{place.height:.1f}" style="fill:var(--field)"/>'
    if not uri:
        return frame
    return f'{frame}<image x="0" y="0" width="{WIDTH:g}" height="{place.height:.1f}" href="{uri}" class="pixels"/>'
