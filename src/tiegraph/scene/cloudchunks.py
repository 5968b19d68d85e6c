"""Point clouds read a part at a time, in double precision: LAS, LAZ, COPC, PLY and E57, of any number of points.

Memory is that of a part (of an E57 file: that of a scan). And what other programs get: points with measured values as
LAS or LAZ 1.4 (extra dimensions of 32 bits, colours by the first), scans as E57 (ASTM E2807).
"""

import uuid
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import laspy
import matplotlib
import numpy as np
import pyproj
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError, optional, reading
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import ENU, Origin, check_vertical, parse_crs
from tiegraph.geometry.stereo import Pinhole
from tiegraph.scene.atomic import regular, replacing
from tiegraph.scene.cloudfile import las_header, ply_parts, shift_of, whole_las_header, write_records
from tiegraph.scene.results import Cloud
from tiegraph.scene.sorting import Columns

CLOUD_ENDINGS = (".las", ".laz", ".ply", ".e57")
_PART = 1_000_000
_FIRST_BYTES = {".las": b"LASF", ".laz": b"LASF", ".ply": b"ply", ".e57": b"ASTM"}


@dataclass(frozen=True)
class Points(Columns):
    """Some points of a cloud: ``xyz`` (N, 3) f8 and ``sigma`` (N,) one standard deviation of a point, NaN = unknown."""

    xyz: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True)
class PointSource:
    """A cloud read part by part; ``name`` is its name in errors, ``crs`` "EPSG:n" (with heights above
    a geoid "EPSG:n+m") if it states one, ``note`` doubts about that."""

    name: str
    parts: Callable[[], Iterator[Points]]
    crs: str | None = None
    note: str = ""

    def moved(self, function: Callable[[np.ndarray], np.ndarray], crs: str | None = None) -> "PointSource":
        """The cloud with its coordinates (N, 3) transformed by a function; sigmas stay."""

        def parts() -> Iterator[Points]:
            for part in self.parts():
                yield Points(function(part.xyz), part.sigma)

        return PointSource(self.name, parts, crs=crs, note=self.note)

    def sample(self, most: int) -> np.ndarray:
        """(N, 3) at most so many points, evenly from the order in the file."""
        kept, step, seen = [np.zeros((0, 3))], 1, 0
        for part in self.parts():
            kept.append(part.xyz[(-seen) % step :: step])
            seen += len(part)
            while sum(map(len, kept)) > most:
                kept, step = [np.concatenate(kept)[::2]], 2 * step
        return np.concatenate(kept)


def points_of(xyz: np.ndarray, name: str = "the cloud") -> PointSource:
    """A source of points (N, 3) in memory, without sigmas."""
    xyz = np.asarray(xyz, float).reshape(-1, 3)
    return PointSource(name, lambda: iter([Points(xyz, np.full(len(xyz), np.nan))]))


def open_cloud(path: Path) -> PointSource:
    """The points of a .las, .laz (also COPC), .ply or .e57 file.

    Raises InputError, here or while its parts are read, for a missing file, no point cloud, a cut-off or
    empty one, for non-finite points, and for a CRS that is not projected in metres.
    """
    check_cloud(path)
    kind = path.suffix.lower()
    read = {".ply": _ply, ".e57": _e57}.get(kind, _las)
    crs, note = las_crs(path) if kind in (".las", ".laz") else None, ""
    try:
        check_vertical(crs or ENU)
    except InputError as error:
        crs, _, heights = str(crs).partition("+")
        note = f"its heights refer to another level (EPSG:{heights}) and are compared unchanged: {error}"
    name = str(path) if crs is None else f"{path} ({crs} by its header)"
    return PointSource(name, lambda: _checked(path, read), crs=crs, note=note)


def check_cloud(path: Path) -> None:
    """Raise InputError for a file that is no point cloud by its extension and first bytes, or whose header announces
    no points, is cut off or has another unit than metres."""
    kind = path.suffix.lower()
    if kind not in CLOUD_ENDINGS:
        raise InputError(f"{path}: clouds are read from .las, .laz, .ply or .e57: convert it")
    if not path.exists():
        raise InputError(f"{path}: no such point cloud; give a .laz, .las, .ply or .e57 file")
    regular(path, None)
    with open(path, "rb") as file:
        first = file.read(8)
    if not first.startswith(_FIRST_BYTES[kind]):
        raise InputError(f"{path}: not a readable point cloud: no {kind[1:].upper()} file by its content")
    if kind in (".las", ".laz"):
        with reading(path, "point cloud"):
            count = whole_las_header(path).point_count
        if not count:
            raise InputError(f"{path}: its header announces 0 points: give a file with points")
        las_crs(path)
    if kind == ".e57":
        _pye57(path)


