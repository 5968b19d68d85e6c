"""Cloud Optimized Point Clouds: a LAZ file whose chunks are the nodes of an octree (COPC 1.0, copc.io)."""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import laspy
import lazrs
import numpy as np

from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.atomic import replacing
from tiegraph.scene.cloudfile import las_cloud, las_header, las_points, shift_of, undate
from tiegraph.scene.results import Cloud
from tiegraph.scene.sorting import order_of, row_numbers, run_starts

_CELLS = 128  # cells along the edge of a node, each with at most one point: a surface fills some 16 000
_INFO = struct.Struct("<5d2Q2d88x")
_ENTRY = np.dtype([("key", "<i4", 4), ("offset", "<u8"), ("bytes", "<i4"), ("points", "<i4")])
_EVLR = struct.Struct("<H16sHQ32s")


@dataclass(frozen=True)
class _Octree:
    """The root cube in the file's coordinates, and the level at which all remaining points are kept."""

    low: np.ndarray  # (3,)
    side: float
    depth: int

    def keys(self, xyz: np.ndarray) -> np.ndarray:
        """(4, N) level, x, y, z of the node of each point: the coarsest with a free cell."""
        finest = max(self.depth, 1) - 1
        where = np.clip((xyz.T - self.low[:, None]) / self.side, 0, 1 - 1e-12)
        cells = (where * (_CELLS << finest)).astype(np.int64)
        level = np.full(len(xyz), self.depth)
        rest = np.random.default_rng(0).permutation(len(xyz))
        for k in range(self.depth):
            cell = row_numbers(np.take(cells, rest, axis=1) >> (finest - k)) if len(rest) else rest
            order = order_of(cell)
            first = order[run_starts(cell[order])]
            level[rest[first]] = k
            free = np.ones(len(rest), bool)
            free[first] = False
            rest = rest[free]
        return np.vstack([level, (where * (1 << level)).astype(np.int64)]).astype(np.int32)


@dataclass(frozen=True)
class _Spill:
    """Point records sorted by node within each part, in one file, and the place of each node's and part's run."""

    rows: np.ndarray  # memory map of records
    keys: np.ndarray  # (S, 4) node of each run
    start: np.ndarray
    count: np.ndarray


def write_copc(
    parts: Callable[[], Iterator[Cloud]], path: Path, spacing: float, scratch: Path, said: str = ""
) -> tuple[str, ...]:
    """Write a cloud as COPC: any reader of LAZ 1.4 reads it, viewers show it without loading all of it.

    ``parts()`` gives the cloud part by part, each time it is called; ``spacing`` of the points (units of the world)
    sets the depth of the octree. Memory is that of one part and a batch of nodes; the folder ``scratch`` has a second
    copy of the records meanwhile; ``said`` (ASCII) is text of the header. Returns remarks as ``write_cloud``.
    Raises TiegraphError for a full disk.
    """
    first, low, high = _extent(parts())
    header, notes = las_header(first, spacing, said)
    if not np.isfinite(low).all():
        low, high = np.zeros(3), np.ones(3)
    low, high = (v + shift_of(first.origin) for v in (low, high))
    side = float(max((high - low).max(), _CELLS * spacing)) * (1 + 1e-6)
    depth = int(np.clip(np.ceil(np.log2(side / _CELLS / spacing)), 0, 13))  # 128 cells x 2^13 in 21 bits a coordinate
    tree = _Octree((low + high) / 2 - side / 2, side, depth)
    records = scratch / "records"
    try:
        with replacing(path) as temporary:
            spill = _spilled(parts(), tree, header, records)
            with open(temporary, "w+b") as out:
                _write(out, header, tree, spill, low, high)
            undate(temporary)
    finally:
        records.unlink(missing_ok=True)
    return notes


