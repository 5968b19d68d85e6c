"""Water in images: where features never match again, and the line below which everything is water."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.masks.matchability import Matchability
from tiegraph.masks.morphology import without_small
from tiegraph.masks.tuning_learnt import WaterTuning
from tiegraph.scene.graph import best_line


@dataclass(frozen=True)
class Zone:
    """The zone in a camera's images where nothing ever matches: ``mask`` (r, c) bool; ``says``: log of P(its features |
    water) / P(its features | scene); ``prior`` (r, c) f4: the same by place, clipped."""

    mask: np.ndarray
    prior: np.ndarray
    says: float


def never_matching(evidence: Sequence[Matchability], ego: np.ndarray | None, tuning: WaterTuning) -> Zone:
    """The zone of a camera's images that no match ever falls into, up from the bottom or the platform.

    Roads and meadows match now and then and are no such zone; places without texture are unknown.
    """
    rows, columns = tuning.grid
    matched, missed = np.zeros((rows, columns), np.float32), np.zeros((rows, columns), np.float32)
    for found in evidence:
        row, column = (np.minimum((found.xy[:, k] * n).astype(int), n - 1) for k, n in ((1, rows), (0, columns)))
        np.add.at(matched, (row[found.matched], column[found.matched]), 1)
        np.add.at(missed, (row[~found.matched], column[~found.matched]), 1)
    platform = np.zeros((rows, columns), bool) if ego is None else _shrunk(ego, tuning)
    matched[platform] = missed[platform] = 0
    rate, in_water = _scene_rate(matched, missed, tuning), tuning.water_rate
    exact = matched * np.log(in_water / rate) + missed * np.log((1 - in_water) / (1 - rate))
    cells = 2 * np.pi * tuning.reach_cells**2
    says = cv2.GaussianBlur(exact, (0, 0), tuning.reach_cells) * cells * 0.25
    zone = below_waterline(says, platform, tuning, (1, 1))
    top = np.where(zone.any(axis=0), zone.argmax(axis=0), rows)
    zone = without_small(zone & (top >= tuning.highest * rows)[None], tuning.min_area * zone.size)
    prior = np.clip(says, -tuning.prior_clip, tuning.prior_clip)
    return Zone(zone, prior, float(exact[zone].sum()))


def _scene_rate(matched: np.ndarray, missed: np.ndarray, tuning: WaterTuning) -> np.ndarray:
    """Share (columns,) f4 of the scene's features that match in each column of the map."""
    upper = slice(0, int(0.6 * len(matched)))  # in the upper part there is little water
    good, every = (cv2.GaussianBlur(m[upper].sum(axis=0)[None], (0, 0), 3.0) for m in (matched, matched + missed))
    return np.clip(good[0] / np.maximum(every[0], 1e-6), tuning.min_scene_rate, tuning.max_scene_rate)


def _shrunk(mask: np.ndarray, tuning: WaterTuning) -> np.ndarray:
    share = cv2.resize(mask.astype(np.float32), tuning.grid[::-1], interpolation=cv2.INTER_AREA)
    return share > 0.3


def water_priors(zones: Mapping[int, Zone], asked: bool, tuning: WaterTuning) -> dict[int, np.ndarray]:
    """The prior of water in the images of each level camera; {} if no water is accepted.

    Accepted if most of at least ``least_cameras`` show it, or if there is a zone and water was ``asked`` for. A camera
    with too few matches of its own has the others' prior by rows.
    """
    wet = [z for z in zones.values() if z.says >= tuning.zone_says]
    several = len(zones) >= tuning.least_cameras and len(wet) >= tuning.least_share * len(zones)
    sure = several and sum(z.says for z in wet) >= tuning.least_says
    if not wet or not (asked or sure):
        return {}
    rows = np.mean([z.prior.mean(axis=1) for z in wet], axis=0)
    borrowed = np.repeat(rows[:, None], tuning.grid[1], axis=1).astype(np.float32)
    return {k: z.prior if z.says >= tuning.zone_says else borrowed for k, z in zones.items()}


def below_waterline(
    ratio: np.ndarray, ego: np.ndarray | None, tuning: WaterTuning, block_px: tuple[int, int] | None = None
) -> np.ndarray:
    """Water (h, w) bool: everything below the line that best separates water from the rest, but not the platform.

    ``ratio`` (h, w) f4: log of P(appearance | water) / P(appearance | not water). The line runs through every column,
    at the bottom where a column has no water; mirrored banks lie below it and are water. Found exactly, by dynamic
    programming over the columns of blocks.
    """
    height, width = ratio.shape
    block = block_px or tuning.block_px
    credit = np.clip(ratio, -tuning.max_credit, tuning.max_credit)
    if ego is not None:
        credit = np.where(ego, 0, credit)
    rows, columns = max(1, height // block[1]), max(1, width // block[0])
    blocks = cv2.resize(credit, (columns, rows), interpolation=cv2.INTER_AREA) * block[1]
    gain = np.zeros((columns, rows + 1))  # of a line above row r: the credit of all rows from r on
    gain[:, :rows] = np.cumsum(blocks.T[:, ::-1], axis=1)[:, ::-1]
    line = best_line(gain, 0.35 * block[1])  # for each row between neighbouring columns
    line_px = np.interp(np.arange(width), (np.arange(columns) + 0.5) * width / columns - 0.5, line) * height / rows
    water = np.arange(height)[:, None] + 0.5 > line_px
    return water if ego is None else water & ~ego
