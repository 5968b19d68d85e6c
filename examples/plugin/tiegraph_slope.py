"""Product ``slope``: how steep a surface is, in degrees from its reference surface, as GeoTIFF."""

from pathlib import Path

import numpy as np
import rasterio


def make(surface: Path, target: Path) -> None:
    """Write ``slope.tif`` into ``target`` from ``dsm.tif`` of a surface."""
    with rasterio.open(surface / "dsm.tif") as raster:
        heights, profile = raster.read(1, masked=True).filled(np.nan), raster.profile
        down, right = np.gradient(heights, *raster.res[::-1])
    slope = np.degrees(np.arctan(np.hypot(down, right)))
    with rasterio.open(target / "slope.tif", "w", **profile | {"nodata": -1}) as raster:
        raster.write(np.nan_to_num(slope, nan=-1).astype("float32"), 1)
