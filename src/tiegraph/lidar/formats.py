"""One scan a file: KITTI's .bin, PCD, PLY, NPZ, LAS and LAZ."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np

from tiegraph.errors import InputError, optional, reading
from tiegraph.scene.atomic import regular
from tiegraph.scene.cloudfile import read_cloud, whole_las_header

BIN_COLUMNS = ("x", "y", "z", "intensity")
TIME_COLUMNS = ("t", "time", "dt", "time_s", "offset_time", "timestamp", "timestamps", "times", "gps_time")
_XYZ = {"xyz": 1.0, "xyz_m": 1.0, "points": 1.0, "pts": 1.0, "xyz_cm": 0.01, "xyz_mm": 0.001}  # name -> metres


@dataclass(frozen=True)
class Points:
    """xyz_m (N, 3) f8 as the file has them; time_s (N,) f8 from the scan's stamp or from an epoch, None = none."""

    xyz_m: np.ndarray
    time_s: np.ndarray | None


def in_time(values: np.ndarray) -> np.ndarray:
    """Times of points in seconds: whole numbers are nanoseconds (Ouster, Livox), others seconds (Velodyne, Hesai)."""
    values = np.asarray(values)
    return values.astype(float) * (1e-9 if values.dtype.kind in "iu" else 1.0)


def points_of(columns: dict[str, np.ndarray], name: str) -> Points:
    """Points of named columns (N,). Raises InputError without x, y and z."""
    lower = {k.lower(): v for k, v in columns.items()}
    if not {"x", "y", "z"} <= set(lower):
        raise InputError(f"{name}: found the columns {', '.join(columns)}; x, y and z are needed")
    time = next((lower[c] for c in TIME_COLUMNS if c in lower), None)
    xyz = np.stack([lower[c].astype(float) for c in "xyz"], axis=1)
    return Points(xyz, None if time is None else in_time(time))


def _read_bin(path: Path, columns: Sequence[str]) -> Points:
    """float32, the columns of a point one after another (KITTI: x, y, z, intensity)."""
    width = len(columns)
    size = regular(path, None).stat().st_size
    if size % (4 * width) or not size:
        # Columns of a .bin that an error proposes
        fits = [str(w) for w in range(3, 13) if size and size % (4 * w) == 0]
        fit = f"; {' or '.join(fits)} columns would fit: name them by --columns" if fits else ": it is cut short"
        raise InputError(f"{path}: {size} bytes are not points of {width} columns ({', '.join(columns)}){fit}")
    rows = np.fromfile(path, "<f4").reshape(-1, width)
    return points_of({name: rows[:, k] for k, name in enumerate(columns)}, str(path))


def _read_pcd(path: Path, columns: Sequence[str]) -> Points:
    pypcd4 = optional("pypcd4", "lidar", f"{path}: a file of PCD")
    regular(path, None)
    with reading(path, "scan"):
        cloud = pypcd4.PointCloud.from_path(path)
        if cloud.points != cloud.metadata.points:
            raise ValueError(f"{cloud.points} of {cloud.metadata.points} points are there")
        return points_of({f: cloud.pc_data[f] for f in cloud.fields if not f.startswith("__")}, str(path))


def _read_npz(path: Path, columns: Sequence[str]) -> Points:
    regular(path, None)
    with reading(path, "scan"), np.load(path) as data:
        key = next((k for k in data.files if k in _XYZ), None)
        time = next((in_time(data[k]) for k in data.files if k in TIME_COLUMNS), None)
        xyz = None if key is None else data[key][:, :3].astype(float) * _XYZ[key]
        files = data.files
    if xyz is None:
        raise InputError(f"{path}: found the arrays {', '.join(files)}; points are sought in {', '.join(_XYZ)} (N, 3)")
    if time is not None and time.shape != (len(xyz),):
        raise InputError(f"{path}: {len(xyz)} points, but times of shape {time.shape}")
    return Points(xyz, time)


def _read_las(path: Path, columns: Sequence[str]) -> Points:
    with reading(path, "scan"):
        whole_las_header(regular(path, None))
        las = laspy.read(path)
        xyz = np.stack([np.asarray(las.x), np.asarray(las.y), np.asarray(las.z)], axis=1).astype(float)
        time = np.asarray(las.gps_time, float) if "gps_time" in las.point_format.dimension_names else None
    return Points(xyz, time if time is not None and len(time) and np.ptp(time) > 0 else None)


READERS: dict[str, Callable[[Path, Sequence[str]], Points]] = {
    ".bin": _read_bin,
    ".pcd": _read_pcd,
    ".ply": lambda path, columns: Points(read_cloud(path).xyz_m, None),
    ".npz": _read_npz,
    ".las": _read_las,
    ".laz": _read_las,
}
"""Ending of a file -> what reads it; the names are those of the columns of a .bin."""
