"""Depth maps to one cloud, tile by tile: memory is bounded by a tile, whatever the size of the survey.

Steps, each over independent items through one function ``run`` (serial or a pool): depth map -> voxel sums of the
tiles it touches (files); tile -> sums added up; tile -> outliers removed, with its neighbours' margins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.cloud.filter import filter_points
from tiegraph.cloud.settings import CloudSettings
from tiegraph.cloud.voxels import LEVELS, Voxels, add_up, row_numbers, voxels_of, without_coarse_duplicates
from tiegraph.errors import ReconstructionError
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import apply, invert
from tiegraph.scene.atomic import replacing
from tiegraph.scene.results import Cloud, DepthMap

Tile = tuple[int, int, int]
LoadMap = Callable[[str], "tuple[DepthMap, np.ndarray] | None"]  # depth map and colours (H, W, 3) u1 RGB, by image name
Run = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]  # map over items, results in their order

TILE_VOXELS = 512  # edge of a tile in finest voxels: a wall through it has a quarter of a million points
_MERGE_ROWS = 4_000_000  # rows held before parts are added up: about 0.5 GB
_SAMPLED_MAPS = 200  # depth maps that decide the automatic voxel size


@dataclass(frozen=True)
class Fused:
    """The cloud as tile files, the voxel edge, and counts for the receipt."""

    tiles: tuple[Path, ...]
    voxel: float
    counts: dict[str, int]
    origin: Origin | None

    def clouds(self) -> Iterator[Cloud]:
        """The cloud tile by tile."""
        for path in self.tiles:
            yield _load(path).cloud(self.voxel, self.origin)

    def cloud(self) -> Cloud:
        """The whole cloud in memory."""
        parts = list(self.clouds())
        return Cloud.concatenate(parts) if parts else Cloud.empty(self.origin)


def fuse(
    names: Sequence[str],
    load: LoadMap,
    scratch: Path,
    settings: CloudSettings,
    origin: Origin | None = None,
    run: Run = map,
) -> Fused:
    """Fuse the depth maps of ``names`` (``load`` must be picklable if ``run`` uses processes). ``scratch`` is an empty
    folder for tile files, the result among them. Raises ReconstructionError if no depth map has a point."""
    voxel = settings.voxel_size or automatic_voxel(names, load, run)
    numbered = list(enumerate(names))
    scattered = list(run(partial(_scatter_one, load=load, scratch=scratch, voxel=voxel, settings=settings), numbered))
    tiles = sorted({tile for touched, _, _ in scattered for tile in touched})
    if not tiles:
        raise ReconstructionError(
            "no depth map has a point that enough images agree on: lower --dense.min-views, "
            "raise --dense.tolerance-px, or look at the poses in the report"
        )
    parts = [(tile, [k for k, (touched, _, _) in enumerate(scattered) if tile in touched]) for tile in tiles]
    merged = list(run(partial(_merge_one, scratch=scratch), parts))
    filtered = list(run(partial(_filter_one, scratch=scratch, voxel=voxel, settings=settings), tiles))
    counts = {
        "pixels": sum(p for _, p, _ in scattered),
        "uncertain": sum(u for _, _, u in scattered),
        "merged": sum(merged),
        "statistical": sum(s for _, s, _ in filtered),
        "radius": sum(r for _, _, r in filtered),
        "points": sum(n for n, _, _ in filtered),
    }
    files = tuple(_tile_path(scratch, tile, "final") for tile, (n, _, _) in zip(tiles, filtered, strict=True) if n)
    return Fused(files, voxel, counts, origin)


def map_points(depth: DepthMap, rgb: np.ndarray, settings: CloudSettings) -> tuple[Cloud, np.ndarray, int]:
    """World points of a depth map, the spacing (M,) each justifies, and the number left out as too uncertain."""
    known = np.isfinite(depth.depth_m)
    sure = known & (depth.sigma_m <= settings.max_relative_sigma * np.where(known, depth.depth_m, 1))
    rows, columns = np.nonzero(sure)
    z = depth.depth_m[sure].astype(float)
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(z))], axis=1) @ np.linalg.inv(depth.K).T
    world_from_cam = invert(depth.cam_from_world)
    normal = np.full((len(z), 3), np.nan, np.float32)
    if depth.normal is not None:
        normal = (depth.normal[sure] @ world_from_cam[:3, :3].T).astype(np.float32)
    sigma = depth.sigma_m[sure]
    cloud = Cloud(apply(world_from_cam, rays * z[:, None]), rgb[sure], normal, sigma, depth.views[sure])
    spacing = np.maximum(z / _focal(depth), sigma)
    return cloud, spacing, int(np.count_nonzero(known & ~sure))


def automatic_voxel(names: Sequence[str], load: LoadMap, run: Run = map) -> float:
    """Median size of a pixel on the object over the depth maps: the spacing at which the images sample it.

    Raises ReconstructionError if no depth map has a depth.
    """
    step = -(-len(names) // _SAMPLED_MAPS) if names else 1
    sizes = [s for s in run(partial(_sampling, load=load), list(names[::step])) if s is not None]
    if not sizes:
        raise ReconstructionError(
            "all depth maps are empty: lower --dense.min-views or raise --dense.tolerance-px, and look at the masks"
        )
    size, count = np.array(sizes).T
    order = np.argsort(size)
    half = np.searchsorted(np.cumsum(count[order]), count.sum() / 2)
    return float(f"{size[order][half]:.3g}")


def _sampling(name: str, load: LoadMap) -> tuple[float, int] | None:
    found = load(name)
    if found is None:
        return None
    depth = found[0]
    known = depth.depth_m[np.isfinite(depth.depth_m)]
    return (float(np.median(known)) / _focal(depth), len(known)) if len(known) else None


def _focal(depth: DepthMap) -> float:
    return float(np.sqrt(depth.K[0, 0] * depth.K[1, 1]))


def _scatter_one(
    item: tuple[int, str], load: LoadMap, scratch: Path, voxel: float, settings: CloudSettings
) -> tuple[set[Tile], int, int]:
    """Write the voxel sums of one depth map, a file for each tile touched: (tiles, pixels, uncertain pixels)."""
    number, name = item
    found = load(name)
    if found is None:
        return set(), 0, 0
    cloud, spacing, uncertain = map_points(*found, settings)
    if len(cloud) == 0:
        return set(), 0, uncertain
    voxels = voxels_of(cloud, spacing, voxel)
    tile = _tile_of(voxels)
    _, first, inverse = np.unique(row_numbers(tile), return_index=True, return_inverse=True)
    touched = set()
    for k, row in enumerate(first):
        at: Tile = (int(tile[row, 0]), int(tile[row, 1]), int(tile[row, 2]))
        _save(_tile_path(scratch, at, f"{number:06d}"), voxels.where(inverse == k))
        touched.add(at)
    return touched, len(cloud), uncertain


def _tile_of(voxels: Voxels) -> np.ndarray:
    """(V, 3) tile of each voxel; a tile's edge is a whole number of voxels of every level."""
    down = (TILE_VOXELS.bit_length() - 1) - voxels.level.astype(np.int64)
    return voxels.index >> down[:, None]