def las_crs(path: Path) -> str | None:
    """ "EPSG:n" of the CRS that the header of a LAS file names, "EPSG:n+m" with heights, None if it names none.

    Raises InputError for one that is not projected in metres.
    """
    try:
        with laspy.open(path) as reader:
            crs = reader.header.parse_crs()
    except pyproj.exceptions.CRSError:
        return None
    codes = [] if crs is None else [part.to_epsg() for part in (crs.sub_crs_list if crs.is_compound else [crs])]
    if not codes or codes[0] is None:
        return None
    name = f"EPSG:{'+'.join(str(code) for code in codes if code is not None)}"
    try:
        parse_crs(name)
    except InputError as error:
        raise InputError(f"{path}: the CRS in its header cannot be used: {error}; convert the file to such a CRS, or "
                         "remove the CRS from its header if it is wrong") from None  # fmt: skip
    return name


def _checked(path: Path, read: Callable[[Path], Iterator[Points]]) -> Iterator[Points]:
    parts, seen = read(path), 0
    while True:
        with reading(path, "point cloud"):
            part = next(parts, None)
        if part is None:
            break
        lost = np.flatnonzero(~np.isfinite(part.xyz).all(axis=1))
        if len(lost):
            raise InputError(f"{path}: {len(lost)} points have no coordinates (NaN or infinite), such as point "
                             f"{seen + lost[0] + 1}: remove them")  # fmt: skip
        seen += len(part)
        yield part
    if not seen:
        raise InputError(f"{path}: it has no points: give a file with points")


def _las(path: Path) -> Iterator[Points]:
    with laspy.open(path) as reader:
        stated = "sigma_m" in set(reader.header.point_format.extra_dimension_names)
        for part in reader.chunk_iterator(_PART):
            sigma = np.asarray(part["sigma_m"], float) if stated else np.full(len(part), np.nan)
            yield Points(np.column_stack([part.x, part.y, part.z]), sigma)


def _ply(path: Path) -> Iterator[Points]:
    for rows in ply_parts(path, _PART):
        names = rows.dtype.names or ()
        sigma = rows["sigma_m"].astype(float) if "sigma_m" in names else np.full(len(rows), np.nan)
        yield Points(np.column_stack([rows[c].astype(float) for c in "xyz"]), sigma)


def _pye57(path: Path) -> Any:
    return optional("pye57", "e57", f"{path}: a file of E57", instead="; LAZ needs nothing")


def _e57(path: Path) -> Iterator[Points]:
    file = _pye57(path).E57(str(path))
    for scan in range(file.scan_count):
        found = file.read_scan(scan, ignore_missing_fields=True)
        xyz = np.column_stack([found["cartesianX"], found["cartesianY"], found["cartesianZ"]]).astype(float)
        for start in range(0, len(xyz), _PART):
            part = xyz[start : start + _PART]
            yield Points(part, np.full(len(part), np.nan))


@dataclass(frozen=True)
class Measured:
    """Points ``xyz`` (N, 3) of the world and their ``columns`` {name: (N,)}; NaN = not measured. The first column gives
    the colours: ``shown`` its values at both ends of the colour map."""

    xyz: np.ndarray
    columns: dict[str, np.ndarray]
    shown: tuple[float, float]


def write_measured(parts: Iterable[Measured], path: Path, origin: Origin | None, spacing: float) -> int:
    """Write points part by part; their number. Without a part no file is written. ``spacing`` of the points: the
    resolution if the world has no units. Raises TiegraphError when the disk is full."""
    rest = iter(parts)
    first = next(rest, None)
    if first is None:
        return 0
    cloud = replace(Cloud.empty(origin), xyz_m=first.xyz)
    header, _ = las_header(cloud, spacing, extra=[(name, "f4") for name in first.columns])
    return write_records((_records(part, header, shift_of(origin)) for part in chain([first], rest)), header, path)


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


