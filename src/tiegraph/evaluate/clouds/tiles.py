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


@dataclass(frozen=True)
class _Rows:
    """Rows (N, 4) x, y, z, sigma in a file; read and not mapped, for mapped pages count as memory of the process."""

    path: Path

    def parts(self, begin: int = 0, end: int | None = None) -> Iterator[np.ndarray]:
        """Rows from ``begin`` to ``end`` (None: the last), part by part."""
        last = self.path.stat().st_size // _ROW if end is None else end
        for start in range(begin, last, _PART):
            count = min(_PART, last - start)
            yield np.fromfile(self.path, np.float64, 4 * count, offset=_ROW * start).reshape(-1, 4)


@dataclass(frozen=True)
class _Laid:
    """The rows of a cloud sorted by tile; those of tile t begin at ``start[t]``."""

    rows: _Rows
    start: np.ndarray

    def own(self, tile: int) -> np.ndarray:
        return np.concatenate([np.zeros((0, 4)), *self.parts(tile)])

    def parts(self, tile: int) -> Iterator[np.ndarray]:
        return self.rows.parts(int(self.start[tile]), int(self.start[tile + 1]))


@dataclass(frozen=True)
class TiledClouds:
    """Two clouds (0, 1) by tiles; ``bounds`` (T, 4) of the tiles: low x, low y, high x, high y."""

    laid: tuple[_Laid, _Laid]
    bounds: np.ndarray
    low: tuple[np.ndarray, np.ndarray]  # corners (3,) of each
    high: tuple[np.ndarray, np.ndarray]
    spacing_m: tuple[float, float]  # median distance to the nearest of the same cloud

    def __len__(self) -> int:
        return len(self.bounds)

    def exchanged(self) -> "TiledClouds":
        """The same with cloud 1 as cloud 0."""
        (a, b), (low_a, low_b), (high_a, high_b), (one, two) = self.laid, self.low, self.high, self.spacing_m
        return TiledClouds(
            laid=(b, a), bounds=self.bounds, low=(low_b, low_a), high=(high_b, high_a), spacing_m=(two, one)
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
            for part in self.laid[which].parts(int(other)) if other != tile else ():
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
    extents = [_copied(source, file) for source, file in zip((first, second), files)]
    low, high = [e[0] for e in extents], [e[1] for e in extents]
    grid = _grid(np.minimum(*low), np.maximum(*high))
    flat = [_Rows(file) for file in files]
    counts = sum((_counts(rows, grid) for rows in flat), np.zeros(grid.shape, np.int64))
    boxes = list(_split(counts, (0, 0, *grid.shape), tuning.tile_points))
    tile_of = np.zeros(grid.shape, np.int64)
    for k, (x, y, to_x, to_y) in enumerate(boxes):
        tile_of[x:to_x, y:to_y] = k
    laid = [_sorted(rows, grid, tile_of.ravel(), len(boxes)) for rows in flat]
    bounds = np.tile(grid.low, 2) + np.array(boxes, float) * grid.edge
    spacing = [_spacing(one, tuning) for one in laid]
    return TiledClouds(
        laid=(laid[0], laid[1]),
        bounds=bounds,
        low=(low[0], low[1]),
        high=(high[0], high[1]),
        spacing_m=(spacing[0], spacing[1]),
    )


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


def _counts(rows: _Rows, grid: _Grid) -> np.ndarray:
    out = np.zeros(grid.shape[0] * grid.shape[1], np.int64)
    for part in rows.parts():
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


def _sorted(rows: _Rows, grid: _Grid, tile_of: np.ndarray, tiles: int) -> _Laid:
    """The rows in a file sorted by tile; the other file goes."""
    size = np.zeros(tiles, np.int64)
    for part in rows.parts():
        size += np.bincount(tile_of[grid.cells(part)], minlength=tiles)
    start = np.r_[0, np.cumsum(size)]
    filled, target = start[:-1].copy(), rows.path.with_suffix(".tiles")
    with open(target, "wb") as out:
        for part in rows.parts():
            tile = tile_of[grid.cells(part)]
            order = order_of(tile)
            count = np.bincount(tile, minlength=tiles)
            at = np.cumsum(count) - count
            for t in np.flatnonzero(count):
                out.seek(_ROW * int(filled[t]))
                out.write(part[order[at[t] : at[t] + count[t]]].tobytes())
            filled += count
    rows.path.unlink()
    return _Laid(_Rows(target), start)


def _spacing(laid: _Laid, tuning: CloudTuning) -> float:
    """Median distance of points to the nearest of their cloud, in the fullest tile."""
    full = laid.own(int(np.argmax(np.diff(laid.start))))[:, :3]
    if len(full) < 2:
        return float("nan")
    some = full[:: -(-len(full) // tuning.spacing_points)]
    tree = cKDTree(full, balanced_tree=False, compact_nodes=False)  # few are asked: made in a third of the time
    return float(np.median(tree.query(some, k=2)[0][:, 1]))
