"""Hierarchical semi-global matching of a rectified pair, tSGM (paper 004, section 5.2; kernels in the native module).

A pyramid level is matched over the full range where that is cheap; below it each pixel keeps the disparities its
neighbourhood had on the level above. The costs are census, on the last level blended with mutual information.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.dense.mutual import mutual_information
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.speckles import without_speckles
from tiegraph.errors import EngineMissing

try:
    from tiegraph.dense import _sgm
except ImportError:  # installed without a C++ compiler
    _sgm = None  # type: ignore[assignment]

_memory = threading.local()
_log = logging.getLogger(__name__)

_FULL_RANGE = 256  # disparities at most of the level that is matched over its full range
_DENSE_BELOW = 16  # with so few disparities per-pixel ranges save nothing
_QUARTER = 2  # halvings to a quarter of the size
_VOLUME_BYTES = 256_000_000  # of the cost volumes held at once; a level that needs more is matched in strips
_CELL_BYTES = 2  # a cost and half a sum for each pixel and disparity; over the full range costs are made anew
_STRIP_OVERLAP = 64  # rows after which a path has nearly forgotten where it began
_BLOCK = 16  # disparities that the kernels take at once
_MODES = {"census": 0, "blend": 1, "mutual": 2}


@dataclass(frozen=True)
class Tuning:
    """Parameters of the matcher that are the same for every user; benchmarks/dense/README.md says how they were found.

    radius: of the census window; small, large: P1 and P2; P2 falls with the grey step, from ``knee`` grey values on, to
    ``floor`` of itself; reach: pixels of the coarser level around a pixel whose disparities it is given; hole_limit:
    disparities at most where the coarser level has none; parabola or equiangular lines below the pixel; cost: on the
    last level census, mutual or the mean of both; full_range: disparities at most of the level matched over its full
    range; dense_below: with so few, there is one level only; everywhere: matched over the full range (a reference for
    measurements); kernel: empty = the fastest.
    """

    radius: tuple[int, int] = (4, 3)
    small: int = 20
    large: int = 120
    floor: float = 0.25
    knee: float = 6.0
    reach: int = 3
    hole_limit: int = 254
    uniqueness: int = 0
    parabola: bool = False
    cost: str = "blend"
    full_range: int = _FULL_RANGE
    dense_below: int = _DENSE_BELOW
    everywhere: bool = False
    coarse_speckle_px: int = 0
    kernel: str = ""


def available() -> bool:
    """Whether the native module is installed."""
    return _sgm is not None


def kernels() -> list[str]:
    """The native kernels that this machine runs, the fastest first; [] without the native module."""
    return [] if _sgm is None else list(_sgm.kernels())


def volume_bytes(height: int, width: int, disparities: int) -> int:
    """Most bytes of cost volumes that matching a pair of images (height, width) holds at once, known before it starts.

    Levels that would need more than 256 MB are matched in strips; a strip has at least 192 rows.
    """
    tuning = Tuning()
    levels = _levels(disparities, tuning)
    most = 0
    for level in range(levels + 1):
        h, w = -(-height >> level), -(-width >> level)
        count = -(-disparities >> level)
        each = count if level == levels else min(count + _BLOCK, tuning.hole_limit + 2 * _BLOCK)
        each = -(-each // _BLOCK) * _BLOCK
        rows = min(h, 3 * _STRIP_OVERLAP)
        cell = 1 if level == levels else _CELL_BYTES
        most = max(most, min(h * w * each * cell, max(_VOLUME_BYTES, rows * w * each * cell)))
    return most


def match_tsgm(
    left: np.ndarray, right: np.ndarray, disparities: int, settings: DenseSettings, use: np.ndarray | None = None
) -> np.ndarray:
    """Disparity (h, w) f4 px of each left pixel, NaN = none: the ``PairMatcher`` contract of ``dense.engine``.

    left (h, w) u1; right (h, w + disparities) u1, whose column ``disparities`` lies under the left's column 0: left
    (x, y) shows what right (x + disparities - d, y) shows, 0 <= d < disparities; use (h, w) bool: where the disparity
    matters. Raises EngineMissing where the native module was not built.
    """
    found = match(left, right, disparities, disparities, Tuning(), use)
    return without_speckles(found)


def match(
    left: np.ndarray,
    right: np.ndarray,
    shift: int,
    disparities: int,
    tuning: Tuning,
    use: np.ndarray | None = None,
) -> np.ndarray:
    """Disparity (h, w) f4, NaN = none, checked left to right: left (x, y) shows what right (x + shift - d, y) shows.

    left (h, w) u1, right (h, any) u1, 0 <= d < disparities. Pixels not in use (h, w) bool get the least work: sky and
    platform have no answer on the coarser level, and would be searched as holes, over 128 disparities.
    """
    if _sgm is None:
        raise EngineMissing(
            "the native matcher is not installed: install a C++ compiler and tiegraph again, or use --dense.engine sgbm"
        )
    levels = _levels(disparities, tuning)
    aligned = -(-shift >> levels) << levels  # so that every level's shift is whole
    right = cv2.copyMakeBorder(right, 0, 0, aligned - shift, 0, cv2.BORDER_REPLICATE)
    lefts, rights, uses = [np.ascontiguousarray(left)], [np.ascontiguousarray(right)], [use]
    for _ in range(levels):
        lefts.append(_sgm.halve(lefts[-1]))
        rights.append(_sgm.halve(rights[-1]))
        uses.append(_halved(uses[-1]))
    workspace = _workspace()
    found = None
    coarser = levels
    for level in (levels, 0) if tuning.everywhere else range(levels, -1, -1):
        rules = _sgm.RangeRules()
        rules.low, rules.count = -(aligned >> level), -(-disparities >> level)
        rules.reach, rules.hole_limit = tuning.reach, tuning.hole_limit
        pair = _Level(lefts[level], rights[level], rules, _options(tuning, level == 0 and levels > 0), workspace)
        if found is None:
            found = pair.full()
        else:
            above = (lefts[coarser], rights[coarser], found)
            blended = level == 0 and tuning.cost != "census"
            mutual = mutual_information(_sgm.joint_greys(*above)) if blended else None
            found = pair.full(mutual) if tuning.everywhere else pair.within(found, mutual, uses[level])
        if level and tuning.coarse_speckle_px:
            found = without_speckles(found - rules.low, tuning.coarse_speckle_px) + rules.low
        coarser = level
    assert found is not None
    found += np.float32(aligned)
    inside = (found > -0.5) & (found < disparities - 0.5)  # whole blocks reach a little over the range
    found[~inside] = np.nan
    return found


def _halved(use: np.ndarray | None) -> np.ndarray | None:
    """(ceil(h / 2), ceil(w / 2)) bool: any of the 2 x 2 pixels is in use."""
    if use is None:
        return None
    even = np.pad(use, [(0, n % 2) for n in use.shape])
    return even[::2, ::2] | even[1::2, ::2] | even[::2, 1::2] | even[1::2, 1::2]


def _workspace() -> _sgm.Workspace:
    """This thread's memory for cost volumes: fetching it anew for each pair would take a tenth of the time."""
    if not hasattr(_memory, "workspace"):
        _memory.workspace = _sgm.Workspace()
    return _memory.workspace


