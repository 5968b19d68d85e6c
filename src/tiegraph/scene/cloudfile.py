"""Point clouds as LAS/LAZ 1.4 (point format 7) and binary PLY, in double precision and with their CRS.

In a file coordinates are those of the CRS: world + the recorded shift. ENU and free worlds have no shift.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import laspy
import numpy as np
import pyproj

from tiegraph.errors import InputError, reading
from tiegraph.geometry.geodesy import ENU, Origin, geodetic_from_world, parse_crs
from tiegraph.scene.atomic import regular, replacing
from tiegraph.scene.results import Cloud

# Scale of a world without units, as a share of its points' spacing or, if unknown, of the first part's extent:
# 32-bit integers have 2e9 steps, and other parts may lie far from the first.
_OF_SPACING, _OF_EXTENT = 1e-2, 1e-6
_FAR = 1e5  # coordinates beyond this get an offset of their own
_EXTRA = (("sigma_m", "f4"), ("views", "u1"), ("NormalX", "f4"), ("NormalY", "f4"), ("NormalZ", "f4"))
_CHUNK = 1_000_000
_PLY_NAMES = {"nx": "NormalX", "ny": "NormalY", "nz": "NormalZ", "sigma_m": "sigma_m", "views": "views"}
_C_TYPES: dict[str, str] = dict(
    zip("char uchar short ushort int uint float double".split(), "i1 u1 i2 u2 i4 u4 f4 f8".split())
)
_PLY = [*((n, "double") for n in "xyz"), *((f"n{n}", "float") for n in "xyz")]
_PLY += [*((n, "uchar") for n in ("red", "green", "blue")), ("sigma_m", "float"), ("views", "uchar")]
_PLY_TYPES = _C_TYPES | {np.dtype(kind).name: kind for kind in _C_TYPES.values()}


def write_cloud(clouds: Cloud | Iterable[Cloud], path: Path, spacing: float | None = None) -> tuple[str, ...]:
    """Write .las, .laz or .ply by the name's ending; returns remarks.

    LAS is 1.4, point format 7; its scale is 1 mm with an origin, else by ``spacing`` of the points (units of the
    world). sigma_m, views and the normal are extra dimensions. Parts are written one after another, so an iterable of
    clouds needs the memory of one part. Raises InputError for other endings and when the disk is full.
    """
    if path.suffix.lower() == ".ply":
        return write_ply(clouds, path)
    if path.suffix.lower() not in (".las", ".laz"):
        raise InputError(f"{path}: clouds are written as .laz, .las or .ply")
    parts, first = _parts(clouds)
    header, notes = las_header(first, spacing)
    chunks = (p.where(slice(k, k + _CHUNK)) for p in chain([first], parts) for k in range(0, len(p), _CHUNK))  # type: ignore[arg-type]
    write_records((las_points(chunk, header) for chunk in chunks), header, path)
    return notes


def read_cloud(path: Path, origin: Origin | None = None) -> Cloud:
    """Read .las, .laz or .ply; columns a file lacks are grey, NaN or 0.

    ``origin`` states the wanted world: its shift is subtracted. Without it a LAS file's own CRS makes an origin, if it
    has one. Raises InputError for an unreadable file.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file")
    with reading(path, "point cloud"):
        regular(path, None)
        if path.suffix.lower() == ".ply":
            return _read_ply(path, origin)
        if path.suffix.lower() in (".las", ".laz"):
            whole_las_header(path)
            las = laspy.read(path)
            return las_cloud(las.points, las.header, origin)
    raise InputError(f"{path}: clouds are read from .laz, .las or .ply")


def write_records(records: Iterable[laspy.ScaleAwarePointRecord], header: laspy.LasHeader, path: Path) -> int:
    """Write point records one after another; their number."""
    count = 0
    with replacing(path) as temporary:
        with laspy.open(temporary, mode="w", header=header, do_compress=path.suffix.lower() == ".laz") as out:
            for record in records:
                out.write_points(record)
                count += len(record)
        undate(temporary)
    return count


def undate(path: Path) -> None:
    """Remove the date of writing from the header of a LAS file, so that equal clouds make equal files on any day.

    0 stands for no date; laspy would always state today. The two numbers (day of the year, year) are u2 from byte 90.
    """
    with open(path, "r+b") as file:
        file.seek(90)  # where the header of any LAS version has its date
        file.write(bytes(4))


