"""The line of the water: in single images before any model, then from geometry.

From geometry: a level plane below the cameras, out to the banks of the sparse model. Everything is in the model's
units. The plane's height is measured where the waterlines of the first masks meet the banks, so it needs neither scale
nor GNSS; the first masks' errors average out over thousands of rays.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from tiegraph.masks import EGO, SKY, USE, WATER
from tiegraph.masks.frames import without_small
from tiegraph.masks.matchability import Matchability
from tiegraph.masks.tuning import Tuning
from tiegraph.scene.graph import best_line
from tiegraph.scene.rig import pixel_rays


@dataclass(frozen=True)
class Zone:
    """The zone in a camera's images where nothing ever matches: ``mask`` (r, c) bool; ``says``: log of P(its features |
    water) / P(its features | scene); ``prior`` (r, c) f4: the same by place, clipped."""

    mask: np.ndarray
    prior: np.ndarray
    says: float


def never_matching(evidence: Sequence[Matchability], ego: np.ndarray | None, tuning: Tuning) -> Zone:
    """The zone of a camera's images that no match ever falls into, up from the bottom or the platform.

    Roads and meadows match now and then and are no such zone; places without texture are unknown.
    """
    (rows, columns), own = tuning.water.grid, tuning.water
    matched, missed = np.zeros((rows, columns), np.float32), np.zeros((rows, columns), np.float32)
    for found in evidence:
        row, column = (np.minimum((found.xy[:, k] * n).astype(int), n - 1) for k, n in ((1, rows), (0, columns)))
        np.add.at(matched, (row[found.matched], column[found.matched]), 1)
        np.add.at(missed, (row[~found.matched], column[~found.matched]), 1)
    platform = np.zeros((rows, columns), bool)
    if ego is not None:
        platform = cv2.resize(ego.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA) > 0.3
    matched[platform] = missed[platform] = 0
    # Share of the scene's features that match in each column of the map
    upper = slice(0, int(0.6 * rows))  # in the upper part there is little water
    good, every = (cv2.GaussianBlur(m[upper].sum(axis=0)[None], (0, 0), 3.0)[0] for m in (matched, matched + missed))
    rate = np.clip(good / np.maximum(every, 1e-6), own.water_rate, own.scene_rate)
    exact = matched * np.log(own.water_rate / rate) + missed * np.log((1 - own.water_rate) / (1 - rate))
    cells = 2 * np.pi * own.reach_cells**2
    says = cv2.GaussianBlur(exact, (0, 0), own.reach_cells) * cells * 0.25
    zone = below_waterline(says, platform, tuning)
    zone = without_small(zone, tuning.part * zone.size)
    return Zone(zone, np.clip(says, -tuning.most_says / 3, tuning.most_says / 3), float(exact[zone].sum()))


def water_priors(zones: Mapping[int, Zone], asked: bool, tuning: Tuning) -> dict[int, np.ndarray]:
    """The prior of water in the images of each level camera; {} if no water is accepted.

    Accepted if most of at least ``witnesses`` show it, or if there is a zone and water was ``asked`` for. A camera
    with too few matches of its own has the others' prior by rows.
    """
    wet = [z for z in zones.values() if z.says >= tuning.water.zone_says]
    several = len(zones) >= tuning.witnesses and 2 * len(wet) > len(zones)
    sure = several and sum(z.says for z in wet) >= tuning.water.least_says
    if not wet or not (asked or sure):
        return {}
    rows = np.mean([z.prior.mean(axis=1) for z in wet], axis=0)
    borrowed = np.repeat(rows[:, None], tuning.water.grid[1], axis=1).astype(np.float32)
    return {k: z.prior if z.says >= tuning.water.zone_says else borrowed for k, z in zones.items()}


def below_waterline(ratio: np.ndarray, ego: np.ndarray | None, tuning: Tuning) -> np.ndarray:
    """Water (h, w) bool: everything below the line that best separates water from the rest, but not the platform.

    ``ratio`` (h, w) f4: log of P(appearance | water) / P(appearance | not water). The line runs through every column,
    at the bottom where a column has no water; mirrored banks lie below it and are water. Found exactly, by dynamic
    programming over the columns of blocks.
    """
    height, width = ratio.shape
    credit = np.clip(ratio, -tuning.most_says, tuning.most_says)
    if ego is not None:
        credit = np.where(ego, 0, credit)
    rows, columns = np.minimum(tuning.water.grid, ratio.shape).tolist()
    blocks = cv2.resize(credit, (columns, rows), interpolation=cv2.INTER_AREA) * height / rows
    gain = np.zeros((columns, rows + 1))  # of a line above row r: the credit of all rows from r on
    gain[:, :rows] = np.cumsum(blocks.T[:, ::-1], axis=1)[:, ::-1]
    line = best_line(gain, 0.35 * height / rows)  # for each row between neighbouring columns
    line_px = np.interp(np.arange(width), (np.arange(columns) + 0.5) * width / columns - 0.5, line) * height / rows
    water = np.arange(height)[:, None] + 0.5 > line_px
    return water if ego is None else water & ~ego


@dataclass(frozen=True)
class View:
    """A registered image: ``rays`` (h, C, 3) unit vectors of the pixels of ``columns(w)`` in the model's axes, and its
    ``centre`` (3,)."""

    rays: np.ndarray
    centre: np.ndarray

    def slopes(self, up: np.ndarray) -> np.ndarray:
        """Rise over run (h, C) of the rays."""
        rise = self.rays @ up
        return rise / np.maximum(np.sqrt(np.maximum(1 - rise * rise, 0)), 1e-6)


def columns(width: int, tuning: Tuning) -> np.ndarray:
    """The columns (C,) in which the bank is searched: the middles of those of the map."""
    return ((np.arange(tuning.water.grid[1]) + 0.5) * width / tuning.water.grid[1]).astype(int)


def camera_rays(camera: pycolmap.Camera, shape: tuple[int, ...], tuning: Tuning) -> np.ndarray:
    """Unit rays (h, C, 3) of the pixels of ``columns(w)`` of an image reduced to ``shape`` = (h, w), in camera axes."""
    across, down = np.meshgrid(columns(shape[1], tuning) + 0.5, np.arange(shape[0]) + 0.5)
    pixels = np.stack([across * camera.width / shape[1], down * camera.height / shape[0]], axis=-1)
    return pixel_rays(camera, pixels.reshape(-1, 2)).reshape(*across.shape, 3)


@dataclass(frozen=True)
class Plan:
    """Banks from above: ``full`` (n, m) bool cells of ``cell`` units from ``corner`` (2,), along ``axes`` (2, 3)."""

    axes: np.ndarray
    corner: np.ndarray
    cell: float
    full: np.ndarray

    def distance(self, centre: np.ndarray, towards: np.ndarray) -> np.ndarray:
        """Horizontal distance (K,) from ``centre`` to the first bank along each of ``towards`` (K, 3); inf = none."""
        flat = towards @ self.axes.T
        flat = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
        step = 1.5
        length = np.arange(2, 1.5 * max(self.full.shape) / step) * step  # 1.5: more than the diagonal
        start = (self.axes @ centre - self.corner) / self.cell + 1  # all round the plan is a cell without a bank
        padded = np.pad(self.full, 1)
        across, along = (
            np.clip(start[k] + flat[:, k, None] * length, 0, padded.shape[k] - 1).astype(np.int32) for k in (0, 1)
        )
        met = padded[across, along]
        return np.where(met.any(axis=1), length[met.argmax(axis=1)] * self.cell, np.inf)


@dataclass(frozen=True)
class Water:
    """The water: ``level`` its height along the upward direction, ``depth`` below the cameras, ``spread`` of
    the heights by single rays, their number ``rays``, and the banks in plan."""

    level: float
    depth: float
    spread: float
    rays: int
    plan: Plan


def first_line(classes: np.ndarray, tuning: Tuning) -> np.ndarray:
    """First row (C,) of water in classes (h, w) u1, at ``columns(w)``; NaN where there is none or where the platform
    hides the bank."""
    own = classes[:, columns(classes.shape[1], tuning)]
    water = own == WATER
    row = water.argmax(axis=0)
    above = own[np.maximum(row - 3, 0), np.arange(len(row))]
    return np.where(water.any(axis=0) & (row > 0) & (above != EGO), row, np.nan)


def find_water(
    views: Sequence[View], lines: Sequence[np.ndarray], points: np.ndarray, up: np.ndarray, tuning: Tuning
) -> Water | None:
    """The water's plane and the banks, from ``first_line`` of level views and the points (P, 3) of the model.

    ``up``: unit vector (3,). None if too few waterlines meet a bank, or disagree. Done in rounds: first the banks are
    all points round the cameras' height, then those just above the water.
    """
    if not len(views):
        return None
    centres = np.stack([v.centre for v in views])
    camera, heights = float(np.median(centres @ up)), points @ up
    below = heights[heights < camera]
    if not len(below):
        return None
    level, spread, count = float(np.quantile(below, 0.05)), 0.0, 0
    for _ in range(2):
        plan = _plan(points, up, (level, level + tuning.water.band * (camera - level)), centres, tuning)
        found = np.concatenate([_heights(v, line, plan, up) for v, line in zip(views, lines)])
        if len(found) < 100:
            return None
        low, level, high = (float(q) for q in np.quantile(found, (0.25, 0.5, 0.75)))
        spread, count = (high - low) / 2, len(found)
        if level >= camera:
            return None
    if spread > 0.35 * (camera - level):
        return None
    return Water(level=level, depth=camera - level, spread=spread, rays=count, plan=plan)


def _plan(points: np.ndarray, up: np.ndarray, band: tuple[float, float], centres: np.ndarray, tuning: Tuning) -> Plan:
    """The banks: points (P, 3) whose height is within ``band``, within reach of the cameras."""
    first = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0, 1.0, 0])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(up, first)])
    height = points @ up
    flat = points[(height > band[0]) & (height < band[1])] @ axes.T
    path = centres @ axes.T
    reach = max(float(np.ptp(path, axis=0).max()), 10.0 * (band[1] - band[0]))
    if len(flat):
        flat = flat[cKDTree(path).query(flat, distance_upper_bound=reach)[0] < reach]
    if not len(flat):
        return Plan(axes=axes, corner=np.zeros(2), cell=1.0, full=np.zeros((1, 1), bool))
    corner = np.minimum(flat.min(axis=0), path.min(axis=0))
    size = np.maximum(flat.max(axis=0), path.max(axis=0)) - corner
    cell = max(float(size.max()) / tuning.water.cells, 1e-9)
    place = np.floor((flat - corner) / cell).astype(int)
    count = np.zeros(place.max(axis=0) + 1, np.float32)
    np.add.at(count, (place[:, 0], place[:, 1]), 1)
    around = cv2.blur(count, (3, 3), borderType=cv2.BORDER_CONSTANT) * 9
    return Plan(axes=axes, corner=corner, cell=cell, full=around > tuning.witnesses - 0.5)


def _heights(view: View, line: np.ndarray, plan: Plan, up: np.ndarray) -> np.ndarray:
    """Heights at which the waterline of an image meets the banks."""
    known = np.flatnonzero(np.isfinite(line))
    if not len(known):
        return np.zeros(0)
    rows = np.clip(line[known].astype(int), 0, len(view.rays) - 1)
    slope = view.slopes(up)[rows, known]
    distance = plan.distance(view.centre, view.rays[rows, known])
    use = np.isfinite(distance) & (slope < -0.02)  # flatter rays meet the plane too far off
    return view.centre @ up + slope[use] * distance[use]


@dataclass(frozen=True)
class Lines:
    """Of one image, by geometry: first row (C,) of water (NaN = no bank is known there) and of what is below the
    horizon, at ``columns(w)``; the height of the image if a column has none."""

    water: np.ndarray
    horizon: np.ndarray


def lines_of(view: View, up: np.ndarray, water: Water | None) -> Lines:
    """Where in an image the water and the lower half of the world begin."""
    rise = view.rays @ up
    horizon = _first(rise < _rise(-0.05))  # up is known to about 3 degrees
    if water is None:
        return Lines(np.full(rise.shape[1], np.nan), horizon)
    across = np.arange(rise.shape[1])
    level = view.rays[np.argmin(np.abs(rise), axis=0), across]
    distance = water.plan.distance(view.centre, level)
    drop = water.level - float(view.centre @ up)
    row = _first(rise < _rise(drop / distance))
    return Lines(np.where(np.isfinite(distance) & (drop < 0), row, np.nan), horizon)


def _rise(slope: np.ndarray | float) -> np.ndarray:
    """Rise of a unit vector with this rise over run."""
    return np.asarray(slope / np.sqrt(1 + np.square(slope)))


def _first(below: np.ndarray) -> np.ndarray:
    return np.where(below.any(axis=0), below.argmax(axis=0), len(below)).astype(np.float64)


def final_classes(first: np.ndarray, lines: Lines, tuning: Tuning) -> np.ndarray:
    """The classes (h, w) u1 of the first pass, with the water from geometry where it is known, and no sky below the
    horizon. The platform stays as it was learnt."""
    height, width = first.shape
    row = np.arange(height, dtype=np.float32)[:, None]
    at = columns(width, tuning)
    below = row >= np.interp(np.arange(width), at, lines.horizon).astype(np.float32)
    waterline = _bridged(lines.water, 0.5)
    known = np.isfinite(waterline)
    out = first.copy()
    out[((first == SKY) & below) | ((first == WATER) & ~below)] = USE
    if known.any():
        line = np.interp(np.arange(width), at[known], waterline[known])
        inside = np.interp(np.arange(width), at, known.astype(float)) > 0.5
        out[(out == WATER) & inside] = USE
        out[row >= np.where(inside, line, np.inf).astype(np.float32)] = WATER
    out[first == EGO] = EGO
    return out


def _bridged(line: np.ndarray, widest: float) -> np.ndarray:
    """A line (C,) with its gaps, up to ``widest`` of its length, filled straight: piers without texture and the far end
    of a canal have no points."""
    known = np.flatnonzero(np.isfinite(line))
    if not len(known):
        return line
    at = np.arange(len(line))
    after = np.searchsorted(known, at).clip(1 if len(known) > 1 else 0, len(known) - 1)
    gap = known[after] - known[np.maximum(after - 1, 0)]
    inside = (at >= known[0]) & (at <= known[-1])
    return np.where(inside & (gap <= widest * len(line)), np.interp(at, known, line[known]), line)
