"""Clouds with known differences, and two of them laid into tiles."""

from pathlib import Path

import numpy as np

from tiegraph.evaluate.clouds.tiles import TiledClouds, tile_clouds
from tiegraph.evaluate.tuning import CloudTuning
from tiegraph.scene.cloudchunks import Points, PointSource, points_of


def quay(points: int = 20000, seed: int = 0, noise_m: float = 0.0) -> np.ndarray:
    """A floor and a wall, 10 m x 4 m each."""
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0, 10, points), rng.uniform(0, 4, points)
    floor = np.column_stack([a, b, np.zeros(points)])
    out = np.vstack([floor[::2], np.column_stack([a, np.full(points, 4.0), b])[1::2]])
    return out + noise_m * rng.standard_normal(out.shape)


def ground(points: int, seed: int, noise_m: float = 0.01, box_m: float = 0.0) -> np.ndarray:
    """20 m x 20 m of gentle ground; the top of a box of 4 m x 4 m in its middle stands ``box_m`` higher."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-10, 10, (2, points))
    z = 0.2 * np.sin(x / 4) + 0.1 * y + box_m * ((np.abs(x) < 2) & (np.abs(y) < 2))
    return np.column_stack([x, y, z + noise_m * rng.standard_normal(points)])


def stated(xyz: np.ndarray, sigma_m: float) -> PointSource:
    """A cloud that states the sigma of its points."""
    return PointSource("the cloud", lambda: iter([Points(xyz, np.full(len(xyz), sigma_m))]))


def tiled(
    first: np.ndarray | PointSource, second: np.ndarray | PointSource, folder: Path, tile_points: int = 2_000_000
) -> TiledClouds:
    """Two clouds in tiles of so many points."""
    sources = [s if isinstance(s, PointSource) else points_of(s) for s in (first, second)]
    return tile_clouds(sources[0], sources[1], folder, CloudTuning(tile_points=tile_points))