def write_ply(clouds: Cloud | Iterable[Cloud], path: Path, said: str = "") -> tuple[str, ...]:
    """Write binary little-endian PLY, positions as double; CRS, shift and text ``said`` (ASCII) are in comments.

    The positions are the file's CRS coordinates. Raises TiegraphError when the disk is full."""
    parts, first = _parts(clouds)
    shift = shift_of(first.origin)
    with replacing(path) as temporary, open(temporary, "wb") as out:
        out.write(_ply_header(first.origin, 0, said))
        count = 0
        for part in chain([first], parts):
            out.write(_ply_rows(part, shift).tobytes())
            count += len(part)
        out.seek(0)
        out.write(_ply_header(first.origin, count, said))
    return () if first.origin is None or first.origin.crs != ENU else (_enu_note(first.origin),)


def _parts(clouds: Cloud | Iterable[Cloud]) -> tuple[Iterator[Cloud], Cloud]:
    parts = iter([clouds] if isinstance(clouds, Cloud) else clouds)
    first = next(parts, None)
    return parts, Cloud.empty() if first is None else first


def shift_of(origin: Origin | None) -> np.ndarray:
    """(3,) shift from the world to the coordinates of its CRS."""
    return np.zeros(3) if origin is None else np.asarray(origin.shift_m, float)


def _enu_note(origin: Origin) -> str:
    return (
        f"the cloud has no CRS: east-north-up metres about lat {origin.lat_deg:.8f}, lon {origin.lon_deg:.8f}, "
        f"height {origin.height_m:.3f} m (WGS84)"
    )


def las_header(
    first: Cloud, spacing: float | None, said: str = "", extra: Sequence[tuple[str, str]] = _EXTRA
) -> tuple[laspy.LasHeader, tuple[str, ...]]:
    """Header of LAS 1.4 for clouds such as the first part, and remarks; see ``write_cloud``. The text ``said`` (ASCII)
    is in the standard's text record. ``extra``: names and types of the extra dimensions."""
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.generating_software = "tiegraph"
    if said:
        header.vlrs.append(laspy.VLR("LASF_Spec", 3, "text area", said.encode("ascii") + b"\0"))
    header.add_extra_dims([laspy.ExtraBytesParams(name, kind) for name, kind in extra])
    # State no minimum and no maximum of the extra dimensions: laspy marks them as stated, but has NaN there if one
    # point has it, and the largest and smallest numbers if no point went through its writer
    for record in header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs:
        record.options &= ~(record.MIN_BIT_MASK | record.MAX_BIT_MASK)
    offset = shift_of(first.origin)
    middle = first.xyz_m.mean(axis=0) if len(first) else np.zeros(3)
    header.offsets = offset + np.where(np.abs(middle) > _FAR, np.round(middle), 0)
    header.scales = np.full(3, 0.001)  # a millimetre
    if first.origin is None:
        extent = float(np.ptp(first.xyz_m, axis=0).max()) if len(first) else 1.0
        step = spacing * _OF_SPACING if spacing else max(extent, 1e-9) * _OF_EXTENT
        header.scales = np.full(3, 10.0 ** np.clip(np.floor(np.log10(step)), -12, -3))
        return header, ("the cloud has no CRS: the model's own frame and scale",)
    if first.origin.crs == ENU:
        return header, (_enu_note(first.origin),)
    header.add_crs(parse_crs(first.origin.crs), keep_compatibility=True)
    return header, (f"{first.origin.crs}; heights are above the WGS84 ellipsoid",)


def las_points(cloud: Cloud, header: laspy.LasHeader) -> laspy.ScaleAwarePointRecord:
    """Point records of a cloud."""
    record = laspy.ScaleAwarePointRecord.zeros(len(cloud), header=header)
    record.x, record.y, record.z = (cloud.xyz_m + shift_of(cloud.origin)).T
    record.red, record.green, record.blue = (cloud.rgb.astype(np.uint16) * 257).T
    record["sigma_m"], record["views"] = cloud.sigma_m, cloud.views
    for k, name in enumerate(("NormalX", "NormalY", "NormalZ")):
        record[name] = cloud.normal[:, k]
    record["return_number"] = record["number_of_returns"] = np.ones(len(cloud), np.uint8)
    return record


