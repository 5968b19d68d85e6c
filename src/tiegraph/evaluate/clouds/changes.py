"""What has changed between two epochs: significant differences that stand together, with area and volume."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tiegraph.evaluate.clouds.m3c2 import Differences
from tiegraph.evaluate.tuning import ChangesTuning

COLUMNS = ("change", "x", "y", "z", "core points", "area m2", "mean m", "largest m", "volume m3")


@dataclass(frozen=True)
class Change:
    """A connected piece of surface that moved one way: its middle (3,), number of core points, area, mean and largest
    difference (+: towards the cameras, or up), and volume (area times difference)."""

    middle: np.ndarray
    cores: int
    area_m2: float
    mean_m: float
    largest_m: float
    volume_m3: float


@dataclass(frozen=True)
class Changes:
    """The changes, largest volume first, and areas of what was compared, called significant, and listed."""

    listed: tuple[Change, ...]
    compared_m2: float
    significant_m2: float

    def totals(self) -> dict[str, float]:
        """Areas in m2 and volumes in m3."""
        gain = sum(c.volume_m3 for c in self.listed if c.volume_m3 > 0)
        loss = sum(c.volume_m3 for c in self.listed if c.volume_m3 < 0)
        return {
            "compared_m2": self.compared_m2,
            "significant_m2": self.significant_m2,
            "changed_m2": sum(c.area_m2 for c in self.listed),
            "gain_m3": gain,
            "loss_m3": -loss,
        }

    def table(self, shift: np.ndarray, most: int) -> dict:
        """The largest changes at most; ``shift`` (3,) is added to their places."""
        rows = [
            [k, *(c.middle + shift).tolist(), c.cores, c.area_m2, c.mean_m, c.largest_m, c.volume_m3]
            for k, c in enumerate(self.listed[:most], 1)
        ]
        return {"columns": list(COLUMNS), "rows": rows}


def changes(found: Differences, tuning: ChangesTuning) -> Changes:
    """Changes by significant core points near each other with differences of one sign.

    Fewer than ``least_cores`` together are chance: 5 % of unchanged ones are significant.
    """
    known = found.known
    xyz, distance, loud = found.xyz[known], found.distance_m[known].astype(float), found.significant[known]
    area = _areas(xyz, tuning.area_spacings * found.cylinders.cores_m)
    where = np.flatnonzero(loud)
    out = []
    for sign in (1, -1):
        rows = where[np.sign(distance[where]) == sign]
        for piece in _pieces(xyz[rows], tuning.link_spacings * found.cylinders.cores_m):
            if len(piece) < tuning.least_cores:
                continue
            own, a = distance[rows[piece]], area[rows[piece]]
            out.append(
                Change(
                    middle=np.median(xyz[rows[piece]], axis=0),
                    cores=len(piece),
                    area_m2=float(a.sum()),
                    mean_m=float(np.average(own, weights=a)),
                    largest_m=float(own[np.argmax(np.abs(own))]),
                    volume_m3=float(a @ own),
                )
            )
    out.sort(key=lambda c: -abs(c.volume_m3))
    return Changes(listed=tuple(out), compared_m2=float(area.sum()), significant_m2=float(area[loud].sum()))


def _areas(xyz: np.ndarray, radius: float) -> np.ndarray:
    """(N,) the surface that each point stands for: a disc shared by the points in it; at a border too large by half."""
    if not len(xyz):
        return np.zeros(0)
    tree = cKDTree(xyz)
    return np.pi * radius**2 / tree.query_ball_point(xyz, radius, return_length=True, workers=-1)


def _pieces(xyz: np.ndarray, link: float) -> list[np.ndarray]:
    """Rows of the points that hang together."""
    if not len(xyz):
        return []
    i, j = cKDTree(xyz).query_pairs(link, output_type="ndarray").T
    joined = coo_matrix((np.ones(len(i), np.int8), (i, j)), shape=(len(xyz),) * 2)
    label = connected_components(joined, directed=False)[1]
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
