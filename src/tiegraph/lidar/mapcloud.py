"""The map: one point a voxel, the mean of all points in it, in bounded memory."""

import numpy as np

from tiegraph.lidar.tuning import MapTuning
from tiegraph.scene.results import Cloud

_SPAN = 1 << 20  # cells to both sides of the first scan that a key has room for
_GREY, _MOST_VIEWS = 128, 255


class MapCloud:
    """Points are added scan by scan, and merged from time to time; the voxel grows where they become too many."""

    def __init__(self, voxel_m: float, tuning: MapTuning) -> None:
        self.voxel_m, self._tuning = voxel_m, tuning
        self._keys = np.zeros(0, np.int64)
        self._sums: np.ndarray = np.zeros((0, 4))  # x, y, z, number
        self._waiting: list[np.ndarray] = []
        self._count = 0

    def add(self, xyz: np.ndarray) -> None:
        """Points (N, 3) in the world."""
        self._waiting.append(np.column_stack([xyz, np.ones(len(xyz))]))
        self._count += len(xyz)
        if self._count > self._tuning.batch_points:
            self._merge()

    def cloud(self) -> Cloud:
        """The map, sorted by voxel; ``views``: points behind each, 255 at most."""
        self._merge()
        number = self._sums[:, 3:]
        missing = np.full((len(number), 3), np.nan, np.float32)
        return Cloud(
            xyz_m=self._sums[:, :3] / np.maximum(number, 1),
            rgb=np.full((len(number), 3), _GREY, np.uint8),
            normal=missing,
            sigma_m=missing[:, 0],
            views=np.minimum(number[:, 0], _MOST_VIEWS).astype(np.uint8),
        )

    def _merge(self) -> None:
        rows = np.concatenate([self._sums, *self._waiting])
        self._waiting, self._count = [], 0
        self._gather(rows)
        while len(self._keys) > self._tuning.most_points:
            self.voxel_m *= self._tuning.growth
            self._gather(self._sums)

    def _gather(self, rows: np.ndarray) -> None:
        cell = np.floor(rows[:, :3] / np.maximum(rows[:, 3:], 1) / self.voxel_m).astype(np.int64)
        cell = np.clip(cell, -_SPAN, _SPAN - 1) + _SPAN
        key = (cell[:, 0] * 2 * _SPAN + cell[:, 1]) * 2 * _SPAN + cell[:, 2]
        self._keys, group = np.unique(key, return_inverse=True)
        columns = [np.bincount(group, rows[:, k], len(self._keys)) for k in range(4)]
        self._sums = np.stack(columns, axis=1)
