"""Mutual nearest neighbours of descriptors, as COLMAP's brute-force matcher finds them.

The search is native (sources in native/nearest), in whole numbers, one pass over all dot products for both directions.
Descriptors are first rounded to seven bits and one length, which halves the time and gives as many matches, as often
right. COLMAP's own default, an approximate index, takes two to six times as long, verification included, and loses some
matches in a hundred (benchmarks/README.md, *Matching*). Without the native module NumPy finds the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pycolmap

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
