"""Scans of a LiDAR, one after another: from a folder of files (KITTI's .bin, PCD, PLY, NPZ, LAS and LAZ, one scan a
file), a ROS bag, or packets of a Velodyne."""

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np

from tiegraph.errors import InputError, optional, reading
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import from_quaternion_wxyz
from tiegraph.lidar.settings import LidarSettings
from tiegraph.scene.atomic import regular
from tiegraph.scene.bags import is_bag, open_bag, split_topics, stamp_ns
from tiegraph.scene.cells import in_seconds, parse_time
from tiegraph.scene.cells import times as times_by_content
from tiegraph.scene.cloudfile import read_cloud, whole_las_header
from tiegraph.scene.posefile import read_poses
from tiegraph.scene.table import Table, read_table
from tiegraph.scene.times import times_in, times_of

_TIMES = ("t", "time", "dt", "time_s", "offset_time", "timestamp", "timestamps", "times", "gps_time")
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
    time = next((lower[c] for c in _TIMES if c in lower), None)
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
        time = next((in_time(data[k]) for k in data.files if k in _TIMES), None)
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

_FIELD_TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")  # by PointField.datatype, from 1
_FOLDERS = ("velodyne", "velodyne_points/data", "lidar")  # of KITTI odometry, KITTI raw, PandaSet
LEAST_POINTS = 50  # of a scan
_MOST_SWEEP_S = 2.0  # a turn takes 0.05 to 0.2 s
_KINDS = f"a folder of scans ({', '.join(sorted(READERS))}), a ROS bag, or a .pcap file"
_FILES = ("times.txt", "timestamps.txt", "times.csv", "timestamps.csv", "timestamps.json")


@dataclass(frozen=True)
class Scan:
    """One turn of a scanner: xyz_m (N, 3) in its frame, finite; ``offset_s`` (N,) of each point from ``stamp_s``, None
    where points have no times; ``lost``: points that were at no place."""

    name: str
    stamp_s: float
    xyz_m: np.ndarray
    offset_s: np.ndarray | None
    lost: int = 0


@dataclass(frozen=True)
class Recording:
    """Scans that can be gone through any number of times; ``given`` (T, 4, 4): where the files' poses have the scanner,
    None if they have none."""

    read: Callable[[], Iterator[Scan]]
    count: int | None = None
    given: np.ndarray | None = None
    notes: tuple[str, ...] = ()


def open_scans(path: Path, how: LidarSettings) -> Recording:
    """A recording, read as the settings say; only lists of files, times and poses are read.

    Raises InputError for a path without scans, for times or poses that do not fit the scans, and, while it is gone
    through, for scans that are damaged, empty or out of order.
    """
    if is_bag(path):
        return _stream(path, how, bag_scans)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; give {_KINDS}")
    if path.suffix.lower() == ".pcap":
        return _stream(path, how, pcap_scans)
    if not path.is_dir():
        raise InputError(f"{path}: one file; give {_KINDS}")
    return _files(path, how)


def _stream(path: Path, how: LidarSettings, read: Callable[[Path], Iterator[tuple[float, Points]]]) -> Recording:
    if how.poses is not None or how.times is not None or how.rate_hz is not None:
        raise InputError(f"{path}: its scans have times of their own: leave --times, --rate-hz and --poses out")
    return Recording(lambda: _in_order(path, (_scan(f"scan {k}", *one) for k, one in enumerate(read(path), start=1))))


def _files(folder: Path, how: LidarSettings) -> Recording:
    files, notes = scan_files(folder)
    if len(files) < 2:
        raise InputError(f"{files[0]}: the only scan; a trajectory needs at least 2")
    stems = [f.stem for f in files]
    stamps: list[float | None] = [None] * len(files)
    beside = (place / name for place in files[0].parents[:2] for name in _FILES)
    times = how.times or next((file for file in beside if file.is_file()), None)
    if how.rate_hz is not None:
        stamps = [k / how.rate_hz for k in range(len(files))]
    elif times is not None:
        stamps = list(read_scan_times(times, stems))
        notes.append(f"times of the scans: {times.name}")
    given = None if how.poses is None else of_scans(how.poses, read_scan_poses(how.poses), stems)

    def scans() -> Iterator[Scan]:
        for k, file in enumerate(files):
            points = READERS[file.suffix.lower()](file, how.columns)
            if given is not None:  # points in a world were put there by their own times
                points = Points(transforms.apply(transforms.invert(given[k]), points.xyz_m), None)
            yield _scan(str(file), stamps[k], points)

    return Recording(lambda: _in_order(folder, scans()), count=len(files), given=given, notes=tuple(notes))


