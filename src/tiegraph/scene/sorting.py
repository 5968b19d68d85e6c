"""Large arrays: tables of columns, sorting of points by voxel, tile or node, even samples, components by blocks."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

BLOCK = 1 << 22  # links processed together
A = TypeVar("A", bound="Arrays")
T = TypeVar("T", bound="Columns")


class Arrays:
    """Base of dataclasses whose fields are arrays, stored in a .npz by their names."""

    def to_npz(self) -> dict[str, np.ndarray]:
        """Columns for ``np.savez``."""
        return {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]

    @classmethod
    def from_npz(cls: type[A], data: Mapping[str, np.ndarray]) -> A:
        """Inverse of ``to_npz``; other entries are ignored."""
        return cls(**{f.name: data[f.name] for f in fields(cls)})  # type: ignore[arg-type]


class Columns:
    """Base of dataclasses whose arrays, the first field among them, are columns of one length; others are shared."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))  # type: ignore[arg-type]

    def where(self: T, rows: np.ndarray) -> T:
        """The rows of a mask or index array."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        return replace(self, **{n: v[rows] for n, v in named.items() if isinstance(v, np.ndarray)})  # type: ignore

    @classmethod
    def concatenate(cls: type[T], parts: Sequence[T]) -> T:
        """The rows of several tables (one at least), one after another; other fields are those of the first."""
        first = parts[0]
        names = [n for n, v in vars(first).items() if isinstance(v, np.ndarray)]
        return replace(first, **{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})  # type: ignore


def freeze(table: object, dtypes: Mapping[str, Any]) -> None:
    """Make fields of a frozen dataclass read-only columns of some types."""
    for name, dtype in dtypes.items():
        column = np.array(getattr(table, name), dtype=dtype)
        column.setflags(write=False)
        object.__setattr__(table, name, column)


def run_starts(numbers: np.ndarray) -> np.ndarray:
    """Where a run of equal numbers begins."""
    return np.flatnonzero(np.r_[True, numbers[1:] != numbers[:-1]][: len(numbers)])


def order_of(numbers: np.ndarray) -> np.ndarray:
    """Order that sorts whole numbers >= 0, equal ones in their order."""
    if len(numbers) and int(numbers.max()) < 1 << 32 and len(numbers) < 1 << 31:
        # Number and place in one integer: sorting these takes a fifth of the time of finding an order.
        packed = numbers.astype(np.uint64) << np.uint64(32) | np.arange(len(numbers), dtype=np.uint64)
        packed.sort()
        return (packed & np.uint64(0xFFFFFFFF)).astype(np.int64)
    return np.argsort(numbers, kind="stable")


def row_numbers(columns: np.ndarray) -> np.ndarray:
    """(V,) i8: one number >= 0 for each distinct column of integers (c, V), in the order of the columns."""
    low = columns.min(axis=1)
    span = columns.max(axis=1) - low + 1
    if np.prod(span.astype(float)) >= 2.0**62:  # does not fit one integer: number the columns that occur
        return np.unique(columns, axis=1, return_inverse=True)[1].ravel()
    number = np.zeros(columns.shape[1], np.int64)
    for values, least, width in zip(columns, low, span, strict=True):
        number = number * width + (values - least)
    return number


def ranks(group: np.ndarray, *keys: np.ndarray) -> np.ndarray:
    """(K,) place of each item within its group (K,), sorted by keys (K,), the first before the others."""
    order = np.lexsort((*keys[::-1], group))
    out = np.empty(len(order), int)
    out[order] = np.arange(len(order)) - np.searchsorted(group[order], group[order])
    return out


def among_best(group: np.ndarray, value: np.ndarray, most: int) -> np.ndarray:
    """(K,) bool: items that are among the ``most`` highest values (K,) of their group (K,); of equal ones the first."""
    return ranks(group, -value) < most


def evenly(count: int, most: int) -> np.ndarray:
    """(K,) places of at most ``most`` of ``count`` things, spread evenly over them, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def unite(first: np.ndarray, links: Iterable[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(nodes,) first node of each node's component, after links between nodes (K,) and (K,), a block at a time, are
    added to those of ``first`` (nodes,), which is modified. The result does not depend on the order of links."""
    for a, b in links:
        while len(a):
            a, b = _roots(first, a), _roots(first, b)
            apart = a != b
            a, b = np.minimum(a[apart], b[apart]), np.maximum(a[apart], b[apart])
            first[b] = a  # of several partners the last wins; the others come back in the next round
    while not np.array_equal(further := first[first], first):
        first = further
    return first


def _roots(first: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(K,) the roots of nodes (K,), which from now on are one step away."""
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
