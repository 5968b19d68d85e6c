"""Rows whose places stand in a coordinate system that their file names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import crs_transformer

if TYPE_CHECKING:
    import pyproj


def geodetic_rows(crs: pyproj.CRS, xyz: np.ndarray, path: Path, lines: Sequence[int]) -> np.ndarray:
    """(R, 3) latitude, longitude, height of x (east), y (north), z (R, 3) in a CRS; NaN = no height.

    Raises InputError, with the line, for a place outside the CRS.
    """
    x, y, z = xyz.T
    lon, lat, height = crs_transformer(crs.srs).transform(x, y, np.nan_to_num(z), direction="INVERSE")
    bad = np.flatnonzero(np.isfinite(x + y) & ~(np.isfinite(lat) & np.isfinite(lon)))
    if crs.is_geographic:
        bad = np.flatnonzero((np.abs(y) > 90) | (np.abs(x) > 360))
    if len(bad):
        k = int(bad[0])
        swapped = "latitude and longitude exchanged (x is the longitude), or " if crs.is_geographic else ""
        raise InputError(
            f"{path}, line {lines[k]}: x {x[k]:.10g}, y {y[k]:.10g} lies outside {crs.name}: {swapped}another CRS? "
            "Correct the line that names it"
        )
    return np.stack([lat, lon, np.where(np.isnan(z), np.nan, height)], axis=1)
