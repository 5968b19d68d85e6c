"""Nodes that links join, told by the first node of what they are in: links in blocks, so that memory stays bounded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np

BLOCK = 1 << 22  # links looked at together


def unite(first: np.ndarray, links: Iterable[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(nodes,) first node of what each node is in, after links between nodes (K,) and (K,), a block at a time, are
    added to those of ``first`` (nodes,), which is written to. In whatever order links come the outcome is the same."""
    for a, b in links:
        while len(a):
            a, b = _roots(first, a), _roots(first, b)
            apart = a != b
            a, b = np.minimum(a[apart], b[apart]), np.maximum(a[apart], b[apart])
            first[b] = a  # of several partners the last wins; the others come back in the next turn
    while not np.array_equal(further := first[first], first):
        first = further
    return first


def _roots(first: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(K,) the ends of the ways up from nodes (K,), which from now on are one step long."""
    up = first[nodes]
    while not np.array_equal(higher := first[up], up):
        up = higher
    first[nodes] = up
    return up


def blocks(start: np.ndarray) -> Iterator[slice]:
    """Slices of K rows, about a block each; the links of row k are those from ``start[k]`` to ``start[k + 1]``."""
    last = len(start) - 1
    ends = np.searchsorted(start, np.arange(BLOCK, start[-1], BLOCK))
    for a, b in pairwise(np.unique(np.concatenate([[0], ends, [last]])).tolist()):
        yield slice(a, b)


def spread(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """(sum,) the numbers from ``first`` (K,) on, ``count`` (K,) of each."""
    return np.repeat(first - (np.cumsum(count) - count), count) + np.arange(count.sum())
