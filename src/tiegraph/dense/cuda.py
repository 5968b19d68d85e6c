"""The matcher's kernels on a GPU (``tsgm.cu``) by CuPy: the functions of the native module ``_sgm`` on arrays that stay
on the device, equal to it bit for bit. Used where CuPy and a GPU are there (``pip install 'tiegraph[cuda12]'``).

Nothing here touches the device before ``matcher()`` is called: a process that has done so must not be forked.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import lru_cache
from importlib import resources
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from tiegraph.dense._sgm import Options, RangeRules

_log = logging.getLogger(__name__)

Array = Any  # of the device, (CuPy's classes have no types)

_THREADS = 128
_SHARED_BYTES = 48 << 10  # of shared memory that every GPU gives a block without being asked
_GUARDS = 16  # bytes around the path costs of a pixel
_GROUPS = (4, 8, 16, 32)  # lanes that walk a path together, four disparities each
_BLOCK = 16  # disparities of a block
_MAX_DISPARITIES = 16 * 255
_PATHS = 8
_FARTHEST = 0xFFFFFFFF
_LARGEST_COST = 127  # with 127 of a path it fits a byte: what the native module never has to cut off


@lru_cache(maxsize=1)
def matcher() -> Matcher | None:
    """The matcher of this process's GPU; None where there is none that works, with a warning where one is there."""
    if find_spec("cupy") is None:
        return None
    try:
        import cupy

        if cupy.cuda.runtime.getDeviceCount() < 1:
            return None
        found = Matcher(cupy)
        found.halve(found.upload(np.zeros((2, 2), np.uint8)))
        return found
    except Exception as error:  # noqa: BLE001 - drivers, compilers and libraries fail in ways of their own
        _log.warning("the GPU is not used, %s: %s", type(error).__name__, str(error).strip().split("\n")[0])
        return None


def device_name() -> str | None:
    """The name of the GPU that matches; None without."""
    found = matcher()
    if found is None:
        return None
    return found.xp.cuda.runtime.getDeviceProperties(0)["name"].decode()


