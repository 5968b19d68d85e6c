"""Two clouds in files, cut across the longer side of the survey into tiles of a bounded number of points, each read
with a halo."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.evaluate.tuning import CloudTuning
from tiegraph.scene.cloudchunks import Points, PointSource

_PART = 1_000_000  # points moved at once
_ROW = 32  # bytes: x, y, z, sigma
_CELLS = 4096  # along the longer side, of which tiles are made


@dataclass(frozen=True)
class TiledClouds:
    """Two clouds (0, 1) by tiles: a file of each for either; ``bounds`` (T, 2) of the tiles along ``axis``."""

    files: list[list[Path]]
    axis: int
    bounds: np.ndarray
    low: np.ndarray  # (2, 3) corners of each
    high: np.ndarray
    spacing_m: np.ndarray  # (2,) median distance to the nearest of the same cloud

    def __len__(self) -> int:
        return len(self.bounds)

    def exchanged(self) -> "TiledClouds":
        """The same with cloud 1 as cloud 0."""
        turned = {"low": self.low[::-1], "high": self.high[::-1], "spacing_m": self.spacing_m[::-1]}
        return replace(self, files=self.files[::-1], **turned)

    def count(self, which: int) -> int:
        """Points of a cloud."""
        return sum(file.stat().st_size for file in self.files[which]) // _ROW

    def own(self, which: int, tile: int) -> Points:
        """The points of a cloud in a tile."""
        return _points([*_rows(self.files[which][tile])])

    def halo(self, which: int, tile: int, reach: float) -> Points:
        """The points of a cloud outside a tile, within ``reach`` of it."""
        reach = reach * (1 + 1e-9) + 1e-9
        low, high = self.bounds[tile, 0] - reach, self.bounds[tile, 1] + reach
        near = np.flatnonzero((self.bounds[:, 0] <= high) & (self.bounds[:, 1] >= low))
        parts = (part for other in near if other != tile for part in _rows(self.files[which][other]))
        return _points([p[(p[:, self.axis] >= low) & (p[:, self.axis] <= high)] for p in parts])

    def around(self, which: int, tile: int, reach: float) -> Points:
        """The points of a cloud in a tile, then those of its halo."""
        own, halo = self.own(which, tile), self.halo(which, tile, reach)
        return Points(np.concatenate([own.xyz, halo.xyz]), np.concatenate([own.sigma, halo.sigma]))


def tile_clouds(first: PointSource, second: PointSource, scratch: Path, tuning: CloudTuning) -> TiledClouds:
    """Lay two clouds into files of the folder ``scratch``: 32 bytes a point, twice that while they are sorted.

    Memory is that of a part, and later of one tile and its halo: a tile holds about ``tuning.tile_points`` of both
    clouds, unless more stand above one cell of the survey's length. Raises InputError as ``open_cloud``.
    """
    copies = [scratch / "first.points", scratch / "second.points"]
    corners = np.array([_copied(source, file) for source, file in zip((first, second), copies)])
    low, high = corners[:, 0], corners[:, 1]
    begin, size = low.min(axis=0), high.max(axis=0) - low.min(axis=0)
    axis = int(size[1] > size[0])
    edge = max(float(size[axis]), 1e-9) / _CELLS

    def cells(rows: np.ndarray) -> np.ndarray:
        return np.minimum(((rows[:, axis] - begin[axis]) / edge).astype(np.int64), _CELLS - 1)

    count = sum(np.bincount(cells(part), minlength=_CELLS) for file in copies for part in _rows(file))
    tile_of = np.unique(np.maximum(np.cumsum(count) - 1, 0) // tuning.tile_points, return_inverse=True)[1].ravel()
    tiles = np.arange(tile_of[-1] + 1)
    bounds = [np.searchsorted(tile_of, tiles, side=side) for side in ("left", "right")]
    files = [[copy.with_suffix(f".{t}") for t in tiles] for copy in copies]
    for copy, own in zip(copies, files):
        for file in own:
            file.write_bytes(b"")
        for part in _rows(copy):
            tile = tile_of[cells(part)]
            for t in np.unique(tile):
                with own[t].open("ab") as out:
                    out.write(part[tile == t].tobytes())
        copy.unlink()
    return TiledClouds(
        files=files,
        axis=axis,
        bounds=begin[axis] + edge * np.stack(bounds, axis=1),
        low=low,
        high=high,
        spacing_m=np.array([_spacing(own) for own in files]),
    )


def _rows(path: Path) -> Iterator[np.ndarray]:
    """Rows (N, 4) x, y, z, sigma of a file, part by part; not mapped, which would count as memory of the process."""
    for start in range(0, path.stat().st_size // _ROW, _PART):
        yield np.fromfile(path, np.float64, 4 * _PART, offset=_ROW * start).reshape(-1, 4)


def _points(rows: list[np.ndarray]) -> Points:
    joined = np.concatenate([np.zeros((0, 4)), *rows])
    return Points(joined[:, :3].copy(), joined[:, 3].copy())


def _copied(source: PointSource, file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Write a cloud's rows; its corners (3,)."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    with open(file, "wb") as out:
        for part in source.parts():
            if len(part):
                low, high = np.minimum(low, part.xyz.min(axis=0)), np.maximum(high, part.xyz.max(axis=0))
            out.write(np.column_stack([part.xyz, part.sigma]).astype(np.float64).tobytes())
    return low, high


def _spacing(files: list[Path]) -> float:
    """Median distance to the nearest point, of some points of the fullest tile; NaN of a single point."""
    full = _points([*_rows(max(files, key=lambda file: file.stat().st_size))]).xyz
    if len(full) < 2:
        return float("nan")
    some = full[:: -(-len(full) // 5000)]
    tree = cKDTree(full, balanced_tree=False, compact_nodes=False)  # few are asked: made in a third of the time
    return float(np.median(tree.query(some, k=2)[0][:, 1]))
