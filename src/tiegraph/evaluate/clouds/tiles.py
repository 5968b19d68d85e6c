"""Two clouds in files, cut in plan into tiles of a bounded number of points, each read with a halo."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.evaluate.tuning import CloudTuning
from tiegraph.scene.cloudchunks import Points, PointSource
from tiegraph.scene.sorting import order_of

_PART = 1_000_000  # points moved at once
_ROW = 32  # bytes
_CELLS = 1024  # along the longer side, of which tiles are made: 8 MB a count


@dataclass(frozen=True)
class _Grid:
    """Cells in plan: their low corner (2,), edge, and how many there are in x and y."""

    low: np.ndarray
    edge: float
    shape: tuple[int, int]

    def cells(self, xyz: np.ndarray) -> np.ndarray:
        """(N,) number of the cell of each point."""
        at = np.floor((xyz[:, :2] - self.low) / self.edge).astype(np.int64)
        at = np.clip(at, 0, np.array(self.shape) - 1)
        return np.asarray(at[:, 0] * self.shape[1] + at[:, 1])


def _rows(path: Path, begin: int = 0, end: int | None = None) -> Iterator[np.ndarray]:
    """Rows (N, 4) x, y, z, sigma of a file from ``begin`` to ``end`` (None: the last), part by part; read and not
    mapped, for mapped pages count as memory of the process."""
    last = path.stat().st_size // _ROW if end is None else end
    for start in range(begin, last, _PART):
        count = min(_PART, last - start)
        yield np.fromfile(path, np.float64, 4 * count, offset=_ROW * start).reshape(-1, 4)


@dataclass(frozen=True)
class _Laid:
    """The rows of a cloud sorted by tile in a file; those of tile t begin at ``start[t]``."""

    path: Path
    start: np.ndarray

    def rows(self, tile: int) -> Iterator[np.ndarray]:
        return _rows(self.path, int(self.start[tile]), int(self.start[tile + 1]))

    def own(self, tile: int) -> np.ndarray:
        return np.concatenate([np.zeros((0, 4)), *self.rows(tile)])


@dataclass(frozen=True)
class TiledClouds:
    """Two clouds (0, 1) by tiles; ``bounds`` (T, 4) of the tiles: low x, low y, high x, high y."""

    laid: list[_Laid]
    bounds: np.ndarray
    low: np.ndarray  # (2, 3) corners of each
    high: np.ndarray
    spacing_m: np.ndarray  # (2,) median distance to the nearest of the same cloud

    def __len__(self) -> int:
        return len(self.bounds)

    def exchanged(self) -> "TiledClouds":
        """The same with cloud 1 as cloud 0."""
        return TiledClouds(
            laid=self.laid[::-1],
            bounds=self.bounds,
            low=self.low[::-1],
            high=self.high[::-1],
            spacing_m=self.spacing_m[::-1],
        )

    def count(self, which: int) -> int:
        """Points of a cloud."""
        return int(self.laid[which].start[-1])

    def own(self, which: int, tile: int) -> Points:
        """The points of a cloud in a tile."""
        return _points(self.laid[which].own(tile))

    def halo(self, which: int, tile: int, reach: float) -> Points:
        """The points of a cloud outside a tile, within ``reach`` of it in plan."""
        reach = reach * (1 + 1e-9) + 1e-9
        low, high = self.bounds[tile, :2] - reach, self.bounds[tile, 2:] + reach
        near = (self.bounds[:, :2] <= high).all(axis=1) & (self.bounds[:, 2:] >= low).all(axis=1)
        found = [np.zeros((0, 4))]
        for other in np.flatnonzero(near):
            for part in self.laid[which].rows(int(other)) if other != tile else ():
                found.append(part[((part[:, :2] >= low) & (part[:, :2] <= high)).all(axis=1)])
        return _points(np.concatenate(found))

    def around(self, which: int, tile: int, reach: float) -> Points:
        """The points of a cloud in a tile, then those of its halo."""
        own, halo = self.own(which, tile), self.halo(which, tile, reach)
        return Points(np.concatenate([own.xyz, halo.xyz]), np.concatenate([own.sigma, halo.sigma]))


def _points(rows: np.ndarray) -> Points:
    return Points(rows[:, :3].copy(), rows[:, 3].copy())


def tile_clouds(first: PointSource, second: PointSource, scratch: Path, tuning: CloudTuning) -> TiledClouds:
    """Lay two clouds into files of the folder ``scratch``: 32 bytes a point, twice that while they are sorted.

    Memory is that of a part, and later of one tile and its halo: a tile holds ``tuning.tile_points`` of both clouds at
    most, unless they stand above one cell of a thousandth of the survey's extent. Raises InputError for clouds
    that cannot be read (``open_cloud``).
    """
    files = [scratch / "first.points", scratch / "second.points"]
    corners = np.array([_copied(source, file) for source, file in zip((first, second), files)])
    low, high = corners[:, 0], corners[:, 1]
    grid = _grid(low.min(axis=0), high.max(axis=0))
    counts = sum((_counts(file, grid) for file in files), np.zeros(grid.shape, np.int64))
    boxes = list(_split(counts, (0, 0, *grid.shape), tuning.tile_points))
    tile_of = np.zeros(grid.shape, np.int64)
    for k, (x, y, to_x, to_y) in enumerate(boxes):
        tile_of[x:to_x, y:to_y] = k
    laid = [_sorted(file, grid, tile_of.ravel(), len(boxes)) for file in files]
    bounds = np.tile(grid.low, 2) + np.array(boxes, float) * grid.edge
    spacing = np.array([_spacing(one, tuning) for one in laid])
    return TiledClouds(laid=laid, bounds=bounds, low=low, high=high, spacing_m=spacing)


def _copied(source: PointSource, file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Write a cloud's rows; its corners (3,)."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    with open(file, "wb") as out:
        for part in source.parts():
            if len(part):
                low, high = np.minimum(low, part.xyz.min(axis=0)), np.maximum(high, part.xyz.max(axis=0))
            out.write(np.column_stack([part.xyz, part.sigma]).astype(np.float64).tobytes())
    return low, high


def _grid(low: np.ndarray, high: np.ndarray) -> _Grid:
    extent = (high - low)[:2]
    edge = max(float(extent.max()) / _CELLS * (1 + 1e-9), 1e-9)
    return _Grid(low[:2], edge, (int(extent[0] / edge) + 1, int(extent[1] / edge) + 1))


def _counts(file: Path, grid: _Grid) -> np.ndarray:
    out = np.zeros(grid.shape[0] * grid.shape[1], np.int64)
    for part in _rows(file):
        out += np.bincount(grid.cells(part), minlength=len(out))
    return out.reshape(grid.shape)


def _split(counts: np.ndarray, box: tuple[int, ...], most: int) -> Iterator[tuple[int, int, int, int]]:
    """Boxes (x, y, to x, to y) of cells with at most so many points, or of one cell; none without points."""
    inside = counts[box[0] : box[2], box[1] : box[3]]
    total = int(inside.sum())
    if total <= most or inside.size == 1:
        if total:
            yield box[0], box[1], box[2], box[3]
        return
    axis = int(inside.shape[1] > inside.shape[0])
    along = np.cumsum(inside.sum(axis=1 - axis))
    at = box[axis] + min(int(np.searchsorted(along, total / 2)) + 1, inside.shape[axis] - 1)
    for part in ((*box[: 2 + axis], at, *box[3 + axis :]), (*box[:axis], at, *box[axis + 1 :])):
        yield from _split(counts, part, most)


def _sorted(file: Path, grid: _Grid, tile_of: np.ndarray, tiles: int) -> _Laid:
    """The rows in a file sorted by tile; the other file goes."""
    size = np.zeros(tiles, np.int64)
    for part in _rows(file):
        size += np.bincount(tile_of[grid.cells(part)], minlength=tiles)
    start = np.r_[0, np.cumsum(size)]
    filled, target = start[:-1].copy(), file.with_suffix(".tiles")
    with open(target, "wb") as out:
        for part in _rows(file):
            tile = tile_of[grid.cells(part)]
            order = order_of(tile)
            count = np.bincount(tile, minlength=tiles)
            at = np.cumsum(count) - count
            for t in np.flatnonzero(count):
                out.seek(_ROW * int(filled[t]))
                out.write(part[order[at[t] : at[t] + count[t]]].tobytes())
            filled += count
    file.unlink()
    return _Laid(target, start)


def _spacing(laid: _Laid, tuning: CloudTuning) -> float:
    """Median distance of points to the nearest of their cloud, in the fullest tile."""
    full = laid.own(int(np.argmax(np.diff(laid.start))))[:, :3]
    if len(full) < 2:
        return float("nan")
    some = full[:: -(-len(full) // tuning.spacing_points)]
    tree = cKDTree(full, balanced_tree=False, compact_nodes=False)  # few are asked: made in a third of the time
    return float(np.median(tree.query(some, k=2)[0][:, 1]))