def scan_files(folder: Path) -> tuple[list[Path], list[str]]:
    """The scans of a folder in the order of their numbers, and what was left out. Raises InputError for none."""
    for place in (folder, *(folder / f for f in _FOLDERS)):
        files = [f for f in sorted(place.iterdir()) if f.suffix.lower() in READERS] if place.is_dir() else []
        if files:
            break
    else:
        raise InputError(f"{folder}: no scans in it; give {_KINDS}")
    kinds = Counter(_pattern(f) for f in files)
    usual = max(kinds, key=lambda k: kinds[k])
    taken = [f for f in files if _pattern(f) == usual]
    others = [f.name for f in files if _pattern(f) != usual]
    notes = [f"left out, not named as the others are: {', '.join(others[:5])}"] if others else []
    return sorted(taken, key=lambda f: ([int(n) for n in re.findall(r"\d+", f.stem)], f.name)), notes


def _pattern(file: Path) -> tuple[str, str]:
    return re.sub(r"\d+", "#", file.stem), file.suffix.lower()


def _scan(name: str, stamp_s: float | None, points: Points) -> Scan:
    """A scan without points at no place, its times in seconds from its stamp."""
    good = np.isfinite(points.xyz_m).all(axis=1) & (points.xyz_m != 0).any(axis=1)
    offset = None
    if points.time_s is not None:
        good &= np.isfinite(points.time_s)
        offset, stamp_s = _offsets(name, points.time_s[good], stamp_s)
    if good.sum() < LEAST_POINTS:
        raise InputError(
            f"{name}: {int(good.sum())} of {len(good)} points are at a place (not NaN, not 0); "
            f"{LEAST_POINTS} are needed: leave the scan out"
        )
    if stamp_s is None:
        raise InputError(f"{name}: nothing says when it was taken: give --times FILE, or --rate-hz")
    return Scan(name, float(stamp_s), xyz_m=points.xyz_m[good], offset_s=offset, lost=int(np.sum(~good)))


def _offsets(name: str, time_s: np.ndarray, stamp_s: float | None) -> tuple[np.ndarray, float]:
    if not len(time_s):
        return time_s, 0.0 if stamp_s is None else stamp_s
    time_s = in_seconds(time_s)
    start = float(time_s.min())
    if start > 1e6:  # times of points above this count from an epoch and not from the scan's start
        time_s, stamp_s = time_s - start, start if stamp_s is None else stamp_s
    span = float(np.ptp(time_s))
    if span > _MOST_SWEEP_S:
        raise InputError(
            f"{name}: its points were taken over {span:g} s, more than {_MOST_SWEEP_S:g} s: is their time in "
            "another unit than seconds, or are these several scans?"
        )
    if stamp_s is None:
        raise InputError(
            f"{name}: its points have times from its start, which nothing tells: give --times or --rate-hz"
        )
    return time_s, stamp_s


def _in_order(path: Path, scans: Iterator[Scan]) -> Iterator[Scan]:
    """The scans. Raises InputError for stamps that do not grow, and for a single scan."""
    last, count = None, 0
    for scan in scans:
        if last is not None and not scan.stamp_s > last.stamp_s:
            raise InputError(
                f"{scan.name}: its time {scan.stamp_s:.6f} s does not come after {last.stamp_s:.6f} s of {last.name}: "
                "sort the scans, or give their times by --times"
            )
        last, count = replace(scan, xyz_m=scan.xyz_m[:0], offset_s=None), count + 1
        yield scan
    if count < 2:
        raise InputError(f"{path}: {count} scan in it; a trajectory needs more")


def pcap_scans(path: Path) -> Iterator[tuple[float, Points]]:
    """Stamp (s) and points of each turn; the first and the last, which may be parts of one, included.

    Raises EngineMissing without velodyne-decoder, and InputError for a file that it cannot read.
    """
    velodyne_decoder = optional("velodyne_decoder", "lidar", f"{path}: a .pcap file")
    regular(path, None)
    with reading(path, "recording of a Velodyne"):
        for stamp, table in velodyne_decoder.read_pcap(str(path)):
            yield float(getattr(stamp, "host", stamp)), Points(table[:, :3].astype(float), table[:, 4].astype(float))


def bag_scans(path: Path) -> Iterator[tuple[float, Points]]:
    """Stamp (s) and points of each message of a bag's only topic of such, or of the one behind the path.

    Raises InputError for several topics, none, a damaged bag, and messages that hold less than they say.
    """
    bag_path, asked = split_topics(path)
    with open_bag(bag_path) as bag:
        topic = bag.only(("sensor_msgs/PointCloud2",), asked)
        for number, (message, received_ns) in enumerate(bag.messages(topic), start=1):
            name = f"{bag_path}: message {number} of {topic.name}"
            yield stamp_ns(message.header, received_ns) * 1e-9, message_points(message, name)


