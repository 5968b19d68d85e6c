"""Which features of two images match: mutual nearest neighbours, as COLMAP's brute-force matcher finds them, or those
of a plug-in of the group ``tiegraph.matchers``, whose rows are checked before COLMAP verifies them.

The search is native (sources in native/nearest), in whole numbers, one pass over all dot products for both directions.
Descriptors are first rounded to seven bits and one length, which halves the time and gives as many matches, as often
right. COLMAP's own default, an approximate index, takes two to six times as long, verification included, and loses some
matches in a hundred (benchmarks/README.md, *Matching*). Without the native module NumPy finds the same. COLMAP itself
matches on a GPU, where a build with CUDA (``pip install pycolmap-cuda12``) finds one.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import pycolmap

from tiegraph.errors import InputError, TiegraphError
from tiegraph.features.settings import MatchSettings
from tiegraph.plugins import chosen

if TYPE_CHECKING:
    from tiegraph.features import _nearest
else:
    try:
        from tiegraph.features import _nearest
    except ImportError:  # installed without a C++ compiler
        _nearest = None

NORM = 254.0  # length of a rounded descriptor; its squared length fits in 16 bits, and so does each dot product
_LARGEST, _MOST_NORM2 = 127, 65535
_BLOCK = 1 << 22  # dot products in NumPy's memory at once


def kernels() -> list[str]:
    """The native kernels for this machine, the fastest first; [] without the native module."""
    return [] if _nearest is None else list(_nearest.kernels())


def matches(a: np.ndarray, b: np.ndarray, options: pycolmap.SiftMatchingOptions) -> np.ndarray:
    """(K, 2) u4 rows of descriptors a (N, 128) u1 and b (M, 128) u1 that match, in the order of a.

    A match is the nearest by angle, at most ``options.max_distance`` (radians) away and closer than ``max_ratio`` of
    the second nearest (Lowe's ratio test); with ``cross_check`` in both directions.
    """
    of_a, of_b = search(a, b)
    rows = np.flatnonzero(_distinct(of_a, options))
    partner = of_a[0][rows]
    if options.cross_check:
        mutual = (of_b[0][partner] == rows) & _distinct(of_b, options)[partner]
        rows, partner = rows[mutual], partner[mutual]
    return np.stack([rows, partner], axis=1).astype(np.uint32)


def _distinct(found: np.ndarray, options: pycolmap.SiftMatchingOptions) -> np.ndarray:
    """(N,) bool: near enough, and clearly nearer than the second.

    Angles are rounded from double precision: the last bit of single precision depends on the processor.
    """
    index, *dots = found
    best, second = (np.arccos(np.minimum(d / NORM**2, 1.0)).astype(np.float32) for d in dots)
    return (index >= 0) & (best <= np.float32(options.max_distance)) & (best < np.float32(options.max_ratio) * second)


def search(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3, N) i4 and (3, M) i4: of each descriptor of a (N, 128) u1 the nearest of b (M, 128) u1, and the other way.

    Rows: which (the first of equals; -1 where no dot product is above 0), its dot product, that of the second nearest
    (0 where there is none); of descriptors of the length NORM.
    """
    a, b = np.ascontiguousarray(a, np.uint8).reshape(-1, 128), np.ascontiguousarray(b, np.uint8).reshape(-1, 128)
    return _searched(a, b) if _nearest is None else _nearest.search(a, b)


def rounded(descriptors: np.ndarray) -> np.ndarray:
    """Descriptors (K, 128) u1 with the length NORM and numbers of seven bits: (K, 128) u1.

    The running sum along a descriptor is rounded, not each number: the errors of neighbours cancel, whereas of numbers
    that are rounded one by one every odd one would lose a half.
    """
    length, sums = np.full(len(descriptors), NORM), np.cumsum(descriptors, axis=1, dtype=np.int64)
    norm = np.sqrt(np.maximum(np.square(descriptors, dtype=np.int64).sum(axis=1), 1))
    out, left = np.zeros(descriptors.shape, np.uint8), np.arange(len(descriptors))
    while len(left):
        scale = (length[left] * 65536 / norm[left]).astype(np.int64)
        whole = np.diff((sums[left] * scale[:, None] + 32768) >> 16, axis=1, prepend=0)
        out[left] = np.minimum(whole, _LARGEST)
        left = left[np.square(out[left], dtype=np.int64).sum(axis=1) > _MOST_NORM2]
        length[left] -= 1
    return out


def _searched(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``search`` by NumPy, some rows at a time: floats, but whole numbers below 2^24, so exact."""
    a, b = rounded(a), rounded(b)
    of_a, of_b = (np.zeros((3, len(x)), np.int32) for x in (a, b))
    of_a[0] = of_b[0] = -1
    if not len(a) or not len(b):
        return of_a, of_b
    columns, step = b.astype(np.float32).T, max(1, _BLOCK // len(b))
    for k in range(0, len(a), step):
        dots = a[k : k + step].astype(np.float32) @ columns
        index, best, second = _two_largest(dots.T.copy())
        of_b[2] = np.maximum(np.maximum(of_b[2], second), np.minimum(of_b[1], best))
        of_b[0] = np.where(best > of_b[1], index + k, of_b[0])
        of_b[1] = np.maximum(of_b[1], best)
        of_a[:, k : k + step] = _two_largest(dots)
    return of_a, of_b


def _two_largest(dots: np.ndarray) -> np.ndarray:
    """(3, rows): column and value of the largest of each row, value of the second; writes to ``dots``."""
    rows, index = np.arange(len(dots)), dots.argmax(axis=1)
    best = dots[rows, index]
    dots[rows, index] = 0
    return np.stack([np.where(best > 0, index, -1), best, dots.max(axis=1)]).astype(np.int32)


# ---------------------------------------------------------------- the chosen matcher


@dataclass(frozen=True, eq=False)
class Features:
    """Features of an image: keypoints (K, 4) f4 x, y, scale (pixels), orientation (radians); descriptors (K, 128) u1,
    of SIFT root-SIFT; size (width, height)."""

    keypoints: np.ndarray
    descriptors: np.ndarray
    size: tuple[int, int]

    def __len__(self) -> int:
        return len(self.keypoints)

    def __repr__(self) -> str:
        return f"Features({len(self)} of an image of {self.size[0]} x {self.size[1]} pixels)"


# Features of images a and b -> (K, 2) whole numbers: rows of a and of b that match, each row once at most.
Matcher = Callable[[Features, Features, MatchSettings], np.ndarray]


def by_nearest(a: Features, b: Features, settings: MatchSettings) -> np.ndarray:
    """(K, 2) u4 rows of mutual nearest descriptors."""
    options = pycolmap.SiftMatchingOptions(max_ratio=settings.max_ratio)
    return matches(a.descriptors, b.descriptors, options)


MATCHERS: dict[str, Matcher] = {"nearest": by_nearest}


def matcher(settings: MatchSettings) -> Callable[[Features, Features, str, str], np.ndarray]:
    """The chosen matcher: features and names of two images -> (K, 2) u4. Raises EngineMissing if it is not there.

    What it returns raises InputError where a plug-in fails or gives rows that are none.
    """
    engine: Matcher = chosen("matchers", settings.engine, MATCHERS)

    def rows(a: Features, b: Features, name_a: str, name_b: str) -> np.ndarray:
        try:
            found = np.asarray(engine(a, b, settings))
            fault = _fault(found, len(a), len(b))
        except (TiegraphError, MemoryError):
            raise
        except Exception as error:  # whatever the package of somebody else does
            found, fault = np.zeros((0, 2)), f"raised {error!r}"
        if fault:
            raise InputError(
                f"match.engine = {settings.engine}: the plug-in {fault} for {name_a} and {name_b}. Correct or update "
                "its package, or set match.engine to nearest"
            )
        return found.astype(np.uint32)

    return rows


def _fault(rows: np.ndarray, of_a: int, of_b: int) -> str:
    """What is wrong with the rows of two images of so many features; "" if nothing is."""
    if rows.ndim != 2 or rows.shape[1] != 2 or rows.dtype.kind not in "iu":
        return f"gave an array of {rows.shape} {rows.dtype} where (K, 2) whole numbers are needed"
    if (rows < 0).any() or (rows >= (of_a, of_b)).any():
        return f"gave rows from {rows.min(axis=0)} to {rows.max(axis=0)} of {of_a} and {of_b} features"
    return "" if all(len(np.unique(column)) == len(rows) for column in rows.T) else "matched a feature twice"


_PROBE = """
import ctypes, sys
driver, count = ctypes.CDLL("libcuda.so.1"), ctypes.c_int()
sys.exit(driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0 or count.value < 1)
"""  # ends with 0 where the driver has a GPU


@lru_cache(maxsize=1)
def on_gpu() -> bool:
    """Whether COLMAP can work on a GPU here. Asked in a process of its own: one that has touched the driver must not be
    forked."""
    if not pycolmap.has_cuda:
        return False
    try:
        # A driver that does not answer within is not used
        return subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, timeout=60).returncode == 0
    except (OSError, subprocess.SubprocessError):
        return False


def device() -> pycolmap.Device:
    """Where COLMAP matches; never left to COLMAP, which takes a GPU for granted in a build with CUDA."""
    return pycolmap.Device.cuda if on_gpu() else pycolmap.Device.cpu