def whole_las_header(path: Path) -> laspy.LasHeader:
    """Header of a LAS file. Raises InputError for one that is shorter than it announces (laspy reads the rest)."""
    with laspy.open(path) as reader:
        header = reader.header
    there = path.stat().st_size - header.offset_to_point_data
    if not header.are_points_compressed and header.point_count * header.point_format.size > there:
        raise InputError(
            f"{path} is cut off: its header announces {header.point_count} points, and {there} bytes follow it"
        )
    return header


def las_cloud(points: laspy.ScaleAwarePointRecord, header: laspy.LasHeader, origin: Origin | None) -> Cloud:
    """The cloud of point records; see ``read_cloud``."""
    xyz = np.stack([np.asarray(points.x), np.asarray(points.y), np.asarray(points.z)], axis=1).astype(float)
    names = set(points.point_format.dimension_names)
    rgb = np.full((len(xyz), 3), 128, np.uint8)
    if {"red", "green", "blue"} <= names:
        wide = np.stack([np.asarray(points[c]) for c in ("red", "green", "blue")], axis=1)
        rgb = (wide >> 8 if wide.size and wide.max() > 255 else wide).astype(np.uint8)
    columns: dict[str, Any] = {name: np.asarray(points[name]) for name, _ in _EXTRA if name in names}
    if origin is None:
        origin = _origin_of(header, xyz)
    return _cloud(xyz, rgb, columns, origin)


def _cloud(xyz: np.ndarray, rgb: np.ndarray, columns: dict[str, np.ndarray], origin: Origin | None) -> Cloud:
    missing = np.full(len(xyz), np.nan, np.float32)
    normal = [columns.get(name, missing) for name in ("NormalX", "NormalY", "NormalZ")]
    return Cloud(
        xyz_m=xyz - shift_of(origin),
        rgb=rgb,
        normal=np.stack(normal, axis=1).astype(np.float32),
        sigma_m=columns.get("sigma_m", missing).astype(np.float32),
        views=columns.get("views", np.zeros(len(xyz), np.uint8)).astype(np.uint8),
        origin=origin,
    )


def _origin_of(header: laspy.LasHeader, xyz: np.ndarray) -> Origin | None:
    """The origin that a LAS file states: its CRS, if projected and metric, and its offsets as the shift."""
    try:
        crs = header.parse_crs(prefer_wkt=True)
    except pyproj.exceptions.CRSError:
        return None
    if crs is not None and crs.is_compound:
        crs = crs.sub_crs_list[0]
    authority = None if crs is None else crs.to_authority(min_confidence=70)
    if authority is None or len(xyz) == 0:
        return None
    name = ":".join(authority)
    try:
        parse_crs(name)
    except InputError:
        return None
    shift = tuple(float(s) for s in header.offsets)
    draft = Origin(lat_deg=0.0, lon_deg=0.0, height_m=0.0, crs=name, shift_m=(shift[0], shift[1], shift[2]))
    lat, lon, height = geodetic_from_world(np.zeros((1, 3)), draft)[0]
    return Origin(lat_deg=float(lat), lon_deg=float(lon), height_m=float(height), crs=name, shift_m=draft.shift_m)


def _ply_header(origin: Origin | None, count: int, said: str) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", "comment tiegraph"]
    lines += [f"comment {said}"] if said else []
    if origin is None:
        lines.append("comment crs none (the model's own frame and scale)")
    else:
        lines.append(f"comment crs {origin.crs}")
        lines.append(f"comment origin_lat_lon_height {origin.lat_deg!r} {origin.lon_deg!r} {origin.height_m!r}")
        lines.append("comment shift_m {!r} {!r} {!r} (added in this file)".format(*origin.shift_m))
    # The count is known at the end only: padded, so that the header keeps its length.
    lines.append(f"element vertex {count:<15d}")
    lines += [f"property {kind} {name}" for name, kind in _PLY]
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")