Station = tuple[str, np.ndarray, np.ndarray, np.ndarray]
"""What an instrument measured at one place: its name, world_from_scan (4, 4), xyz (N, 3) and rgb (N, 3) u1 in the
world."""
_COLOURS = ("Red", "Green", "Blue")
_IMAGE_AXES = np.diag([1.0, -1, -1, 1])  # E57's pinhole cameras look along -z, with y up


def write_e57(
    scans: Iterable[Station], path: Path, origin: Origin | None, shown: Iterable[tuple[Pinhole, bytes, str]]
) -> int:
    """Write scans, each in its own frame with its pose in coordinates of the CRS, and what is ``shown``: the camera of
    a picture without distortion, its JPEG, the name of its scan. How many points there are. pye57 keeps single
    precision about the place of a scan. Raises EngineMissing without pye57, InputError for a full disk."""
    pye57, count, guid = _pye57(path), 0, {}
    with replacing(path) as temporary, pye57.E57(str(temporary), mode="w") as file:
        for scan, world_from_scan, xyz, rgb in scans:
            local = transforms.apply(transforms.invert(world_from_scan), xyz)  # single precision there
            columns = {f"cartesian{axis}": np.ascontiguousarray(local[:, k]) for k, axis in enumerate("XYZ")}
            columns |= {f"color{c}": np.ascontiguousarray(rgb[:, k]) for k, c in enumerate(_COLOURS)}
            ends = (("Minimum", local.min(axis=0)), ("Maximum", local.max(axis=0)))  # pye57's own are not the scan's
            box = {f"{axis}{end}": at[k] for end, at in ends for k, axis in enumerate("xyz")}
            quaternion, place = _placed(world_from_scan, origin)
            name = f"{scan} ({'no CRS' if origin is None else origin.crs})"
            header = SimpleNamespace(**box, name=name, rotation=quaternion, translation=place)
            file.write_scan_raw(columns, scan_header=header)
            guid[scan] = file.data3d[len(file.data3d) - 1]["guid"].value()
            count += len(local)
        for camera, jpeg, scan_name in shown:
            _add_picture(pye57.libe57, file, jpeg, _pinhole(camera, origin, guid.get(scan_name)))
    return count


def _placed(world_from_local: np.ndarray, origin: Origin | None) -> tuple[np.ndarray, np.ndarray]:
    """The quaternion (4,), its real part first, and the place (3,) of a frame in the CRS."""
    turn = Rotation.from_matrix(world_from_local[:3, :3]).as_quat()[[3, 0, 1, 2]]
    return turn, world_from_local[:3, 3] + shift_of(origin)


def _pinhole(camera: Pinhole, origin: Origin | None, scan: str | None) -> dict[str, Any]:
    """What E57 says of a picture. The focal length is 1, in pixels of that unit: a sensor's size is not known."""
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    quaternion, place = _placed(transforms.invert(camera.cam_from_world) @ _IMAGE_AXES, origin)
    seen = {"imageWidth": camera.size[0], "imageHeight": camera.size[1], "focalLength": 1.0, "pixelWidth": 1 / fx}
    return {
        "guid": f"{{{uuid.uuid4()}}}",
        "name": camera.name,
        "pose": {"rotation": dict(zip("wxyz", quaternion)), "translation": dict(zip("xyz", place))},
        "pinholeRepresentation": {**seen, "pixelHeight": 1 / fy, "principalPointX": cx, "principalPointY": cy},
        **({"associatedData3DGuid": scan} if scan else {}),
    }


def _add_picture(lib: Any, file: Any, jpeg: bytes, said: dict[str, Any]) -> None:
    kinds = {str: lib.StringNode, int: lib.IntegerNode, np.float64: lib.FloatNode, float: lib.FloatNode}

    def node(value: Any) -> Any:
        if not isinstance(value, dict):
            return kinds[type(value)](file.image_file, value)
        made = lib.StructureNode(file.image_file)
        for key, part in value.items():
            made.set(key, node(part))
        return made

    picture, blob = node(said), lib.BlobNode(file.image_file, len(jpeg))
    picture["pinholeRepresentation"].set("jpegImage", blob)
    file.root["images2D"].append(picture)
    blob.write(jpeg, 0, len(jpeg))
