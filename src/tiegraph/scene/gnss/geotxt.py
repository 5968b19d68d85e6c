"""OpenDroneMap's geo.txt: first line the CRS, then ``image x y [z] [yaw pitch roll] [sigma_h sigma_v] [more]``."""

import re
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.cells import number
from tiegraph.scene.crsline import parse_crs_line
from tiegraph.scene.gnss.fixes import Fixes
from tiegraph.scene.gnss.grids import geodetic_rows
from tiegraph.scene.textfile import decoded, filled_lines, split_cells

_CRS = re.compile(r"(?i)EPSG:\d+(?:\+\d+)?$|\+(?:proj|init)=|WGS\s*84\s*UTM\s*\d+\s*[NS]$")
_GCP = re.compile(r"[-+.\d]+(?:\s+[-+.\d]+){4}\s+\S+")


def is_geotxt(text: str, raw: bytes) -> bool:
    """Whether the first line of a file that is no comment is a CRS."""
    first = next((line for _, line in filled_lines(text) if not line.startswith("#")), "")
    return bool(_CRS.match(first))


def read_geotxt(path: Path, raw: bytes) -> Fixes:
    """Rows of a geo.txt by image; the angles are not used, which is said.

    Raises InputError, with the line, for an unknown CRS, numbers that are none, a place outside the CRS, no rows, and
    for a list of control points.
    """
    text, notes = decoded(path, raw, "GNSS file")
    lines = [(n, line) for n, line in filled_lines(text) if not line.startswith("#")]
    crs = parse_crs_line(lines[0][1], f"{path}, line {lines[0][0]}")
    if len(lines) < 2:
        raise InputError(f"{path}: no rows below its CRS; expected lines image x y z")
    rows = [_row(path, n, line) for n, line in lines[1:]]
    xyz = np.array([values[:3] for _, values in rows])
    sigma = np.array([values[3:] for _, values in rows])
    if any(_cells(line)[4:7] for _, line in lines[1:]):
        notes.append(f"{path.name}: what stands behind x y z is passed over, but for the two sigmas of rows with eight")
    return Fixes(
        path=path,
        line=[n for n, _ in lines[1:]],
        lat_lon_height=geodetic_rows(crs, xyz, path, [n for n, _ in lines[1:]]),
        time_s=np.full(len(rows), np.nan),
        names=[name for name, _ in rows],
        sigma_m=sigma[:, [0, 0, 1]],
        notes=notes,
    )


def _row(path: Path, n: int, line: str) -> tuple[str, list[float]]:
    """Name of the image and x, y, z and the two sigmas, NaN = not given."""
    if _GCP.match(line):
        raise InputError(f"{path}, line {n}: x y z px py image, as in a gcp_list.txt: give control points by --gcp")
    name, *cells = _cells(line)
    place, sigmas = cells[:3], cells[6:8] if len(cells) >= 8 else []
    numbers = [number(c) for c in (*place, *sigmas)]
    bad = next((c for c, v in zip((*place, *sigmas), numbers) if v != v), None)
    if len(place) < 2 or bad is not None:
        what = f"{bad!r} is no number" if bad is not None else f"{line!r:.80} has no x and y"
        raise InputError(f"{path}, line {n}: {what}; expected image x y z [yaw pitch roll] [sigma_h sigma_v]")
    nan = float("nan")
    return name, [*[*numbers[: len(place)], nan][:3], *(numbers[3:] or [nan, nan])]


def _cells(line: str) -> list[str]:
    """Cells between tabs, where there are enough, so that names may have blanks."""
    return split_cells(line, "\t" if line.count("\t") > 1 else None)
