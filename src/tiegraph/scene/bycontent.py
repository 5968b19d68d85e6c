"""What the columns of a table without a header are, by its cells; () where they may be two things."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tiegraph.geometry.geodesy import within_area
from tiegraph.scene.cells import number, parse_time

if TYPE_CHECKING:
    import pyproj

Cells = Sequence[tuple[str, ...]]


def is_file(cell: str) -> bool:
    """Whether a cell is the name of a file."""
    return bool(re.fullmatch(r".*\.[A-Za-z]\w{1,4}", cell))


def positions(rows: Cells) -> tuple[str, ...]:
    """Image or time, latitude and longitude in either order where one is above 90, height, perhaps three angles of the
    camera, perhaps two accuracies, as Pix4D writes them."""
    first = "image" if is_file(rows[0][0]) else "time" if np.isfinite(parse_time(rows[0][0])) else ""
    values = _numbers(rows)
    width = values.shape[1] + 1
    if width not in (4, 6, 7, 9) or not first or np.isnan(values).any():
        return ()
    return (first, *_degrees(values), *_behind(values)) if _degrees(values) else ()


def geotxt(rows: Cells) -> tuple[str, ...]:
    """The columns of ODM's geo.txt. Accuracies stand behind three angles."""
    width = max(len(cells) for cells in rows)
    sigmas = ("sigma_h", "sigma_v") if width > 8 else ()
    names = ("image", "x", "y", "z", "angle_1", "angle_2", "angle_3", *sigmas)
    return (*names, *(f"more_{k}" for k in range(width)))[: max(width, 4)]


def points(rows: Cells, crs: pyproj.CRS | None) -> tuple[str, ...]:
    """Marks (image and point in either order, two pixels); or a point, its place in degrees, or in a grid where only
    one order lies in its area of use (PNEZD, PENZD), height, perhaps two accuracies, perhaps a code."""
    values = _numbers(rows)
    width = values.shape[1] + 1
    if width == 4 and np.isnan(values[:, 0]).all() and np.isfinite(values[:, 1:]).all():
        files = is_file(rows[0][0]), is_file(rows[0][1])
        return {(True, False): ("image", "name", "px", "py"), (False, True): ("name", "image", "px", "py")}.get(
            files, ()
        )
    if width < 4 or np.isnan(values[:, :3]).any():
        return ()
    codes = tuple(f"code_{k}" for k in range(1, width - 3))
    behind = _behind(values) if width == 6 and np.isfinite(values).all() else ("height", *codes)
    order: tuple[str, ...] = _degrees(values) if crs is None or crs.is_geographic else ()
    if crs is not None and crs.is_projected:
        fits = [bool(within_area(crs.srs, values[:, k]).all()) for k in ([0, 1], [1, 0])]
        if fits[0] != fits[1]:
            order = ("easting", "northing") if fits[0] else ("northing", "easting")
    return ("name", *order, *behind) if order else ()


def times(rows: Cells) -> tuple[str, ...]:
    """An image and a time in either order, or a time; a date and a time may be two cells."""
    kinds = ["image" if is_file(c) else "time" if np.isfinite(parse_time(c)) else "" for c in rows[0]]
    if kinds[-2:] == ["time", "time"]:
        kinds[-2] = "date"
    known = sorted(kinds) in (["time"], ["image", "time"], ["date", "time"], ["date", "image", "time"])
    return tuple(kinds) if known else ()


def _numbers(rows: Cells) -> np.ndarray:
    """(R, C - 1) of the cells behind the first, NaN for what is none."""
    width = max(len(cells) for cells in rows)
    return np.array([[number(c) for c in (*cells, *("",) * width)[1:width]] for cells in rows]).reshape(len(rows), -1)


def _degrees(values: np.ndarray) -> tuple[str, ...]:
    a, b = np.abs(values[:, :2]).max(axis=0)
    if max(a, b) > 180 or (a <= 90) == (b <= 90):
        return ()
    return ("lat", "lon") if a <= 90 else ("lon", "lat")


def _behind(values: np.ndarray) -> tuple[str, ...]:
    """Names of the columns from the height on."""
    width = values.shape[1] + 1
    turns = ("angle_1", "angle_2", "angle_3") if width in (7, 9) else ()
    return ("height", *turns, *(("accuracy_horz", "accuracy_vert") if width in (6, 9) else ()))
