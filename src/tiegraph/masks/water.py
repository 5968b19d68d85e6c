"""Water in images: where features never match again, and the line below which everything is water."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.masks.evidence import Evidence

_GRID = (60, 80)  # rows and columns of the map of matches of a camera
_REACH = 1.5  # sigma of the map, in its cells
# Share of features found again in the next frame: 0.01 .. 0.03 on water, 0.24 .. 0.38 on the scene (rendered canal),
# 0.1 .. 0.25 on streets (PandaSet, KITTI); less at the sides, where the scene leaves the image.
_WATER_RATE, _LEAST_RATE, _MOST_RATE = 0.02, 0.025, 0.25
# Before water is believed without being asked for: cameras that look level, the share of them with a zone, and what the
# zone of each says, as log of P(features | water) / P(features | scene). A road ahead does not match either when the
# car is fast (KITTI, CamVid), so cameras that look one way only prove nothing; to the side a road matches.
_LEAST_CAMERAS, _LEAST_SHARE, _ZONE_SAYS, _LEAST_SAYS = 3, 0.6, 8.0, 120.0
_LEAST_AREA = 0.02  # of the image
_HIGHEST = 0.25  # share of the height: a zone that reaches above it is no water seen from above it
_PRIOR_CLIP = 1.0
_STEP_COST = 0.35  # of the waterline, for each row between neighbouring columns
_COLUMN_PX, _ROW_PX = 4, 2  # the waterline is found on blocks of this size
_MOST_CREDIT = 3.0  # one pixel's log ratio counts this much at most


@dataclass(frozen=True)
class Zone:
    """Where in a camera's images nothing ever matches: ``mask`` (60, 80) bool; ``says``: log of P(its features | water)
    / P(its features | scene); ``prior`` (60, 80) f4: the same by place, clipped."""

    mask: np.ndarray
    prior: np.ndarray
    says: float


def never_matching(evidence: Sequence[Evidence], ego: np.ndarray | None) -> Zone:
    """The zone of a camera's images that no match ever falls into, up from the bottom or the platform.

    Roads and meadows match now and then and are no such zone; of a place without texture this knows nothing.
    """
    matched, missed = np.zeros(_GRID, np.float32), np.zeros(_GRID, np.float32)
    for found in evidence:
        row, column = (np.minimum((found.xy[:, k] * n).astype(int), n - 1) for k, n in ((1, _GRID[0]), (0, _GRID[1])))
        np.add.at(matched, (row[found.matched], column[found.matched]), 1)
        np.add.at(missed, (row[~found.matched], column[~found.matched]), 1)
    platform = np.zeros(_GRID, bool) if ego is None else _shrunk(ego)
    matched[platform] = missed[platform] = 0
    rate = _scene_rate(matched, missed)
    exact = matched * np.log(_WATER_RATE / rate) + missed * np.log((1 - _WATER_RATE) / (1 - rate))
    says = cv2.GaussianBlur(exact, (0, 0), _REACH) * (2 * np.pi * _REACH**2) / 4
    zone = below_waterline(says, platform, (1, 1))
    top = np.where(zone.any(axis=0), zone.argmax(axis=0), _GRID[0])
    zone = _large(zone & (top >= _HIGHEST * _GRID[0])[None])
    prior = np.clip(says, -_PRIOR_CLIP, _PRIOR_CLIP)
    return Zone(zone, prior, float(exact[zone].sum()))


def _scene_rate(matched: np.ndarray, missed: np.ndarray) -> np.ndarray:
    """Share (columns,) f4 of the scene's features that match in each column of the map."""
    upper = slice(0, int(0.6 * _GRID[0]))  # there is little water
    good, all_ = (cv2.GaussianBlur(m[upper].sum(axis=0)[None], (0, 0), 3) for m in (matched, matched + missed))
    return np.clip(good[0] / np.maximum(all_[0], 1e-6), _LEAST_RATE, _MOST_RATE)


def _shrunk(mask: np.ndarray) -> np.ndarray:
    return cv2.resize(mask.astype(np.float32), _GRID[::-1], interpolation=cv2.INTER_AREA) > 0.3


def _large(zone: np.ndarray) -> np.ndarray:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(zone.astype(np.uint8), connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= _LEAST_AREA * zone.size
    large[0] = False
    return large[labels]


def water_priors(zones: Mapping[int, Zone], asked: bool) -> dict[int, np.ndarray]:
    """The prior of water in the images of each level camera; {} if no water is believed.

    Believed if most of at least three cameras say so, or if there is any zone and water was ``asked`` for. A camera
    whose own matches are too few to say where has the others' prior by rows.
    """
    wet = [z for z in zones.values() if z.says >= _ZONE_SAYS]
    several = len(zones) >= _LEAST_CAMERAS and len(wet) >= _LEAST_SHARE * len(zones)
    sure = several and sum(z.says for z in wet) >= _LEAST_SAYS
    if not wet or not (asked or sure):
        return {}
    rows = np.mean([z.prior.mean(axis=1) for z in wet], axis=0)
    borrowed = np.repeat(rows[:, None], _GRID[1], axis=1).astype(np.float32)
    return {k: z.prior if z.says >= _ZONE_SAYS else borrowed for k, z in zones.items()}


def below_waterline(
    ratio: np.ndarray, ego: np.ndarray | None, block: tuple[int, int] = (_COLUMN_PX, _ROW_PX)
) -> np.ndarray:
    """Water (h, w) bool: everything below the line that best parts water from the rest, but not the platform.

    ``ratio`` (h, w) f4: log of P(appearance | water) / P(appearance | not water). The line runs through every column,
    at the bottom where a column has no water; mirrored banks lie below it and are water. Found exactly, by dynamic
    programming over the columns.
    """
    height, width = ratio.shape
    credit = np.clip(ratio, -_MOST_CREDIT, _MOST_CREDIT)
    if ego is not None:
        credit = np.where(ego, 0, credit)
    rows, columns = max(1, height // block[1]), max(1, width // block[0])
    blocks = cv2.resize(credit, (columns, rows), interpolation=cv2.INTER_AREA) * block[1]
    gain = np.zeros((columns, rows + 1))  # of a line above row r: the credit of all rows from r on
    gain[:, :rows] = np.cumsum(blocks.T[:, ::-1], axis=1)[:, ::-1]
    line = _best_line(gain, _STEP_COST * block[1])
    line_px = np.interp(np.arange(width), (np.arange(columns) + 0.5) * width / columns - 0.5, line) * height / rows
    water = np.arange(height)[:, None] + 0.5 > line_px
    return water if ego is None else water & ~ego


def _best_line(gain: np.ndarray, cost: float) -> np.ndarray:
    """Row (C,) of each column with the largest sum of ``gain`` (C, R), less ``cost`` a row between columns."""
    slope = cost * np.arange(gain.shape[1])
    best = [gain[0]]
    for column in gain[1:]:
        before = best[-1]
        down = np.maximum.accumulate(before + slope) - slope
        up = np.maximum.accumulate((before - slope)[::-1])[::-1] + slope
        best.append(column + np.maximum(down, up))
    line = [int(np.argmax(best[-1]))]
    for before in best[-2::-1]:
        line.append(int(np.argmax(before - np.abs(slope - slope[line[-1]]))))
    return np.array(line[::-1])
