"""Weighted sums of points by voxel: what many depth maps say about one place, in a form that can be added up.

Voxels have several sizes, each twice the one before: a point goes to the level that fits its sampling and its sigma, so
that distant, uncertain points do not fill the cloud. Sums of parts are the sums of the whole, in any order of parts.
Space is cut into cubic tiles, and a voxel is numbered within its tile: points and sums then take few bytes, and the
coordinates of any survey fit.
"""

from dataclasses import dataclass

import numpy as np

from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.results import Cloud
from tiegraph.scene.sorting import Columns, order_of, run_starts

TILE_VOXELS = 512  # edge of a tile in finest voxels: a wall through it has a quarter of a million points
_LEVELS = 6  # sizes of voxels, each twice the one before; with ten the largest is a whole tile
_BITS = 9  # of one coordinate of a voxel within its tile
_STEPS = 1 << 16  # places along the edge of a voxel that are told apart
_UNIT = 32767  # a normal's coordinate of 1

# One point of a depth map: number of its voxel within the tile, place within the voxel, colour, normal, sigma.
ROW = np.dtype(
    [("cell", "<u4"), ("place", "<u2", 3), ("rgb", "u1", 3), ("views", "u1"), ("normal", "<i2", 3), ("sigma", "<f4")]
)
# What a file holds of Voxels, column after column.
COLUMNS = ("<u4", "<f4", "(3,)<f4", "(3,)<f4", "(3,)<f4", "<f4", "u1")


@dataclass(frozen=True, eq=False)
class Voxels(Columns):
    """V voxels of one tile, in the order of their numbers: cell (V,) u4; weight (V,) f4; sums, weighted: place (V, 3)
    f4 from the voxel's corner in its sizes, rgb, normal (V, 3) f4 and sigma (V,) f4; views (V,) u1 the most."""

    cell: np.ndarray
    weight: np.ndarray
    place: np.ndarray
    rgb: np.ndarray
    normal: np.ndarray
    sigma: np.ndarray
    views: np.ndarray

    def cloud(self, tile: tuple[int, int, int], voxel: float, origin: Origin | None = None) -> Cloud:
        """The mean point of each voxel. Sigma is the mean of the points' sigmas: neighbouring pixels err together."""
        length = np.sqrt(np.square(self.normal) @ np.ones(3, np.float32))
        normal = self.normal / np.where(length > 0, length, np.float32(np.nan))[:, None]
        return Cloud(
            xyz_m=positions(self.cell, self.weight, self.place, tile, voxel),
            rgb=np.clip(np.rint(self.rgb / self.weight[:, None]), 0, 255).astype(np.uint8),
            normal=normal.astype(np.float32),
            sigma_m=self.sigma / self.weight,
            views=self.views,
            origin=origin,
        )


def positions(
    cell: np.ndarray, weight: np.ndarray, place: np.ndarray, tile: tuple[int, int, int], voxel: float
) -> np.ndarray:
    """(V, 3) f8 mean point of each voxel of a tile."""
    size = spacing(cell, voxel)
    xyz = np.empty((len(cell), 3))
    for k, index in enumerate(_indices(cell)):
        xyz[:, k] = tile[k] * (TILE_VOXELS * voxel) + (index + place[:, k] / weight) * size
    return xyz


def spacing(cell: np.ndarray, voxel: float) -> np.ndarray:
    """Edge (V,) of each voxel."""
    return np.ldexp(voxel, (cell >> np.uint32(3 * _BITS)).astype(np.int32))


def _indices(cell: np.ndarray) -> list[np.ndarray]:
    """Three columns (V,) u4: a voxel's place in its tile, counted in voxels of its level."""
    return [(cell >> np.uint32(shift * _BITS)) & np.uint32((1 << _BITS) - 1) for shift in (2, 1, 0)]