class Matcher:
    """``halve``, ``ranges``, ``joint_greys``, ``match_dense`` and ``match_ragged`` of ``_sgm`` on device arrays.

    ``xp`` is CuPy, or what stands in for it in tests. All functions raise MemoryError where the device has too little.
    """

    def __init__(self, xp: Any) -> None:
        self.xp = xp
        source = (resources.files("tiegraph.dense") / "tsgm.cu").read_text()
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

    def ranges(self, coarse: Array, width: int, height: int, rules: RangeRules) -> tuple[Array, Array, int]:
        """First disparity (h, w) i2, blocks of 16 (h, w) u1 of each pixel, and their disparities in all."""
        if not 1 <= rules.count <= _MAX_DISPARITIES:
            raise ValueError(f"1 to {_MAX_DISPARITIES} disparities")
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
        return first, blocks, _BLOCK * int(blocks.sum(dtype=np.int64))

    def match_dense(
        self,
        left: Array,
        right: Array,
        low: int,
        count: int,
        options: Options,
        mutual: np.ndarray | None = None,
    ) -> Array:
        """Disparity (h, w) f4, NaN = none, over one range for all pixels."""
        padded = -(-count // _BLOCK) * _BLOCK
        ranges = (*4 * (np.uint64(0),), np.int32(low), np.int32(count), np.int32(padded), np.int32(left.shape[1]))
        return self._match(left, right, ranges, left.size * padded, padded, padded, options, mutual)

    def match_ragged(
        self,
        left: Array,
        right: Array,
        first: Array,
        blocks: Array,
        options: Options,
        mutual: np.ndarray | None = None,
    ) -> Array:
        """The same with ``blocks`` of 16 disparities from ``first`` on for each pixel."""
        xp, (height, width) = self.xp, left.shape
        place, rows = xp.empty((height, width), np.uint32), xp.empty((2, height), np.uint32)
        self._run("lay_out", 32 * height, blocks, np.int32(width), np.int32(height), place, rows)
        sums, most = self.download(rows).astype(np.uint64)
        starts = np.concatenate([[np.uint64(0)], np.cumsum(sums, dtype=np.uint64)])
        none = np.int32(0)
        ranges = (first, blocks, place, self.upload(starts[:-1]), none, none, none, np.int32(width))
        cells = int(starts[-1])
        return self._match(left, right, ranges, cells, cells / left.size, _BLOCK * int(most.max()), options, mutual)

    def _match(
        self,
        left: Array,
        right: Array,
        ranges: tuple[Any, ...],
        cells: int,
        mean: float,
        most: int,
        options: Options,
        mutual: np.ndarray | None,
    ) -> Array:
        xp, (height, width), right_width = self.xp, left.shape, right.shape[1]
        rx, ry = options.radius_x, options.radius_y
        bits = [xp.empty(image.shape, np.uint64) for image in (left, right)]
        for image, out in zip((left, right), bits):
            self._run("census", image.size, image, *_ints(image.shape[1], height, rx, ry), out)
        outside = ((2 * rx + 1) * (2 * ry + 1) - 1) * 2 // 3
        told = self.upload(mutual) if mutual is not None else np.uint64(0)
        cost, parts = xp.empty(cells, np.uint8), xp.empty(_PATHS * cells, np.uint8)
        group = _group(mean)
        pixels = left.size * group
        here = (*ranges, np.int32(height))
        tail = _ints(right_width, options.mode, outside)
        self._run(f"costs_{group}", pixels, *bits, left, right, told, *here, *tail, cost)
        self._walk(_fitting(group, most), (cost, left, self._table(options), *here), options, most, cells, parts)
        best, around = xp.empty((height, width), np.int16), xp.empty((3, height, width), np.uint16)
        right_best = xp.full((height, right_width), _FARTHEST, np.uint32)
        tail = (np.uint64(cells), *_ints(right_width, options.uniqueness))
        self._run(f"winners_{group}", pixels, cost, parts, *here, *tail, best, around, right_best)
        disparity = xp.empty((height, width), np.float32)
        tail = _ints(width, height, right_width, options.left_right, options.parabola)
        self._run("finish", left.size, best, around, right_best, *tail, disparity)
        return disparity

    def _table(self, options: Options) -> Array:
        return self.upload(np.array(options.large_by_step or [options.large] * 16, np.uint8))

    def _walk(self, group: int, begin: tuple[Any, ...], options: Options, most: int, cells: int, parts: Array) -> None:
        """All eight paths of every pixel."""
        height, width = begin[1].shape
        pitch = most + _GUARDS
        bytes_of_warp = 2 * (32 // group) * pitch
        warps = max(1, min(_THREADS // 32, _SHARED_BYTES // bytes_of_warp))
        chains = max(height, width)
        blocks = -(-chains // (warps * 32 // group))
        kernel = self._module.get_function(f"paths_{group}")
        arguments = (*begin, *_ints(options.small, pitch), np.uint64(cells), parts)
        kernel((blocks, _PATHS), (32 * warps,), arguments, shared_mem=warps * bytes_of_warp)

    def _run(self, name: str, threads: int, *arguments: Any) -> None:
        kernel: Callable[..., None] = self._module.get_function(name)
        kernel((-(-threads // _THREADS),), (_THREADS,), arguments)


def _ints(*numbers: int) -> tuple[np.int32, ...]:
    return tuple(np.int32(n) for n in numbers)


def _group(mean: float) -> int:
    """Lanes for a path whose pixels have ``mean`` disparities."""
    return next((g for g in _GROUPS if 4 * g >= mean), _GROUPS[-1])


def _fitting(group: int, most: int) -> int:
    """The same or more lanes, so that the path costs of a warp fit into shared memory."""
    return next(g for g in _GROUPS if g >= group and 2 * (32 // g) * (most + _GUARDS) <= _SHARED_BYTES)
