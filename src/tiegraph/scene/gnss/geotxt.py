"""OpenDroneMap's geo.txt: first line the CRS, then ``image x y [z] [yaw pitch roll] [sigma_h sigma_v] [more]``."""

import re
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import crs_transformer
from tiegraph.scene.gcp import parse_crs_line
from tiegraph.scene.gnss.fixes import Fixes
from tiegraph.scene.table import decoded, number, text_lines

_CRS = re.compile(r"(?i)EPSG:\d+(?:\+\d+)?$|\+(?:proj|init)=|WGS\s*84\s*UTM\s*\d+\s*[NS]$")
_GCP = re.compile(r"[-+.\d]+(?:\s+[-+.\d]+){4}\s+\S+")


def is_geotxt(text: str, raw: bytes) -> bool:
    """Whether the first line of a file that is no comment is a CRS."""
    first = next((line.strip() for line in text_lines(text) if line.strip() and not line.lstrip().startswith("#")), "")
    return bool(_CRS.match(first))


def read_geotxt(path: Path, raw: bytes) -> Fixes:
    """Rows of a geo.txt by image; the angles are not used.

    Raises InputError, with the line, for an unknown CRS, numbers that are none, a place outside the CRS, no rows, and
    for a list of control points.
    """
    text, notes = decoded(path, raw, "GNSS file")
    lines = [(n, line.strip()) for n, line in enumerate(text_lines(text), start=1)]
    lines = [(n, line) for n, line in lines if line and not line.startswith("#")]
    crs = parse_crs_line(lines[0][1], f"{path}, line {lines[0][0]}")
    if len(lines) < 2:
        raise InputError(f"{path}: no rows below its CRS; expected lines image x y z")
    rows = [_row(path, n, line) for n, line in lines[1:]]
    xyz = np.array([values[:3] for _, values in rows])
    flat = xyz[:, 2] == xyz[:, 2]
    x, y, z = xyz[:, 0], xyz[:, 1], np.where(flat, xyz[:, 2], 0.0)
    lon, lat, height = crs_transformer(crs.srs).transform(x, y, z, direction="INVERSE")
    bad = np.flatnonzero(~(np.isfinite(lat) & np.isfinite(lon)))
    if crs.is_geographic:
        bad = np.flatnonzero((np.abs(xyz[:, 1]) > 90) | (np.abs(xyz[:, 0]) > 360))
    if len(bad):
        k = int(bad[0])
        swapped = "latitude and longitude exchanged (x is the longitude), or " if crs.is_geographic else ""
        raise InputError(
            f"{path}, line {lines[1 + k][0]}: x {xyz[k, 0]:.10g}, y {xyz[k, 1]:.10g} lies outside {crs.name}: {swapped}"
            "another CRS? Correct the first line"
        )
    sigma = np.array([values[3:] for _, values in rows])
    return Fixes(
        path=path,
        line=[n for n, _ in lines[1:]],
        lat_lon_height=np.stack([lat, lon, np.where(flat, height, np.nan)], axis=1),
        time_s=np.full(len(rows), np.nan),
        names=[name for name, _ in rows],
        sigma_m=sigma[:, [0, 0, 1]],
        notes=notes,
    )


def _row(path: Path, n: int, line: str) -> tuple[str, list[float]]:
    """Name of the image and x, y, z and the two sigmas, NaN = not given."""
    if _GCP.match(line):
        raise InputError(f"{path}, line {n}: x y z px py image, as in a gcp_list.txt: give control points by --gcp")
    name, *cells = line.split()
    place, sigmas = cells[:3], cells[6:8] if len(cells) >= 8 else []
    numbers = [number(c) for c in (*place, *sigmas)]
    bad = next((c for c, v in zip((*place, *sigmas), numbers) if v != v), None)
    if len(place) < 2 or bad is not None:
        what = f"{bad!r} is no number" if bad is not None else f"{line!r:.80} has no x and y"
        raise InputError(f"{path}, line {n}: {what}; expected image x y z [yaw pitch roll] [sigma_h sigma_v]")
    nan = float("nan")
    return name, [*[*numbers[: len(place)], nan][:3], *(numbers[3:] or [nan, nan])]
