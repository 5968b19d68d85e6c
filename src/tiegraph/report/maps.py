"""Maps: the paths of the cameras over the cloud from above, missing frames, with scale bar and north; overlap;
error ellipses.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from markupsafe import Markup
from scipy import ndimage

from tiegraph.geometry import transforms
from tiegraph.geometry.gravity import levelled
from tiegraph.geometry.transforms import PlacementError
from tiegraph.report import drawing
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.texts import t
from tiegraph.scene.scene import Scene, between_neighbours
from tiegraph.scene.sorting import evenly
from tiegraph.text import round_below

_PIXELS = 560  # of the backdrop's width
_SAMPLE, _STRAYS = 100_000, 0.03  # points for the extent of the surface; share of them that may lie beyond it
_FAR = 1.5  # times the size of the passes: surface farther from them is not shown
_TALLEST, _FLATTEST = 1.15, 0.45  # height over width of a map
_CELLS = 84  # of the overlap map, across
_OVERLAP = ((2, "#c8442b"), (3, "#e69f00"), (4, "#f0e08c"), (6, "#7fb8d0"), (10, "#0b4f6c"))  # from so many images


@dataclass(frozen=True)
class Track:
    """A pass: positions (T, 3) of its frames in order (NaN = not registered), probable ones (M, 3) of the missing."""

    name: str
    positions: np.ndarray
    missing: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        """(K, 3) the positions that are known."""
        return self.positions[np.isfinite(self.positions[:, 0])]


def frame_positions(scene: Scene, centres: np.ndarray) -> np.ndarray:
    """(F, 3) mean of the registered projection centres (N, 3) of each frame, NaN where none is registered."""
    seen = np.isfinite(centres).all(axis=1)
    count = np.bincount(scene.frame[seen], minlength=scene.frames)
    sums = [np.bincount(scene.frame[seen], weights=centres[seen, c], minlength=scene.frames) for c in range(3)]
    return np.stack(sums, axis=1) / np.where(count > 0, count, np.nan)[:, None]


def tracks(scene: Scene, positions: np.ndarray) -> list[Track]:
    """The passes with the places of their missing frames, interpolated along the pass or taken from the prior."""
    between = between_neighbours(positions, scene)
    guess = np.where(np.isfinite(between), between, scene.world_from_rig[:, :3, 3])
    out = []
    for name, number in [*zip(scene.sequences, range(len(scene.sequences))), ("images", -1)]:
        frames = scene.in_order(scene.sequence == number)
        missing = np.isnan(positions[frames, 0]) & np.isfinite(guess[frames, 0])
        out += [Track(name, positions[frames], guess[frames][missing])] if len(frames) else []
    return out


@dataclass(frozen=True)
class Place:
    """The part of the world that a map shows: lower left and upper right corner (2,), and its unit."""

    low: np.ndarray
    high: np.ndarray
    unit: str

    @property
    def zoom(self) -> float:
        """Units of the drawing for one of the world."""
        return drawing.WIDTH / float(self.high[0] - self.low[0])

    @property
    def height(self) -> float:
        """Of the drawing."""
        return self.zoom * float(self.high[1] - self.low[1])

    def at(self, xy: np.ndarray) -> np.ndarray:
        """(K, 2) places of the drawing of places of the world (K, 2+)."""
        return np.column_stack([xy[:, 0] - self.low[0], self.high[1] - xy[:, 1]]) * self.zoom


@dataclass(frozen=True, eq=False)
class Scenery:
    """Common data of all maps and views, upright: passes, given positions (K, 3), points (N, 3) with colours, and how
    many images see each (0 = not known)."""

    tracks: list[Track]
    xyz: np.ndarray
    rgb: np.ndarray
    path: np.ndarray  # (K, 3) places of the images
    unit: str
    given: np.ndarray
    views: np.ndarray
    north: bool  # +y is north

    @cached_property
    def place(self) -> Place:
        """The passes, their surroundings, and most of the surface if it is near; neither too tall nor too flat."""
        way = np.concatenate([np.zeros((0, 3)), *(at for track in self.tracks for at in (track.seen, track.missing))])
        way = (way if len(way) else self.given if len(self.given) else np.zeros((1, 3)))[:, :2]
        low, high = way.min(axis=0), way.max(axis=0)
        size = max(float(np.max(high - low)), 1e-6)
        pad = 0.22 * size + np.maximum(0, 0.6 * size - (high - low)) / 2
        low, high = low - pad, high + pad
        if len(self.xyz):
            most = np.quantile(self.xyz[:: max(1, len(self.xyz) // _SAMPLE), :2], [_STRAYS, 1 - _STRAYS], axis=0)
            reach, beside = _FAR * float(np.max(high - low)), _STRAYS * float(np.max(most[1] - most[0]))
            least, greatest = np.maximum(most[0] - beside, low - reach), np.minimum(most[1] + beside, high + reach)
            low, high = np.minimum(low, least), np.maximum(high, greatest)
        size = high - low
        pad = (np.array([max(size[0], size[1] / _TALLEST), max(size[1], _FLATTEST * size[0])]) - size) / 2
        return Place(low - pad, high + pad, self.unit)


def scenery(run: RunFolder) -> Scenery | None:
    """None without a model."""
    if run.scene is None or run.model is None or not run.model.images.placed.any():
        return None
    upright = np.eye(3)
    if not run.world:
        upright = levelled(transforms.invert(run.model.world_from_camera), run.scene.frame)[:3, :3]
    placed = run.georeferenced or bool((run.world or {}).get("placed"))
    found = tracks(run.scene, frame_positions(run.scene, run.model.centres @ upright.T))
    prior = run.scene.world_from_rig[:, :3, 3]
    if not placed:  # prior positions are in another frame than the model
        found = [Track(track.name, track.positions, track.missing[:0]) for track in found]
    xyz, rgb = (run.cloud.xyz, run.cloud.rgb) if run.cloud is not None else run.model.sample
    return Scenery(
        tracks=found,
        given=prior[np.isfinite(prior[:, 0])] if placed else prior[:0],
        xyz=xyz @ upright.T,
        rgb=rgb,
        views=run.cloud.views if run.cloud is not None else np.zeros(len(xyz)),
        path=run.model.centres[run.model.images.placed] @ upright.T,
        unit="m" if run.metric else t("units"),
        north=run.georeferenced,
    )


def survey_map(seen: Scenery) -> Markup:
    """The survey area: the passes over the cloud from above."""
    rising = np.argsort(seen.xyz[:, 2], kind="stable")
    colours = drawing.shown_colours(seen.xyz, seen.rgb)
    backdrop = _raster(seen.place, seen.xyz[rising], colours[rising], _PIXELS) if len(rising) else ""
    return _passes(seen, seen.given, backdrop)


def overlap_map(seen: Scenery) -> Markup | None:
    """The number of images that see the surface, cell by cell; None if the cloud has none."""
    if not (seen.views > 0).any():
        return None
    place = seen.place
    middle, value = _median_cells(place, seen.xyz, seen.views, _CELLS)
    low = [k for k, _ in _OVERLAP]
    colours = np.array([drawing.rgb_of(c) for _, c in _OVERLAP], np.uint8)
    step = np.clip(np.searchsorted(low, value, side="right") - 1, 0, None)
    key = [(t("{} images", f"{a}–{b - 1}" if b - a > 1 else a), c) for (a, c), (b, _) in zip(_OVERLAP, _OVERLAP[1:])]
    key.append((t("{} and more", _OVERLAP[-1][0]), _OVERLAP[-1][1]))
    overlap = _raster(place, middle, colours[step], _CELLS)
    return _drawn(seen, overlap, key, t("Overlap: images that see the surface"))


def ellipse_map(run: RunFolder, seen: Scenery) -> tuple[Markup, str] | None:
    """Error ellipses of the placement along the path and their enlargement; None if nothing is known."""
    told = (run.world or {}).get("placement_error")
    if told is None or not len(seen.path):
        return None
    place, way = seen.place, np.concatenate([track.seen for track in seen.tracks])
    axis = np.linalg.svd(way - way.mean(axis=0), full_matrices=False)[2][0]  # along which most of it lies
    at = way[np.argsort(way @ axis)][evenly(len(way), 12)]  # places with an error ellipse
    flat = PlacementError.from_dict(told).covariances(at)[:, :2, :2]
    largest = float(np.sqrt(np.linalg.eigvalsh(flat).max()))
    if not largest > 0:
        return None
    factor = round_below(0.06 * float(place.high[0] - place.low[0]) / largest)
    drawn = [_ellipse(place, p, c, factor) for p, c in zip(at, flat)]
    return _passes(seen, seen.given[:0], "", drawn), f"{factor:g}"


def _passes(seen: Scenery, given: np.ndarray, backdrop: str, ellipses: Sequence[str] = ()) -> Markup:
    """The passes over a backdrop (data URI, "" for none), missing frames and given positions, and further drawings."""
    place = seen.place
    parts = [drawing.dots(place.at(given), "var(--soft)", 2.5)]
    for k, track in enumerate(seen.tracks):
        at = place.at(track.positions[:, :2])
        parts.append(drawing.line(at, drawing.pass_colour(k), "way") if track.name != "images" else "")
        parts.append(drawing.dots(at, drawing.pass_colour(k), 4))
    missing = np.concatenate([np.zeros((0, 3)), *(track.missing for track in seen.tracks)])
    for x, y in place.at(missing):
        for side in (4, -4):
            parts.append(drawing.line([(x - 4, y - side), (x + 4, y + side)], "var(--alert)"))
    names = (t("images") if track.name == "images" else track.name for track in seen.tracks[:8])
    key = [(name, drawing.pass_colour(k)) for k, name in enumerate(names)]
    if len(given):
        inside = np.all((given[:, :2] >= place.low) & (given[:, :2] <= place.high), axis=1)
        outside = t(" ({} of {} outside the map)", int(np.sum(~inside)), len(given)) if not inside.all() else ""
        key.append((t("given position") + outside, "var(--soft)"))
    key += [(t("frame not registered"), "var(--alert)")] if len(missing) else []
    return _drawn(seen, backdrop, key, t("Map of the survey"), [*parts, *ellipses])


def _drawn(seen: Scenery, uri: str, key: Sequence[tuple[str, str]], label: str, parts: Iterable[str] = ()) -> Markup:
    place = seen.place
    drawn, height = drawing.legend(key, place.height + 18)
    below = drawing.clipped(place.height, [drawing.picture(uri, 0, drawing.WIDTH, place.height), *parts])
    return drawing.svg(height, [below, _scale_bar(place), _north_arrow() if seen.north else "", drawn], label)


def _raster(place: Place, xy: np.ndarray, rgb: np.ndarray, pixels: int) -> str:
    """Points (K, 2+) with colours (K, 3) u1 from above as a PNG data URI; the last point of a pixel is visible."""
    inside, cell, size = _cells_of(place, xy, pixels)
    out = np.zeros((size[1] * size[0], 4), np.uint8)
    out[cell] = np.column_stack([rgb[inside], np.full(len(cell), 255)])
    return drawing.png(out.reshape(size[1], size[0], 4))


def _median_cells(place: Place, xy: np.ndarray, values: np.ndarray, pixels: int) -> tuple[np.ndarray, np.ndarray]:
    """(K, 2) middles in the world of the cells, ``pixels`` across, that points lie in, and their median values (K,)."""
    inside, cell, size = _cells_of(place, xy, pixels)
    found = np.unique(cell)
    middle = np.column_stack([found % size[0] + 0.5, -(found // size[0] + 0.5)]) * (drawing.WIDTH / pixels) / place.zoom
    median = ndimage.median(values[inside], cell, found) if len(found) else np.zeros(0)
    return middle + [place.low[0], place.high[1]], np.asarray(median)


def _cells_of(place: Place, xy: np.ndarray, pixels: int) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Which points lie on the map (N,), the numbers of their cells (K,), and how many cells there are each way."""
    column, row = np.floor(place.at(xy) * (pixels / drawing.WIDTH)).astype(int).T
    size = pixels, max(1, round(place.height * pixels / drawing.WIDTH))
    inside = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
    return inside, (row * size[0] + column)[inside], size