def message_points(message: Any, name: str) -> Points:
    """The points of a PointCloud2. Raises InputError for one whose data are shorter than it says."""
    order = ">" if message.is_bigendian else "<"
    fields = [f for f in message.fields if 1 <= f.datatype <= len(_FIELD_TYPES) and f.count <= 1]
    table: Any = {"names": [f.name for f in fields], "offsets": [f.offset for f in fields]}
    table |= {"formats": [order + _FIELD_TYPES[f.datatype - 1] for f in fields], "itemsize": message.point_step}
    data = np.asarray(message.data, np.uint8)
    if len(data) < message.height * message.row_step or message.width * message.point_step > message.row_step:
        raise InputError(
            f"{name}: {len(data)} bytes for {message.height} rows of {message.width} points: it is cut short"
        )
    rows = data[: message.height * message.row_step].reshape(message.height, message.row_step)
    rows = np.ascontiguousarray(rows[:, : message.width * message.point_step])
    points = rows.reshape(-1).view(np.dtype(table))
    return points_of({n: points[n] for n in table["names"]}, name)


def read_scan_poses(path: Path) -> np.ndarray:
    """world_from_scanner (R, 4, 4), a row a scan: TUM, KITTI, or PandaSet's list of {position, heading}.

    Raises InputError for a file that is none of them.
    """
    if path.suffix.lower() != ".json":
        return read_poses(path).poses
    try:
        rows = json.loads(path.read_text())
        place = np.array([[r["position"][c] for c in "xyz"] for r in rows], float)
        turn = np.array([[r["heading"][c] for c in "wxyz"] for r in rows], float)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: no list of poses with position x y z and heading w x y z ({error!r})") from None
    bad = np.flatnonzero(~(np.abs(np.linalg.norm(turn, axis=1) - 1) < 1e-2) | ~np.isfinite(place).all(axis=1))
    if len(bad):
        raise InputError(f"{path}: pose {bad[0]} is none: position {place[bad[0]]}, heading {turn[bad[0]]}")
    return from_quaternion_wxyz(turn, place)


def read_scan_times(path: Path, stems: Sequence[str]) -> np.ndarray:
    """(N,) seconds of the scans with these names without ending.

    A .json is a list of numbers; any other file a table with a column time (or time_start) and, perhaps, one with the
    scans' names, or a number or a date a line. Raises InputError for times that are none or too few.
    """
    if path.suffix.lower() != ".json":
        return _of_table(read_table(path, "times of the scans", "scan,time", times_by_content), stems)
    try:
        seconds = np.array([parse_time(str(row)) for row in json.loads(path.read_text())])
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: cannot be read as times of scans: {error}") from None
    bad = np.flatnonzero(~np.isfinite(seconds))
    if len(bad):
        raise InputError(f"{path}, line {bad[0] + 1}: no time (seconds, or a date and time)")
    return of_scans(path, in_seconds(seconds), stems)


def of_scans(path: Path, rows: np.ndarray, stems: Sequence[str]) -> np.ndarray:
    """The rows (R, ...) of a file that belong to scans: as many as these in their order, else by their numbers.

    Raises InputError where neither fits.
    """
    if len(rows) == len(stems):
        return rows
    numbers = [int(s) if s.isdigit() else -1 for s in stems]
    if min(numbers) >= 0 and max(numbers) < len(rows):
        return rows[numbers]
    raise InputError(f"{path}: {len(rows)} rows for {len(stems)} scans ({stems[0]} to {stems[-1]}): one each is needed")


def _of_table(table: Table, stems: Sequence[str]) -> np.ndarray:
    start = table.find("start of the scan")
    found = times_of(table) if start is None else times_in(table, start)
    if found is None:
        raise InputError(f"{table.path}: found the columns {', '.join(table.columns)}; expected one called time")
    bad = np.flatnonzero(~np.isfinite(found.seconds))
    if len(bad):
        row = int(bad[0])
        raise InputError(f"{table.where(row)}: {table.cell(row, found.column)!r:.80} is no time (seconds, or a date)")
    names = next((c for c in (table.find("scan"), table.find("image")) if c is not None), None)
    if names is None:
        return of_scans(table.path, found.seconds, stems)
    by_name = {Path(table.cell(k, names)).stem: v for k, v in enumerate(found.seconds)}
    missing = [s for s in stems if s not in by_name]
    if missing:
        raise InputError(f"{table.path}: no row for the scan {missing[0]} ({len(missing)} of {len(stems)} have none)")
    return np.array([by_name[s] for s in stems])
