"""Points with what was measured at them, as LAS or LAZ 1.4: extra dimensions of 32 bits, colours by the first."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import laspy
import matplotlib
import numpy as np

from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.atomic import replacing
from tiegraph.scene.cloudfile import las_header, shift_of, undate
from tiegraph.scene.results import Cloud


@dataclass(frozen=True)
class Measured:
    """Points ``xyz`` (N, 3) of the world and their ``columns`` {name: (N,)}; NaN = not measured. The first column gives
    the colours: ``shown`` its values at both ends of the colour map."""

    xyz: np.ndarray
    columns: dict[str, np.ndarray]
    shown: tuple[float, float]


def write_measured(parts: Iterable[Measured], path: Path, origin: Origin | None, spacing: float) -> int:
    """Write points part by part; their number. Without a part no file is written. ``spacing`` of the points: the
    resolution where the world has no units. Raises TiegraphError when the disk is full."""
    rest = iter(parts)
    first = next(rest, None)
    if first is None:
        return 0
    cloud = replace(Cloud.empty(origin), xyz_m=first.xyz)
    header, _ = las_header(cloud, spacing, extra=[(name, "f4") for name in first.columns])
    count = 0
    with replacing(path) as temporary:
        with laspy.open(temporary, mode="w", header=header, do_compress=path.suffix.lower() == ".laz") as out:
            for part in chain([first], rest):
                out.write_points(_records(part, header, shift_of(origin)))
                count += len(part.xyz)
        undate(temporary)
    return count


def _records(part: Measured, header: laspy.LasHeader, shift: np.ndarray) -> laspy.ScaleAwarePointRecord:
    record = laspy.ScaleAwarePointRecord.zeros(len(part.xyz), header=header)
    record.x, record.y, record.z = (part.xyz + shift).T
    record["return_number"] = record["number_of_returns"] = np.ones(len(part.xyz), np.uint8)
    low, high = part.shown
    colours = matplotlib.colormaps["coolwarm" if low < 0 else "viridis"].with_extremes(bad="0.6")
    value = np.ma.masked_invalid((next(iter(part.columns.values())) - low) / max(high - low, 1e-12))
    record.red, record.green, record.blue = (255 * 257 * colours(value)[:, :3]).astype(np.uint16).T
    for name, values in part.columns.items():
        record[name] = values.astype(np.float32)
    return record