def rows_of(cloud: Cloud, justified: np.ndarray, voxel: float) -> tuple[np.ndarray, np.ndarray]:
    """The tile (3, M) i8 of each point and its ROW; justified (M,) is the distance between neighbouring points."""
    level = np.clip(np.rint(np.log2(np.maximum(justified / voxel, 1e-9))), 0, _LEVELS - 1).astype(np.int32)
    per_voxel = np.ldexp(1.0 / voxel, -level)
    down = (TILE_VOXELS.bit_length() - 1) - level
    rows = np.empty(len(cloud), ROW)
    tile = np.empty((3, len(cloud)), np.int64)
    number = level.astype(np.int64)
    for k in range(3):
        at = cloud.xyz_m[:, k] * per_voxel
        index = np.floor(at)
        rows["place"][:, k] = np.minimum((at - index) * _STEPS, _STEPS - 1)
        index = index.astype(np.int64)
        tile[k] = index >> down
        number = number << _BITS | (index - (tile[k] << down))
    rows["cell"], rows["rgb"], rows["views"], rows["sigma"] = number, cloud.rgb, cloud.views, cloud.sigma_m
    rows["normal"] = np.rint(np.nan_to_num(cloud.normal) * np.float32(_UNIT))
    return tile, rows


def sums(rows: np.ndarray, voxel: float) -> Voxels:
    """Points (M,) ROW of one tile added up by voxel."""
    order = order_of(rows["cell"])
    rows = np.take(rows, order)
    start = run_starts(rows["cell"])
    group = np.repeat(np.arange(len(start)), np.diff(start, append=len(rows)))
    sigma = rows["sigma"].astype(float)
    # Relative to the voxel, so that the weights of one part do not depend on its units.
    weight = 1.0 / np.square(np.maximum(sigma / voxel, 1e-6))

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(group, values * weight, len(start)).astype(np.float32)

    def totals(values: np.ndarray, unit: float, shift: float = 0.0) -> np.ndarray:
        return np.stack([total((values[:, k] + shift) / unit) for k in range(3)], axis=1)

    return Voxels(
        cell=rows["cell"][start],
        weight=np.bincount(group, weight, len(start)).astype(np.float32),
        place=totals(rows["place"], _STEPS, 0.5),
        rgb=totals(rows["rgb"], 1.0),
        normal=totals(rows["normal"], _UNIT),
        sigma=total(sigma),
        views=np.maximum.reduceat(rows["views"], start) if len(start) else rows["views"],
    )


def add_up(parts: list[Voxels]) -> Voxels:
    """One voxel a number, of several parts of one tile."""
    if len(parts) == 1:
        return parts[0]
    columns = [np.concatenate(values) for values in zip(*(p.__dict__.values() for p in parts), strict=True)]
    order = order_of(columns[0])
    cell = columns[0][order]
    start = run_starts(cell)
    added = [np.add.reduceat(values[order], start, axis=0) for values in columns[1:-1]]
    return Voxels(*(cell[start], *added, np.maximum.reduceat(columns[-1][order], start)))


def without_coarse_duplicates(voxels: Voxels) -> Voxels:
    """Leave out a coarse voxel in which a finer one lies: the finer knows the place better."""
    keep = np.ones(len(voxels), bool)
    border = np.searchsorted(voxels.cell, np.arange(_LEVELS + 1, dtype=np.uint64) << np.uint64(3 * _BITS))
    taken = np.zeros(0, np.uint32)  # voxels of the level that hold a finer one, sorted
    for level in range(_LEVELS):
        mine = voxels.cell[border[level] : border[level + 1]]
        if len(taken):
            at = np.minimum(np.searchsorted(taken, mine), len(taken) - 1)
            keep[border[level] : border[level + 1]] = taken[at] != mine
        held = np.concatenate([mine, taken])
        parents = np.full(len(held), level + 1, np.uint32)  # the voxels of the next level that hold them
        for index in _indices(held):
            parents = parents << np.uint32(_BITS) | index >> np.uint32(1)
        taken = np.sort(parents)
        taken = taken[run_starts(taken)]
    return voxels if keep.all() else voxels.where(keep)