def _levels(disparities: int, tuning: Tuning) -> int:
    """Halvings until the full range is cheap; at least one unless there are few disparities anyway. A match over the
    full range at full size has one of a quarter of it, which tells what grey values belong together."""
    if tuning.everywhere:
        return _QUARTER
    levels = 0 if disparities <= tuning.dense_below else 1
    while disparities >> levels > tuning.full_range:
        levels += 1
    return levels


def _options(tuning: Tuning, last: bool) -> _sgm.Options:
    options = _sgm.Options()
    options.radius_x, options.radius_y = tuning.radius
    options.small, options.large = tuning.small, tuning.large
    steps = [max(1.0, 4 * k + 2) for k in range(16)]
    options.large_by_step = [
        max(tuning.small, round(tuning.large * max(tuning.floor, min(1.0, tuning.knee / step)))) for step in steps
    ]
    options.parabola = tuning.parabola
    options.uniqueness = tuning.uniqueness if last else 0
    options.mode = _MODES[tuning.cost] if last else 0
    options.kernel = tuning.kernel
    return options


@dataclass(frozen=True, eq=False)
class _Level:
    """One level of the pyramid: images, the disparities there, options."""

    left: np.ndarray
    right: np.ndarray
    rules: _sgm.RangeRules
    options: _sgm.Options
    workspace: _sgm.Workspace

    def full(self, mutual: np.ndarray | None = None) -> np.ndarray:
        """Every disparity at every pixel."""
        height, width = self.left.shape
        low, count = self.rules.low, self.rules.count
        parts = []
        for strip, inner in _strips(np.full(height, width * count)):  # bytes
            found, _ = _sgm.match_dense(
                self.left[strip], self.right[strip], low, count, self.options, self.workspace, mutual
            )
            parts.append(found[inner])
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def within(self, coarse: np.ndarray, mutual: np.ndarray | None, use: np.ndarray | None) -> np.ndarray:
        """The disparities that the coarser level leaves."""
        height, width = self.left.shape
        first, blocks, cells = _sgm.ranges(coarse, width, height, self.rules)
        _log.debug("%.1f disparities a pixel at %s", cells / self.left.size, self.left.shape)
        if use is not None:  # one block in the middle of the range
            first = np.where(use, first, first + _BLOCK // 2 * (blocks.astype(np.int16) - 1))
            blocks = np.where(use, blocks, np.uint8(1))
        parts = []
        for strip, inner in _strips(_CELL_BYTES * _BLOCK * blocks.sum(axis=1, dtype=np.int64)):
            found, _ = _sgm.match_ragged(
                self.left[strip], self.right[strip], first[strip], blocks[strip], self.options, self.workspace, mutual
            )
            parts.append(found[inner])
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _strips(volume: np.ndarray) -> list[tuple[slice, slice]]:
    """Rows matched together, and which of the found ones count, so that the volumes, ``volume`` (h,) bytes in each row,
    stay within _VOLUME_BYTES; a strip is never less than its overlap."""
    height, limit = len(volume), _VOLUME_BYTES
    before = np.concatenate([[0], np.cumsum(volume)])
    if before[-1] <= limit:
        return [(slice(0, height), slice(0, height))]
    strips, top = [], 0
    while top < height:
        low = max(0, top - _STRIP_OVERLAP)
        high = int(np.searchsorted(before, before[low] + limit, "right")) - 1
        high = min(height, max(high, top + 2 * _STRIP_OVERLAP))
        bottom = height if high == height else high - _STRIP_OVERLAP
        strips.append((slice(low, high), slice(top - low, bottom - low)))
        top = bottom
    return strips
