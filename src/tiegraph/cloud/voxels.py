"""Weighted sums of points by voxel: what many depth maps say about one place, in a form that can be added up.

Voxels have LEVELS sizes, each twice the one before: a point goes to the level that fits its sampling and its sigma, so
that distant, uncertain points do not fill the cloud. Sums of parts are the sums of the whole, in any order of parts.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.results import Cloud

LEVELS = 6


@dataclass(frozen=True, eq=False)
class Voxels:
    """V voxels: level (V,) u1; index (V, 3) i8 at that level; weight (V,) f8; sums, weighted (V, c) f8 of position
    (from the voxel's corner, in its sizes), colour, normal, sigma; views (V,) u1 the most."""

    level: np.ndarray
    index: np.ndarray
    weight: np.ndarray
    position: np.ndarray
    rgb: np.ndarray
    normal: np.ndarray
    sigma: np.ndarray
    views: np.ndarray

    def __len__(self) -> int:
        return len(self.weight)

    def where(self, mask: np.ndarray) -> Voxels:
        """The voxels of a boolean mask or index array."""
        return Voxels(*(getattr(self, f.name)[mask] for f in fields(self)))

    @staticmethod
    def concatenate(parts: list[Voxels]) -> Voxels:
        """All voxels of several parts, not yet added up."""
        return Voxels(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Voxels)))

    def cloud(self, voxel: float, origin: Origin | None = None) -> Cloud:
        """The mean point of each voxel. Sigma is the mean of the points' sigmas: neighbouring pixels err together."""
        weight = self.weight[:, None]
        size = voxel * 2.0 ** self.level[:, None].astype(float)
        normal = self.normal / np.maximum(np.linalg.norm(self.normal, axis=1, keepdims=True), 1e-30)
        normal = np.where(np.abs(self.normal).sum(axis=1, keepdims=True) > 0, normal, np.nan)
        return Cloud(
            xyz_m=(self.index + self.position / weight) * size,
            rgb=np.clip(np.rint(self.rgb / weight), 0, 255).astype(np.uint8),
            normal=normal.astype(np.float32),
            sigma_m=(self.sigma[:, 0] / self.weight).astype(np.float32),
            views=self.views,
            origin=origin,
        )

    def spacing(self, voxel: float) -> np.ndarray:
        """Edge (V,) of each voxel."""
        return voxel * 2.0 ** self.level.astype(float)


def voxels_of(cloud: Cloud, spacing: np.ndarray, voxel: float) -> Voxels:
    """Points as voxels, added up; spacing (M,) is the distance between neighbouring points that is justified."""
    level = np.clip(np.rint(np.log2(np.maximum(spacing / voxel, 1e-9))), 0, LEVELS - 1).astype(np.uint8)
    cell = cloud.xyz_m / (voxel * 2.0 ** level[:, None].astype(float))
    index = np.floor(cell).astype(np.int64)
    # Relative to the voxel, so that the weights of one part do not depend on its units.
    weight = 1.0 / np.square(np.maximum(cloud.sigma_m.astype(float) / voxel, 1e-6))
    normal = np.nan_to_num(cloud.normal.astype(float))
    column = weight[:, None]
    return add_up(
        Voxels(
            level,
            index,
            weight,
            (cell - index) * column,
            cloud.rgb * column,
            normal * column,
            cloud.sigma_m[:, None] * column,
            cloud.views,
        )
    )


def add_up(voxels: Voxels) -> Voxels:
    """One row a voxel, sorted by level and index."""
    if len(voxels) == 0:
        return voxels
    keys = row_numbers(np.column_stack([voxels.level.astype(np.int64), voxels.index]))
    order = np.argsort(keys, kind="stable")
    level, index = voxels.level[order], voxels.index[order]
    start = np.flatnonzero(np.r_[True, np.diff(keys[order]) != 0])

    def total(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values[order], start, axis=0)

    return Voxels(
        level[start],
        index[start],
        total(voxels.weight),
        total(voxels.position),
        total(voxels.rgb),
        total(voxels.normal),
        total(voxels.sigma),
        np.maximum.reduceat(voxels.views[order], start),
    )


def row_numbers(rows: np.ndarray) -> np.ndarray:
    """(V,) i8: one number for each distinct row (V, c) of integers, in the order of the rows."""
    low = rows.min(axis=0)
    span = rows.max(axis=0) - low + 1
    if np.prod(span.astype(float)) >= 2.0**62:  # does not fit one integer: number the rows that occur
        return np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    number = np.zeros(len(rows), np.int64)
    for k, width in enumerate(span):
        number = number * width + (rows[:, k] - low[k])
    return number


def without_coarse_duplicates(voxels: Voxels) -> Voxels:
    """Leave out a coarse voxel in which a finer one lies: the finer knows the place better."""
    keep = np.ones(len(voxels), bool)
    for level in range(1, LEVELS):
        mine = np.flatnonzero(voxels.level == level)
        finer = voxels.level < level
        if len(mine) == 0 or not finer.any():
            continue
        up = (level - voxels.level[finer]).astype(np.int64)
        parents = voxels.index[finer] >> up[:, None]
        number = row_numbers(np.concatenate([parents, voxels.index[mine]]))
        keep[mine] = ~np.isin(number[len(parents) :], number[: len(parents)])
    return voxels.where(keep)