def _ellipse(place: Place, centre: np.ndarray, covariance: np.ndarray, factor: float) -> str:
    """One standard deviation of a position, covariance (2, 2) in the plane, enlarged."""
    values, axes = np.linalg.eigh(covariance)
    (x, y), (a, b) = place.at(centre[None, :2])[0], np.sqrt(np.clip(values, 0, None)) * place.zoom * factor
    turn = -math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
    at = f'cx="{x:.1f}" cy="{y:.1f}" rx="{b:.1f}" ry="{a:.1f}" transform="rotate({turn:.1f} {x:.1f} {y:.1f})"'
    return f'<ellipse {at} fill="none" style="stroke:var(--alert)" class="thin"/>'


def _scale_bar(place: Place) -> str:
    length = round_below(0.25 * drawing.WIDTH / place.zoom)
    x, y, end = 12.0, place.height - 12, 12 + length * place.zoom
    unit = place.unit.removesuffix("s") if length == 1 else place.unit
    bar = drawing.line([(x, y - 5), (x, y), (end, y), (end, y - 5)], look="bar")
    return _halo(12, place.height - 42, max(end, 70) - 6, 36) + bar + drawing.text(x, y - 9, f"{length:g} {unit}")


def _north_arrow() -> str:
    """At the upper right; up is north."""
    x = drawing.WIDTH - 20
    arrow = f'<path d="M{x} 8l7 20l-7 -5l-7 5z" class="solid"/>'
    return _halo(x - 12, 4, 24, 42) + arrow + drawing.text(x, 42, "N", "middle")


def _halo(x: float, y: float, width: float, height: float) -> str:
    return f'<rect x="{x - 6:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" rx="3" class="halo"/>'
