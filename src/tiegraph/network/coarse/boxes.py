"""Points in compact groups: which of them a cone may touch, without looking at all points."""

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.network.coarse.proxy import Proxy

_LEAF = 64  # points of a box that is tested as one


class Boxes:
    """The points of a proxy by groups, so that an image looks only at those near its field of view."""

    def __init__(self, proxy: Proxy) -> None:
        self.order = np.asarray(cKDTree(proxy.points, leafsize=_LEAF).indices)
        starts = np.arange(0, len(proxy), _LEAF)
        points = proxy.points[self.order]
        low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
        self.middle, self.radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
        self.reach = np.maximum.reduceat(proxy.reach[self.order], starts)

    def near(self, centre: np.ndarray, axis: np.ndarray, half: float) -> np.ndarray:
        """Indices of the points whose group touches a cone of half angle ``half`` and is within reach."""
        way = self.middle - centre
        distance = np.linalg.norm(way, axis=1)
        touches = distance - self.radius < self.reach
        if half < np.pi / 2:
            along = way @ axis
            across = np.sqrt(np.maximum(distance**2 - along**2, 0))
            touches &= across * np.cos(half) - along * np.sin(half) < self.radius
        rows = (np.flatnonzero(touches)[:, None] * _LEAF + np.arange(_LEAF)).ravel()
        return self.order[rows[rows < len(self.order)]]
