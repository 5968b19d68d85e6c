"""The matcher's kernels on a GPU (``kernels/*.cu``) by CuPy: the functions of the native module ``_sgm`` on arrays
that stay on the device, equal to it bit for bit. Used where CuPy and a GPU are there (``pip install
'tiegraph[cuda12]'``).

Nothing here touches the device before ``matcher()`` is called: a process that has done so must not be forked.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from tiegraph.dense._sgm import Options, RangeRules

_log = logging.getLogger(__name__)

Array = Any  # of the device (CuPy's classes have no types)

_KERNELS = Path(__file__).parent / "kernels"
_PARTS = ("common", "levels", "costs", "paths", "winners", "launched")  # in the order they are compiled
_THREADS = 128
_SHARED_BYTES = 48 << 10  # of shared memory that every GPU gives a block without being asked
_GUARDS = 64  # bytes around the path costs of a pixel
_GROUPS = (1, 2, 4, 8, 16, 32)  # lanes that work on a pixel together
_WORD = 4  # disparities of a lane where costs are made; elsewhere it has a block
_CENSUS_ROWS = 8  # of a warp, as in costs.cu
# Lanes and words of the kernels for one range.
_DENSE = ((4, 1), (4, 2), (8, 2), (16, 2), (32, 2), (32, 4), (32, 8), (32, 16))
_BLOCK = 16  # disparities of a block
_MAX_BLOCKS = 255
_PATHS = 8
_CELL_BYTES = 1 + _PATHS  # a matching cost, and what each path adds to it
_PIXEL_BYTES = 64  # everything else that a match holds
_LARGEST_COST = 127  # with 127 of a path it fits a byte

Strips = list[tuple[slice, slice]]  # rows matched together, and which of them count


def joined(parts: list[Array]) -> Array:
    """Rows of NumPy or of the device, one part after another."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


@lru_cache(maxsize=1)
def _found() -> tuple[Matcher | None, str]:
    """(this process's GPU, what is missing)."""
    if find_spec("cupy") is None:
        return None, "CuPy is not installed (pip install 'tiegraph[cuda12]' or 'tiegraph[cuda13]', by the driver)"
    try:
        import cupy

        if cupy.cuda.runtime.getDeviceCount() < 1:
            return None, "there is none"
        device = Matcher(cupy)
        device.halve(device.upload(np.zeros((2, 2), np.uint8)))  # compiles
        return device, ""
    except Exception as error:  # drivers, compilers and libraries fail in ways of their own
        said = f"{type(error).__name__}: {str(error).strip().splitlines()[0] if str(error).strip() else ''}"
        _log.warning("the GPU is not used: %s", said)
        return None, said


def matcher() -> Matcher | None:
    """The matcher of this process's GPU; None where there is none that works, with a warning where CuPy is there."""
    return _found()[0]


def reason() -> str:
    """Why there is none, in words for a user."""
    return _found()[1]


def device_name() -> str | None:
    """The name of the GPU that matches; None without."""
    device = matcher()
    return None if device is None else device.xp.cuda.runtime.getDeviceProperties(0)["name"].decode()


