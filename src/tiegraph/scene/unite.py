"""Nodes that links join, told by the first node of what they are in: links in blocks, so that memory stays bounded."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

BLOCK = 1 << 22  # links looked at together


def unite(first: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(nodes,) first node of what each node is in, after links between the sets ``a`` and ``b`` (K,) are added to those
    of ``first`` (nodes,), which is written to. In whatever order links come the outcome is the same."""
    while True:
        apart = a != b
        if not apart.any():
            return _roots(first, first)
        low, high = np.minimum(a[apart], b[apart]), np.maximum(a[apart], b[apart])
        first[high] = low  # of several partners the last wins; the others come back in the next turn
        a, b = _roots(first, first[low]), _roots(first, first[high])


def _roots(first: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(K,) the ends of the ways up from nodes (K,)."""
    while True:
        higher = first[up]
        if np.array_equal(higher, up):
            return up
        up = higher


def blocks(start: np.ndarray) -> Iterator[slice]:
    """Slices of K rows, about a block each; the links of row k are those from ``start[k]`` to ``start[k + 1]``."""
    last = len(start) - 1
    ends = np.searchsorted(start, np.arange(BLOCK, start[-1], BLOCK))
    for a, b in pairwise(np.unique(np.concatenate([[0], ends, [last]])).tolist()):
        yield slice(a, b)


def spread(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """(sum,) the numbers from ``first`` (K,) on, ``count`` (K,) of each."""
    return np.repeat(first - (np.cumsum(count) - count), count) + np.arange(count.sum())
