"""Points in compact groups, and these in groups: which of them a cone touches, without looking at all of them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.network.coarse.proxy import Proxy

_LEAF = 64  # points of a box that is tested as one
_FAN = 256  # boxes of a group that is tested as one


@dataclass(frozen=True)
class _Balls:
    """Compact groups of points (K,): middle (K, 3), radius that holds them, the furthest reach of their points."""

    middle: np.ndarray
    radius: np.ndarray
    reach: np.ndarray

    def around(self) -> "_Balls":
        """Of each ``_FAN`` in a row one that holds them."""
        starts = np.arange(0, len(self.radius), _FAN)
        middle = (np.minimum.reduceat(self.middle, starts) + np.maximum.reduceat(self.middle, starts)) / 2
        off = np.linalg.norm(self.middle - np.repeat(middle, _FAN, axis=0)[: len(self.middle)], axis=1)
        return _Balls(middle, np.maximum.reduceat(off + self.radius, starts), np.maximum.reduceat(self.reach, starts))

    def touching(self, rows: np.ndarray, centre: np.ndarray, axis: np.ndarray, half: float) -> np.ndarray:
        """Of ``rows`` those that touch a cone of half angle ``half`` and have a point within reach."""
        radius = self.radius[rows]
        way = self.middle[rows] - centre
        along = way @ axis
        distance = np.linalg.norm(way, axis=1)
        touches = distance - radius < self.reach[rows]
        if half < np.pi / 2:
            across = np.sqrt(np.maximum(distance**2 - along**2, 0))
            touches &= across * np.cos(half) - along * np.sin(half) < radius
        return rows[touches]


class Boxes:
    """The points of a proxy by groups, so that an image looks only at those near its field of view."""

    def __init__(self, proxy: Proxy) -> None:
        self.order = np.asarray(cKDTree(proxy.points, leafsize=_LEAF).indices)
        starts = np.arange(0, len(proxy), _LEAF)
        sorted_ = proxy.points[self.order]
        low, high = np.minimum.reduceat(sorted_, starts), np.maximum.reduceat(sorted_, starts)
        reach = np.maximum.reduceat(proxy.reach[self.order], starts)
        self.levels = [_Balls((low + high) / 2, np.linalg.norm(high - low, axis=1) / 2, reach)]
        while len(self.levels[-1].radius) > _FAN:
            self.levels.append(self.levels[-1].around())

    def near(self, centre: np.ndarray, axis: np.ndarray, half: float) -> np.ndarray:
        """Indices of the points whose group touches a cone of half angle ``half`` and is within reach."""
        rows = np.arange(len(self.levels[-1].radius))
        for level, below in zip(self.levels[:0:-1], self.levels[-2::-1]):
            rows = _members(level.touching(rows, centre, axis, half), _FAN, len(below.radius))
        rows = _members(self.levels[0].touching(rows, centre, axis, half), _LEAF, len(self.order))
        return self.order[rows]


def _members(groups: np.ndarray, size: int, count: int) -> np.ndarray:
    """Rows of the members of groups of ``size`` each, of ``count`` in all."""
    rows = (groups[:, None] * size + np.arange(size)).ravel()
    return rows[rows < count]