class Matcher:
    """``halve``, ``ranges``, ``joint_greys``, ``match_dense`` and ``match_ragged`` of ``_sgm`` on device arrays.

    ``xp`` is CuPy, or what stands in for it in tests. All functions raise MemoryError where the device has too little.
    """

    def __init__(self, xp: Any) -> None:
        self.xp = xp
        source = "\n".join((_KERNELS / f"{part}.cu").read_text(encoding="utf-8") for part in _PARTS)
        self._module = xp.RawModule(code=source, options=("--std=c++14", "--fmad=false"))

    def upload(self, array: np.ndarray) -> Array:
        """A device array of the same values."""
        return self.xp.asarray(np.ascontiguousarray(array))

    def download(self, array: Array) -> np.ndarray:
        """The values of a device array."""
        return self.xp.asnumpy(array)

    def release(self) -> None:
        """Give the memory kept for the next pair back to the device."""
        self.xp.get_default_memory_pool().free_all_blocks()

    def halve(self, image: Array) -> Array:
        """Means (ceil(h / 2), ceil(w / 2)) u1 of 2 x 2 pixels."""
        height, width = image.shape
        out = self.xp.empty(((height + 1) // 2, (width + 1) // 2), np.uint8)
        self._run("halve", out.size, image, np.int32(width), np.int32(height), out)
        return out

    def joint_greys(self, left: Array, right: Array, disparity: Array) -> np.ndarray:
        """How often (256, 256) u4, not on the device, a left and a right grey value lie upon each other."""
        counts = self.xp.zeros((256, 256), np.uint32)
        height, width = left.shape
        sizes = np.int32(width), np.int32(height), np.int32(right.shape[1])
        self._run("joint_greys", left.size, left, right, disparity, *sizes, counts)
        return self.download(counts)

    def ranges(self, coarse: Array, width: int, height: int, rules: RangeRules) -> tuple[Array, Array]:
        """First disparity (h, w) i2 and blocks of 16 (h, w) u1 of each pixel."""
        if not 1 <= rules.count <= _BLOCK * _MAX_BLOCKS:
            raise ValueError(f"1 to {_BLOCK * _MAX_BLOCKS} disparities")
        xp, (h, w) = self.xp, coarse.shape
        sizes = [(h, w)]
        while sizes[-1] != (1, 1) or len(sizes) < 3:
            sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
        cells = sum(a * b for a, b in sizes)
        grids = (*(xp.empty(cells, np.int16) for _ in range(2)), *(xp.empty(cells, np.float32) for _ in range(2)))
        self._run("base_grid", h * w, coarse, np.uint64(h * w), *grids)
        start = 0
        for (a, b), (c, d) in zip(sizes, sizes[1:]):
            self._run("half_grid", c * d, *grids, np.uint64(start), np.int32(b), np.int32(a))
            start += a * b
        near: tuple[Array, ...] = grids[:2]
        for down in (0, 1):
            out = xp.empty((h, w), np.int16), xp.empty((h, w), np.int16)
            self._run("spread", h * w, *near, np.int32(w), np.int32(h), np.int32(rules.reach), np.int32(down), *out)
            near = out
        first, blocks = xp.empty((height, width), np.int16), xp.empty((height, width), np.uint8)
        numbers = (width, height, rules.low, rules.count, rules.margin, rules.hole_limit)
        self._run("find_ranges", h * w, *near, *grids, *(np.int32(n) for n in numbers), first, blocks)
        return first, blocks

    def row_blocks(self, blocks: Array) -> tuple[np.ndarray, np.ndarray]:
        """(h,) blocks of each row of ``blocks`` (h, w) u1, and of its pixel that has most; not on the device."""
        height, width = blocks.shape
        rows = self.xp.empty((2, height), np.uint32)
        self._run("row_blocks", 32 * height, blocks, *_ints(width, height), rows[0], rows[1])
        sums, most = self.download(rows).astype(np.int64)
        return sums, most

    def match_dense(
        self,
        left: Array,
        right: Array,
        span: tuple[int, int],
        options: Options,
        mutual: np.ndarray | None,
        strips: Strips,
    ) -> Array:
        """Disparity (h, w) f4, NaN = none, over one range for all pixels: ``span`` = (lowest, number)."""
        group, words = next(d for d in _DENSE if 4 * d[0] * d[1] >= span[1])
        padded = -(-span[1] // max(_BLOCK, 4 * words)) * max(_BLOCK, 4 * words)
        width = left.shape[1]

        def match(batch: Strips) -> Array:
            job = _Job(self, left, right, batch, options, mutual)
            ranges = (np.uint64(0), *_ints(*span, padded, width, job.height))
            job.cost(ranges, job.height * width * padded, padded)
            walk = job.left, job.table, *ranges, job.bounds, *_ints(len(batch), options.small)
            job.walk(f"dense_paths_{group}_{words}", group, _THREADS, 0, walk)
            return job.finished(ranges, padded)

        return self._in_batches(match, strips, np.full(left.shape[0], width * padded), width)

    def match_ragged(
        self,
        left: Array,
        right: Array,
        ranges: tuple[Array, Array],
        options: Options,
        mutual: np.ndarray | None,
        strips: Strips,
    ) -> Array:
        """The same with a range for each pixel: ``ranges`` = (first disparities, blocks of 16)."""
        first, blocks = ranges
        width = left.shape[1]
        sums, largest = self.row_blocks(blocks)
        most = _BLOCK * int(largest.max())

        def match(batch: Strips) -> Array:
            job = _Job(self, left, right, batch, options, mutual)
            starts = np.concatenate([[0], np.cumsum(self._rows(sums, batch))])
            pixels = self.xp.empty((job.height, width), np.uint64)
            own = self._rows(first, batch), self._rows(blocks, batch), self.upload(starts[:-1].astype(np.uint32))
            self._run("lay_out", 32 * job.height, job.left, *own, *_ints(width, job.height), pixels)
            here = (pixels, *_ints(0, 0, 0, width, job.height))
            mean = _BLOCK * starts[-1] / pixels.size
            job.cost(here, _BLOCK * int(starts[-1]), mean)
            group, threads, pitch = _shared(_group(mean / _BLOCK), most + _GUARDS)
            shared = threads // group * 2 * pitch
            walk = job.table, *here, job.bounds, *_ints(len(batch), options.small, pitch)
            job.walk(f"ragged_paths_{group}", group, threads, shared, walk)
            return job.finished(here, mean)

        return self._in_batches(match, strips, _BLOCK * sums, width)

    def _rows(self, array: Array, batch: Strips) -> Array:
        """The rows of strips, one strip after another."""
        return joined([array[outer] for outer, _ in batch])

    def _in_batches(self, match: Callable[[Strips], Array], strips: Strips, cells: np.ndarray, width: int) -> Array:
        """The rows that count, of as many strips at a time as the device has room for; ``cells`` (h,) of each row."""
        room, batches, used = self._room(), list[Strips](), 0
        for strip in strips:
            needs = _CELL_BYTES * int(cells[strip[0]].sum()) + _PIXEL_BYTES * width * (strip[0].stop - strip[0].start)
            if not batches or used + needs > room:
                batches.append([])
                used = 0
            batches[-1].append(strip)
            used += needs
        parts = []
        for batch in batches:
            found, begin = match(batch), 0
            for outer, inner in batch:
                parts.append(found[begin + inner.start : begin + inner.stop])
                begin += outer.stop - outer.start
        return joined(parts)

    def _room(self) -> int:
        """Bytes of the device that are free, or kept by this process for its next pair."""
        return self.xp.cuda.runtime.memGetInfo()[0] + self.xp.get_default_memory_pool().free_bytes()

    def _run(self, name: str, threads: int, *arguments: Any, shared: int = 0) -> None:
        kernel: Callable[..., None] = self._module.get_function(name)
        kernel((-(-threads // _THREADS),), (_THREADS,), arguments, shared_mem=shared)


class _Job:
    """One launch after another for some strips of a pair."""

    def __init__(
        self, device: Matcher, left: Array, right: Array, batch: Strips, options: Options, mutual: np.ndarray | None
    ) -> None:
        self.device, self.xp, self.options = device, device.xp, options
        self.left, self.right = (device._rows(image, batch) for image in (left, right))
        heights = [outer.stop - outer.start for outer, _ in batch]
        self.height, self.strips = sum(heights), len(batch)
        self.bounds = device.upload(np.concatenate([[0], np.cumsum(heights)]).astype(np.int32))
        self.table = device.upload(np.array(options.large_by_step or [options.large] * 16, np.uint8))
        if mutual is not None and mutual.max() > _LARGEST_COST:
            raise ValueError(f"costs of mutual information go up to {_LARGEST_COST}")
        self.mutual = np.uint64(0) if mutual is None else device.upload(mutual)

    def cost(self, ranges: tuple[Any, ...], cells: int, mean: float) -> None:
        """The matching costs of all disparities."""
        rx, ry = self.options.radius_x, self.options.radius_y
        bits = [self._census(image, rx, ry) for image in (self.left, self.right)]
        outside = ((2 * rx + 1) * (2 * ry + 1) - 1) * 2 // 3
        tail = _ints(self.right.shape[1], self.options.mode, outside)
        self.volume, self.cells, group = self.xp.empty(cells, np.uint8), cells, _group(mean / _WORD)
        images = *bits, self.left, self.right, self.mutual
        self.device._run(f"costs_{group}", group * self.left.size, *images, *ranges, *tail, self.volume)

    def _census(self, image: Array, rx: int, ry: int) -> Array:
        height, width = image.shape
        out = self.xp.empty(image.shape, np.uint64)
        warps = -(-width // 32) * -(-height // _CENSUS_ROWS)
        shared = _THREADS // 32 * (32 + 2 * rx) * (_CENSUS_ROWS + 2 * ry)
        arguments = image, *_ints(width, height), self.bounds, *_ints(rx, ry), out
        self.device._run("census", 32 * warps, *arguments, shared=shared)
        return out

    def walk(self, name: str, group: int, threads: int, shared: int, arguments: tuple[Any, ...]) -> None:
        """All eight paths of every pixel."""
        each = 32 // group
        warps = max(-(-self.height // each), self.strips * -(-self.left.shape[1] // each))
        self.parts = self.xp.empty(_PATHS * self.cells, np.uint8)
        kernel = self.device._module.get_function(name)
        arguments = self.volume, *arguments, np.uint64(self.cells), self.parts
        kernel((-(-32 * warps // threads), _PATHS), (threads,), arguments, shared_mem=shared)

    def finished(self, ranges: tuple[Any, ...], mean: float) -> Array:
        """Disparities (h, w) f4 of all rows."""
        xp, options, right_width, group = self.xp, self.options, self.right.shape[1], _group(mean / _BLOCK)
        best, around = xp.empty(self.left.shape, np.int16), xp.empty((3, *self.left.shape), np.uint16)
        right_best = xp.full(self.right.shape, 0xFFFFFFFF, np.uint32)
        tail = np.uint64(self.cells), *_ints(right_width, options.uniqueness), best, around, right_best
        self.device._run(f"winners_{group}", group * self.left.size, self.volume, self.parts, *ranges, *tail)
        disparity = xp.empty(self.left.shape, np.float32)
        tail = _ints(*self.left.shape[::-1], right_width, options.left_right, options.parabola)
        self.device._run("finish", self.left.size, best, around, right_best, *tail, disparity)
        return disparity


def _ints(*numbers: int) -> tuple[np.int32, ...]:
    return tuple(np.int32(n) for n in numbers)


def _group(mean: float) -> int:
    """Lanes for a pixel that has work for ``mean`` of them."""
    return next((g for g in _GROUPS if g >= mean), _GROUPS[-1])


def _shared(group: int, pitch: int) -> tuple[int, int, int]:
    """(lanes for a path, threads of a block, bytes for the path costs of a pixel, at least ``pitch``): two pixels a
    path fit into shared memory, and the paths of a warp begin in different banks of it."""
    for lanes in (g for g in _GROUPS if g >= group):
        own = pitch + (8 * lanes - pitch) % 64 // 16 * 16
        warps = min(_THREADS // 32, _SHARED_BYTES // (2 * (32 // lanes) * own))
        if warps:
            return lanes, 32 * warps, own
    raise MemoryError(f"no room for {pitch} disparities of a pixel")
