"""Depth maps to one cloud, tile by tile: memory is bounded by a tile, whatever the size of the survey.

Steps, each over independent items through one function ``run`` (serial or a pool): depth map -> its points by tile (a
file); tile -> points added up by voxel; tile -> outliers removed, with its neighbours' margins. The first two go over
some hundred depth maps at a time, which bounds the files.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.cloud import voxels
from tiegraph.cloud.settings import CloudSettings
from tiegraph.cloud.tuning import Tuning
from tiegraph.errors import ReconstructionError
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import invert
from tiegraph.scene.atomic import replacing
from tiegraph.scene.results import Cloud, DepthMap, row_strips
from tiegraph.scene.sorting import order_of, row_numbers, run_starts

Tile = tuple[int, int, int]
MapPoints = tuple[Cloud, np.ndarray, int]  # world points, the spacing (M,) each justifies, number left out
Run = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]  # map over items, results in their order

_MERGE_ROWS = 2_000_000  # points read before they are added up: about 0.3 GB
_POINTS_AT_ONCE = 400_000_000  # that lie in files before they are added up: 10 GB, and ...
_MAPS_AT_ONCE = 60  # ... what so many depth maps more may have
_ASKED_AT_ONCE = 200_000  # points whose neighbours are: bounds the memory of the neighbour table
_PIXELS = 1 << 20  # of a depth map that are made points together: about 0.2 GB


@dataclass(frozen=True)
class Maps:
    """Where depth maps (None = no map) and the colours (H, W, 3) u1 RGB of their images come from, by image name;
    without colours points are black."""

    depth: Callable[[str], DepthMap | None]
    colours: Callable[[str], np.ndarray] | None = None


@dataclass(frozen=True)
class FusionResult:
    """The cloud as tile files, the voxel edge, and counts for the receipt."""

    tiles: tuple[tuple[Tile, Path], ...]
    voxel: float
    counts: dict[str, int]
    origin: Origin | None

    def clouds(self) -> Iterator[Cloud]:
        """The cloud tile by tile."""
        for tile, path in self.tiles:
            yield _load(path).cloud(tile, self.voxel, self.origin)

    def cloud(self) -> Cloud:
        """The whole cloud in memory."""
        parts = list(self.clouds())
        return Cloud.concatenate(parts) if parts else Cloud.empty(self.origin)


@dataclass(frozen=True)
class _Scattered:
    """Which rows of the file of a depth map lie in which tile: (tile, first row, number); pixels and uncertain ones."""

    parts: tuple[tuple[Tile, int, int], ...] = ()
    pixels: int = 0
    uncertain: int = 0


def fuse(
    names: Sequence[str],
    maps: Maps,
    scratch: Path,
    settings: CloudSettings,
    tuning: Tuning,
    origin: Origin | None = None,
    run: Run = map,
) -> FusionResult:
    """Fuse the depth maps of ``names`` (``maps`` must be picklable if ``run`` uses processes). ``scratch`` is an empty
    folder for tile files, the result among them. Raises ReconstructionError if no depth map has a point."""
    voxel = settings.voxel_size or automatic_voxel(names, maps.depth, tuning.sampled_maps, run)
    settings = settings.model_copy(update={"voxel_size": voxel})
    fused = fuse_points(names, partial(_points_of_map, maps=maps, settings=settings), scratch, settings, tuning, run)
    if fused is None:
        raise ReconstructionError(
            "no depth map has a point that enough images agree on: lower --dense.min-views, "
            "raise --dense.tolerance-px, or look at the poses in the report"
        )
    return replace(fused, origin=origin)


def fuse_points(
    names: Sequence[str],
    points: Callable[[str], Iterable[MapPoints]],
    scratch: Path,
    settings: CloudSettings,
    tuning: Tuning,
    run: Run = map,
) -> FusionResult | None:
    """Fuse the points of ``names``, of depth maps or clouds, in parts each; None if there are none. As ``fuse``;
    ``settings`` say the size of the voxels."""
    voxel = settings.voxel_size
    scatter = partial(_scatter_one, points=points, scratch=scratch, voxel=voxel)
    scattered: list[_Scattered] = []
    merged: dict[Tile, int] = {}
    waiting: dict[int, _Scattered] = {}
    for begin in range(0, len(names), _MAPS_AT_ONCE):
        numbered = list(enumerate(names))[begin : begin + _MAPS_AT_ONCE]
        found = list(run(scatter, numbered))
        scattered += found
        waiting |= dict(zip([k for k, _ in numbered], found, strict=True))
        if len(scattered) == len(names) or sum(s.pixels for s in waiting.values()) > _POINTS_AT_ONCE:
            merged |= _merge(waiting, scratch, voxel, run)
            waiting = {}
    if not merged:
        return None
    tiles = sorted(merged)
    keep = partial(_filter_one, scratch=scratch, voxel=voxel, settings=settings, tuning=tuning)
    filtered = list(run(keep, tiles))
    counts = {
        "pixels": sum(s.pixels for s in scattered),
        "uncertain": sum(s.uncertain for s in scattered),
        "merged": sum(merged.values()),
        "statistical": sum(s for _, s, _ in filtered),
        "radius": sum(r for _, _, r in filtered),
        "points": sum(n for n, _, _ in filtered),
    }
    files = ((tile, _tile_path(scratch, tile, "final")) for tile, (n, _, _) in zip(tiles, filtered, strict=True) if n)
    return FusionResult(tiles=tuple(files), voxel=voxel, counts=counts, origin=None)


def map_points(depth: DepthMap, rgb: np.ndarray, settings: CloudSettings, rows: slice) -> MapPoints:
    """World points of some rows of a depth map, the spacing (M,) each justifies, and the number left out as too
    uncertain."""
    depth_m, sigma_m = depth.depth_m[rows], depth.sigma_m[rows]
    known = np.isfinite(depth_m)
    sure = known & (sigma_m <= settings.max_relative_sigma * np.where(known, depth_m, 1))
    at = np.flatnonzero(sure)
    z, sigma = (values.ravel()[at] for values in (depth_m, sigma_m))
    world_from_cam = invert(depth.cam_from_world)
    ray = world_from_cam[:3, :3] @ np.linalg.inv(depth.K)
    row, column = np.divmod(at, known.shape[1])
    xyz = np.empty((len(at), 3))
    for k in range(3):
        across = (column + 0.5) * ray[k, 0] + (row + (rows.start + 0.5)) * ray[k, 1] + ray[k, 2]
        xyz[:, k] = across * z + world_from_cam[k, 3]
    normal = np.full((len(at), 3), np.nan, np.float32)
    if depth.normal is not None:
        normal = np.take(depth.normal[rows].reshape(-1, 3), at, axis=0) @ world_from_cam[:3, :3].T.astype(np.float32)
    cloud = Cloud(
        xyz_m=xyz,
        rgb=np.take(rgb[rows].reshape(-1, 3), at, axis=0),
        normal=normal,
        sigma_m=sigma,
        views=depth.views[rows].ravel()[at],
    )
    justified = np.maximum(z.astype(float) / _focal(depth), sigma)
    return cloud, justified, int(np.count_nonzero(known & ~sure))


def automatic_voxel(
    names: Sequence[str], depth: Callable[[str], DepthMap | None], sampled_maps: int, run: Run = map
) -> float:
    """Median size of a pixel on the object over some depth maps: the spacing at which the images sample it.

    Raises ReconstructionError if no depth map has a depth.
    """
    step = -(-len(names) // sampled_maps) if names else 1
    sizes = [s for s in run(partial(_sampling, depth=depth), list(names[::step])) if s is not None]
    if not sizes:
        raise ReconstructionError(
            "all depth maps are empty: lower --dense.min-views or raise --dense.tolerance-px, and look at the masks"
        )
    size, count = np.array(sizes).T
    order = np.argsort(size)
    half = np.searchsorted(np.cumsum(count[order]), count.sum() / 2)
    return float(f"{size[order][half]:.3g}")


def _sampling(name: str, depth: Callable[[str], DepthMap | None]) -> tuple[float, int] | None:
    found = depth(name)
    if found is None:
        return None
    known = found.depth_m[np.isfinite(found.depth_m)]
    return (float(np.median(known)) / _focal(found), len(known)) if len(known) else None


def _focal(depth: DepthMap) -> float:
    return float(np.sqrt(depth.K[0, 0] * depth.K[1, 1]))


def _points_of_map(name: str, maps: Maps, settings: CloudSettings) -> Iterator[MapPoints]:
    depth = maps.depth(name)
    if depth is None:
        return
    rgb = np.zeros((*depth.depth_m.shape, 3), np.uint8) if maps.colours is None else maps.colours(name)
    for rows in row_strips(depth.depth_m.shape, _PIXELS):
        yield map_points(depth, rgb, settings, rows)


def _scatter_one(
    item: tuple[int, str], points: Callable[[str], Iterable[MapPoints]], scratch: Path, voxel: float
) -> _Scattered:
    """Write the points of one depth map or cloud, each part of them sorted by tile."""
    number, name = item
    parts: list[tuple[Tile, int, int]] = []
    written, left_out = 0, 0
    with replacing(_map_path(scratch, number)) as temporary, open(temporary, "wb") as file:
        for cloud, justified, uncertain in points(name):
            left_out += uncertain
            if len(cloud) == 0:
                continue
            tile, rows = voxels.rows_of(cloud, justified, voxel)
            numbers = row_numbers(tile)
            order = order_of(numbers)
            np.take(rows, order).tofile(file)
            start = run_starts(numbers[order])
            count = np.diff(start, append=len(order))
            for (x, y, z), s, n in zip(tile[:, order[start]].T, start, count, strict=True):
                parts.append(((int(x), int(y), int(z)), written + int(s), int(n)))
            written += len(cloud)
    return _Scattered(tuple(parts), written, left_out)


def _merge(scattered: dict[int, _Scattered], scratch: Path, voxel: float, run: Run) -> dict[Tile, int]:
    """Add up the points of some depth maps, by their numbers: the number of voxels of the tiles they touch."""
    parts: dict[Tile, list[tuple[int, int, int]]] = {}
    for number, found in scattered.items():
        for tile, start, count in found.parts:
            parts.setdefault(tile, []).append((number, start, count))
    tiles = sorted(parts)
    merge = partial(_merge_one, scratch=scratch, voxel=voxel)
    sizes = list(run(merge, [(tile, parts[tile]) for tile in tiles]))
    for number in scattered:
        _map_path(scratch, number).unlink(missing_ok=True)
    return dict(zip(tiles, sizes, strict=True))


def _merge_one(item: tuple[Tile, list[tuple[int, int, int]]], scratch: Path, voxel: float) -> int:
    """Add up the points of one tile, and what earlier depth maps left of it: the number of voxels."""
    tile, parts = item
    path = _tile_path(scratch, tile, "merged")
    added = [_load(path)] if path.exists() else []
    held: list[np.ndarray] = []
    for k, (number, start, count) in enumerate(parts, 1):
        held.append(np.fromfile(_map_path(scratch, number), voxels.ROW, count, offset=start * voxels.ROW.itemsize))
        if k == len(parts) or sum(len(h) for h in held) > _MERGE_ROWS:
            added = [voxels.add_up([*added, voxels.sums(np.concatenate(held), voxel)])]
            held = []
    merged = voxels.without_coarse_duplicates(added[0])
    _save(path, merged)
    return len(merged)


def _filter_one(
    tile: Tile, scratch: Path, voxel: float, settings: CloudSettings, tuning: Tuning
) -> tuple[int, int, int]:
    """Filter one merged tile among its neighbours: (points kept, dropped by the statistical, by the radius filter)."""
    merged = _load(_tile_path(scratch, tile, "merged"))
    if not settings.filtered:
        _save(_tile_path(scratch, tile, "final"), merged)
        return len(merged), 0, 0
    justified = voxels.spacing(merged.cell, voxel)
    around = _margin(tile, scratch, voxel, tuning.radius_voxels * float(justified.max()))
    xyz = voxels.positions(merged.cell, merged.weight, merged.place, tile, voxel)
    keep, statistical, radius = filter_points(xyz, justified, settings, tuning, around)
    kept = merged.where(keep)
    _save(_tile_path(scratch, tile, "final"), kept)
    return len(kept), statistical, radius


def _margin(tile: Tile, scratch: Path, voxel: float, reach: float) -> np.ndarray:
    """Points (K, 3) of the neighbouring tiles within ``reach`` of the tile."""
    reach = min(reach, voxels.TILE_VOXELS / 4 * voxel)
    low = np.array(tile) * voxels.TILE_VOXELS * voxel - reach
    high = low + voxels.TILE_VOXELS * voxel + 2 * reach
    found = [np.zeros((0, 3))]
    for step in np.ndindex(3, 3, 3):
        other: Tile = (tile[0] + step[0] - 1, tile[1] + step[1] - 1, tile[2] + step[2] - 1)
        path = _tile_path(scratch, other, "merged")
        if other != tile and path.exists():
            cell, weight, place = _columns(path, 3)
            xyz = voxels.positions(cell, weight, place, other, voxel)
            near = np.ones(len(xyz), bool)
            for k in range(3):
                near &= (xyz[:, k] >= low[k]) & (xyz[:, k] <= high[k])
            found.append(xyz[near])
    return np.concatenate(found)


def _tile_path(scratch: Path, tile: Tile, what: str) -> Path:
    return scratch / f"{'_'.join(str(t) for t in tile)}.{what}"


def _map_path(scratch: Path, number: int) -> Path:
    return scratch / f"{number:06d}.points"


def _save(path: Path, points: voxels.Voxels) -> None:
    with replacing(path) as temporary, open(temporary, "wb") as file:
        for values in vars(points).values():
            values.tofile(file)


def _load(path: Path) -> voxels.Voxels:
    return voxels.Voxels(*_columns(path, len(voxels.COLUMNS)))


def _columns(path: Path, count: int) -> list[np.ndarray]:
    """The first columns of a tile file."""
    rows = path.stat().st_size // sum(np.dtype(kind).itemsize for kind in voxels.COLUMNS)
    with open(path, "rb") as file:
        return [np.fromfile(file, kind, rows) for kind in voxels.COLUMNS[:count]]


def filter_points(
    xyz: np.ndarray, spacing: np.ndarray, settings: CloudSettings, tuning: Tuning, around: np.ndarray | None = None
) -> tuple[np.ndarray, int, int]:
    """Outlier filters in object space as in PCL (paper 004, section 6) on points (M, 3) with spacing (M,): which are
    kept (M,) bool, and how many each filter dropped. Distances are counted in each point's own spacing, because it
    varies within a cloud. ``around`` (K, 3): points of the surroundings, counted as neighbours only, so that the border
    of a tile is not a border of the cloud.

    *Statistical*: the mean distance to the nearest ``neighbours`` is at most the mean of all plus ``statistical_ratio``
    deviations. *Radius*: ``radius_neighbours`` other points lie within ``radius_voxels`` spacings.
    """
    count, wanted = tuning.neighbours, settings.radius_neighbours
    if len(xyz) == 0:
        return np.zeros(0, bool), 0, 0
    tree = cKDTree(xyz if around is None else np.concatenate([xyz, around]))
    statistical = settings.statistical_ratio > 0 and tree.n > count
    mean, furthest = np.zeros(len(xyz)), np.zeros(len(xyz))
    for s in range(0, len(xyz) if statistical or wanted else 0, _ASKED_AT_ONCE):
        part = slice(s, s + _ASKED_AT_ONCE)
        # The distance to the n-th neighbour says whether n are within the radius.
        distance = np.asarray(tree.query(xyz[part], k=1 + max(count if statistical else 0, wanted))[0])
        furthest[part] = distance[:, wanted]
        mean[part] = distance[:, 1 : count + 1] @ np.full(count, 1 / count) if statistical else 0
    mean /= spacing
    held = np.minimum(mean, tuning.held_medians * np.median(mean))
    near = mean <= held.mean() + settings.statistical_ratio * held.std()
    dense = furthest <= tuning.radius_voxels * spacing
    return near & dense, int(np.count_nonzero(~near)), int(np.count_nonzero(near & ~dense))