def _extent(parts: Iterator[Cloud]) -> tuple[Cloud, np.ndarray, np.ndarray]:
    """The first part of a cloud, and the corners (3,) of all, infinite where there are no points."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    first: Cloud | None = None
    for part in parts:
        first = part if first is None else first
        if len(part):
            low, high = np.minimum(low, part.xyz_m.min(axis=0)), np.maximum(high, part.xyz_m.max(axis=0))
    return Cloud.empty() if first is None else first, low, high


def _spilled(parts: Iterator[Cloud], tree: _Octree, header: laspy.LasHeader, path: Path) -> _Spill:
    keys, start, count, done = [np.zeros((0, 4), np.int32)], [np.zeros(0, int)], [np.zeros(0, int)], 0
    dtype = header.point_format.dtype()
    with open(path, "wb") as out:
        for part in parts:
            record = las_points(part, header)
            node = tree.keys(np.column_stack([record.x, record.y, record.z]))
            numbers = row_numbers(node) if len(part) else np.zeros(0, int)
            order = order_of(numbers)
            begin = run_starts(numbers[order])
            out.write(np.take(record.array, order).tobytes())
            keys.append(node[:, order[begin]].T)
            start.append(begin + done)
            count.append(np.diff(begin, append=len(order)))
            done += len(order)
    rows = np.memmap(path, dtype, "r", shape=(done,)) if done else np.zeros(0, dtype)
    return _Spill(rows=rows, keys=np.concatenate(keys), start=np.concatenate(start), count=np.concatenate(count))


def _write(
    out: BinaryIO, header: laspy.LasHeader, tree: _Octree, spill: _Spill, low: np.ndarray, high: np.ndarray
) -> None:
    laz = lazrs.LazVlr.new_for_compression(header.point_format.id, header.point_format.num_extra_bytes, True)
    info = laspy.VLR("copc", 1, "COPC info VLR", bytes(_INFO.size))  # first, by the standard
    header.vlrs.insert(0, info)
    header.vlrs.append(laspy.VLR("laszip encoded", 22204, "lazperf variant", bytes(laz.record_data())))
    header.are_points_compressed = True
    header.point_count = len(spill.rows)
    header.number_of_points_by_return[0] = len(spill.rows)
    header.mins, header.maxs = low, high
    header.write_to(out)
    keys = _compressed(out, laz, spill, header.point_format.size)
    entries = np.zeros(len(keys), _ENTRY)  # the hierarchy: the place of each node's chunk, by LAZ's chunk table
    if len(keys):
        first = header.offset_to_point_data
        out.seek(first)
        table = np.array(lazrs.read_chunk_table(out, laz), np.int64).reshape(-1, 2)
        entries["key"], entries["points"], entries["bytes"] = keys, table[:, 0], table[:, 1]
        entries["offset"] = first + 8 + np.r_[0, np.cumsum(table[:-1, 1])]  # 8: where the chunk table is
    out.seek(0, 2)
    header.start_of_first_evlr, header.number_of_evlrs = out.tell(), 1
    out.write(_EVLR.pack(0, b"copc", 1000, entries.nbytes, b"EPT hierarchy"))
    where = out.tell()
    out.write(entries.tobytes())
    centre, half = tree.low + tree.side / 2, tree.side / 2
    info.record_data = _INFO.pack(*centre, half, tree.side / _CELLS, where, entries.nbytes, 0.0, 0.0)
    out.seek(0)
    header.write_to(out, ensure_same_size=True)


def _compressed(out: BinaryIO, laz: lazrs.LazVlr, spill: _Spill, size: int) -> np.ndarray:
    """Write each node as a chunk, coarse ones first; (K, 4) the nodes in their order."""
    compressor = lazrs.ParLasZipCompressor(out, laz)
    compressor.reserve_offset_to_chunk_table()
    node = row_numbers(spill.keys.T) if len(spill.keys) else np.zeros(0, int)
    order = order_of(node)
    begin = run_starts(node[order])
    held: list[bytes] = []
    points = 0
    for first, last in zip(begin, np.r_[begin[1:], len(order)]):
        runs = [spill.rows[spill.start[r] : spill.start[r] + spill.count[r]].tobytes() for r in order[first:last]]
        held.append(b"".join(runs))
        points += len(held[-1]) // size
        if points > 2_000_000:  # points compressed at once
            compressor.compress_chunks(held)
            held, points = [], 0
    if held:
        compressor.compress_chunks(held)
    compressor.done()
    return spill.keys[order[begin]]


def copc_box(path: Path, origin: Origin | None, low: np.ndarray, high: np.ndarray) -> Cloud:
    """The points of a COPC file in the box between two corners (3,) of the world about ``origin``; only the nodes that
    touch it are read."""
    shift = shift_of(origin)
    with laspy.CopcReader.open(path) as reader:
        first, last = (np.asarray(v) for v in (reader.header.mins, reader.header.maxs))
        corners = np.clip(low + shift, first, last), np.clip(high + shift, first, last)  # far ones overflow their type
        points = reader.query(bounds=laspy.copc.Bounds(mins=corners[0], maxs=corners[1]))
        cloud = las_cloud(points, reader.header, origin)
    return cloud.where(np.all((cloud.xyz_m >= low) & (cloud.xyz_m <= high), axis=1))


def copc_sample(path: Path, origin: Origin | None, most: int) -> Cloud:
    """About ``most`` of the points of a COPC file, each with the same probability; all are read, part by part."""
    with laspy.open(path) as reader:
        step = max(1, reader.header.point_count // most)
        parts = [p[:: min(step, len(p))] for p in reader.chunk_iterator(1_000_000)]
        return Cloud.concatenate([las_cloud(p, reader.header, origin) for p in parts]) if parts else Cloud.empty(origin)


@dataclass(frozen=True, eq=False)
class Node:
    """A node of a COPC file: level, x, y, z (``key``), the ``spacing`` of its points in units of the world, and these,
    which its parents do not have."""

    key: tuple[int, int, int, int]
    spacing: float
    cloud: Cloud


def copc_nodes(path: Path, origin: Origin | None) -> Iterator[Node]:
    """The nodes of a COPC file that ``write_copc`` wrote, coarse ones first, in a world about ``origin``; memory is
    that of one node. Raises ValueError where nodes are missing."""
    with laspy.CopcReader.open(path) as reader:
        spacing = reader.copc_info.spacing
        entries = sorted(reader.root_page.entries.values(), key=lambda entry: entry.offset)
    with laspy.open(path) as reader:
        named, count = sum(entry.point_count for entry in entries), reader.header.point_count
        if named != count:
            raise ValueError(f"its octree names {named} of {count} points")
        for entry in entries:
            level, *place = (int(getattr(entry.key, name)) for name in ("level", "x", "y", "z"))
            cloud = las_cloud(reader.read_points(entry.point_count), reader.header, origin)
            yield Node((level, *place), spacing / 2**level, cloud)  # type: ignore[arg-type]


def copc_middle(path: Path, origin: Origin | None) -> np.ndarray:
    """(3,) the middle of a COPC file's points in a world about ``origin``."""
    with laspy.open(path) as reader:
        return (np.asarray(reader.header.mins) + reader.header.maxs) / 2 - shift_of(origin)