def _ply_rows(cloud: Cloud, shift: np.ndarray) -> np.ndarray:
    rows = np.zeros(len(cloud), dtype=[(name, f"<{_C_TYPES[kind]}") for name, kind in _PLY])
    for k, name in enumerate("xyz"):
        rows[name] = cloud.xyz_m[:, k] + shift[k]
        rows[f"n{name}"] = cloud.normal[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        rows[name] = cloud.rgb[:, k]
    rows["sigma_m"], rows["views"] = cloud.sigma_m, cloud.views
    return rows


def _read_ply(path: Path, origin: Origin | None) -> Cloud:
    with open(path, "rb") as file:
        header = _read_ply_header(file, path)
        rows = np.concatenate(list(_ply_rows_of(file, path, header, max(header.count, 1))))
    xyz = np.stack([rows[c].astype(float) for c in "xyz"], axis=1)
    names = rows.dtype.names or ()
    rgb = np.full((len(rows), 3), 128, np.uint8)
    if {"red", "green", "blue"} <= set(names):
        rgb = np.stack([rows[c] for c in ("red", "green", "blue")], axis=1).astype(np.uint8)
    columns = {new: rows[old] for old, new in _PLY_NAMES.items() if old in names}
    return _cloud(xyz, rgb, columns, origin if origin is not None else header.origin)


@dataclass(frozen=True)
class _PlyHeader:
    """Format, number of vertices, their (name, type), origin from our own comments."""

    kind: str
    count: int
    properties: list[tuple[str, str]]
    origin: Origin | None


def _read_ply_header(file: BinaryIO, path: Path) -> _PlyHeader:
    if file.readline().strip() != b"ply":
        raise InputError(f"{path} is not a PLY file: it does not begin with 'ply'")
    kind, count, element = "", 0, ""
    properties: list[tuple[str, str]] = []
    comments: dict[str, list[str]] = {}
    for raw in file:
        words = raw.decode("ascii", "replace").split()
        if words == ["end_header"]:
            break
        if words[:1] == ["format"]:
            kind = words[1]
        elif words[:1] == ["element"]:
            if words[1] == "vertex":
                count = int(words[2])
            elif not properties:
                raise InputError(f"{path}: element {words[1]!r} precedes the vertices; save the points alone")
            element = words[1]
        elif words[:1] == ["property"] and element == "vertex":
            if words[1] == "list" or words[1] not in _PLY_TYPES:
                raise InputError(f"{path}: property type {words[1]!r} of a vertex is not a plain number")
            properties.append((words[2], _PLY_TYPES[words[1]]))
        elif words[:1] == ["comment"] and len(words) > 2:
            comments[words[1]] = words[2:]
    if not {"x", "y", "z"} <= {name for name, _ in properties}:
        raise InputError(f"{path}: its vertices have no x, y, z")
    return _PlyHeader(kind=kind, count=count, properties=properties, origin=_ply_origin(comments))


def _ply_origin(comments: dict[str, list[str]]) -> Origin | None:
    try:
        lat, lon, height = (float(w) for w in comments["origin_lat_lon_height"][:3])
        east, north, up = (float(w) for w in comments["shift_m"][:3])
        return Origin(lat_deg=lat, lon_deg=lon, height_m=height, crs=comments["crs"][0], shift_m=(east, north, up))
    except (KeyError, ValueError, IndexError):
        return None


def ply_parts(path: Path, most: int) -> Iterator[np.ndarray]:
    """The vertices of a PLY file, at most ``most`` at a time, as records with x, y, z. Raises InputError."""
    with open(path, "rb") as file:
        yield from _ply_rows_of(file, path, _read_ply_header(file, path), most)


def _ply_rows_of(file: BinaryIO, path: Path, header: _PlyHeader, most: int) -> Iterator[np.ndarray]:
    """The vertices in parts; at least one part, perhaps empty."""
    kind, count, properties = header.kind, header.count, header.properties
    order = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}.get(kind)
    if order is None:
        raise InputError(f"{path}: unknown PLY format {kind!r}")
    dtype = np.dtype([(name, order + code) for name, code in properties])
    least = 2 * len(properties) - 1 if kind == "ascii" else dtype.itemsize  # bytes of a point
    there = path.stat().st_size - file.tell()
    if not 0 <= count * least <= there:
        raise InputError(f"{path} is cut off: its header announces {count} points, and {there} bytes follow it")
    for start in range(0, max(count, 1), most):
        wanted = min(most, count - start)
        if kind == "ascii":
            table = np.loadtxt(file, max_rows=wanted, ndmin=2) if wanted else np.zeros((0, len(properties)))
            rows = np.zeros(len(table), dtype)
            for k, (name, _) in enumerate(properties):
                rows[name] = table[:, k]
        else:
            data = file.read(wanted * dtype.itemsize)
            rows = np.frombuffer(data[: len(data) // dtype.itemsize * dtype.itemsize], dtype)
        if len(rows) != wanted:
            raise InputError(f"{path} is cut off: {start + len(rows)} of {count} points")
        yield rows