def _merge_one(item: tuple[Tile, list[int]], scratch: Path) -> int:
    """Add up the parts of one tile, and remove them: the number of voxels."""
    tile, numbers = item
    held: list[Voxels] = []
    for number in numbers:
        held.append(_load(_tile_path(scratch, tile, f"{number:06d}")))
        if sum(len(h) for h in held) > _MERGE_ROWS:
            held = [add_up(Voxels.concatenate(held))]
    merged = without_coarse_duplicates(add_up(Voxels.concatenate(held)))
    _save(_tile_path(scratch, tile, "merged"), merged)
    for number in numbers:
        _tile_path(scratch, tile, f"{number:06d}").unlink()
    return len(merged)


def _filter_one(tile: Tile, scratch: Path, voxel: float, settings: CloudSettings) -> tuple[int, int, int]:
    """Filter one merged tile among its neighbours: (points kept, dropped by the statistical, by the radius filter)."""
    voxels = _load(_tile_path(scratch, tile, "merged"))
    around = _margin(tile, scratch, voxel, settings)
    result = filter_points(voxels.cloud(voxel).xyz_m, voxels.spacing(voxel), settings, around)
    kept = voxels.where(result.keep)
    _save(_tile_path(scratch, tile, "final"), kept)
    return len(kept), result.statistical, result.radius


def _margin(tile: Tile, scratch: Path, voxel: float, settings: CloudSettings) -> np.ndarray:
    """Points (K, 3) of the neighbouring tiles within the filters' reach of the tile."""
    reach = min(settings.radius_voxels * 2 ** (LEVELS - 1), TILE_VOXELS / 4) * voxel
    low = np.array(tile) * TILE_VOXELS * voxel - reach
    high = low + TILE_VOXELS * voxel + 2 * reach
    found = [np.zeros((0, 3))]
    for step in np.ndindex(3, 3, 3):
        other = tuple(int(t + s - 1) for t, s in zip(tile, step, strict=True))
        path = _tile_path(scratch, other, "merged")  # type: ignore[arg-type]
        if other != tile and path.exists():
            xyz = _load(path).cloud(voxel).xyz_m
            found.append(xyz[((xyz >= low) & (xyz <= high)).all(axis=1)])
    return np.concatenate(found)


def _tile_path(scratch: Path, tile: Tile, what: str) -> Path:
    return scratch / "_".join(str(t) for t in tile) / f"{what}.npz"


def _save(path: Path, voxels: Voxels) -> None:
    with replacing(path) as temporary:
        np.savez(temporary, **voxels.__dict__)


def _load(path: Path) -> Voxels:
    with np.load(path) as data:
        return Voxels(**{name: data[name] for name in data.files})
