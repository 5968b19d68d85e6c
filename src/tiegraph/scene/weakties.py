"""Weakly tied groups of frames: candidates from links, the strongest first, and shared points.

A frame may have enough points and yet share them with two others only, which are displaced together with it.
So groups are tested as well: those that arise when frames are joined by their links, the strongest first (single
linkage). A group with more ties inside than to the rest is one of them.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from tiegraph.scene.graph import parts


@dataclass(frozen=True)
class WeaklyTied:
    """Connected frames, and how many points they share with all the others."""

    frames: tuple[int, ...]
    points: int


def strongest_first(a: np.ndarray, b: np.ndarray, weight: np.ndarray, nodes: int) -> Iterator[np.ndarray]:
    """The groups that links a, b (K,) between nodes join, the strongest first, each (M,) in rising order and of two
    nodes at least; links of one weight join in the order of their nodes."""
    members = {k: np.array([k]) for k in range(nodes)}
    home = np.arange(nodes)
    for k in np.lexsort((np.maximum(a, b), np.minimum(a, b), -weight)):
        one, two = int(home[a[k]]), int(home[b[k]])
        if one == two:
            continue
        members[one] = np.sort(np.concatenate([members[one], members.pop(two)]))
        home[members[one]] = one
        yield members[one]


def weakly_tied(
    point: np.ndarray, frame: np.ndarray, present: np.ndarray, least: int, alone: int | None = None
) -> tuple[WeaklyTied, ...]:
    """Groups of frames that share fewer than ``least`` points with the others, and single frames with fewer than
    ``alone`` (None: likewise), the fewest first; no frame is in two.

    point, frame (K,): which frame sees which point. ``present`` (F,) bool: frames that have a pose. Of two sides the
    smaller is the group. Frames that share ``least`` points are always on one side, so only weak links are tested.
    """
    home = _sure(point, frame, len(present), least)
    seen = _incidence(point, home[frame], len(present))
    shared = (seen @ seen.T).tocoo()
    upper = shared.row < shared.col
    ends, count = (shared.row[upper], shared.col[upper]), shared.data[upper]
    there = np.unique(home[present])
    size = np.bincount(home[present], minlength=len(present))
    asked = [*there[:, None], *strongest_first(ends[0], ends[1], count, len(present))] if len(there) > 1 else []
    found = []
    for group in asked:
        larger = 2 * int(size[group].sum()) + (there[0] in group) > int(present.sum())
        inside = np.setdiff1d(there, group) if larger else np.intersect1d(there, group)
        if 0 < len(inside) < len(there):
            # Points that nodes on both sides see
            mine = np.asarray(seen[inside].sum(axis=0)).ravel()
            across = int(np.sum((mine > 0) & (mine < np.asarray(seen.sum(axis=0)).ravel())))
            frames = np.flatnonzero(present & np.isin(home, inside)).tolist()
            enough = least if alone is None or len(frames) > 1 else alone
            found += [WeaklyTied(tuple(frames), across)] if across < enough else []
    return _disjoint(found)


def named(group: WeaklyTied, names: tuple[str, ...]) -> str:
    """A group in words: the first and last of its frames by ``names`` (F,), and their number."""
    first, last = names[group.frames[0]], names[group.frames[-1]]
    return first if len(group.frames) == 1 else f"{first} .. {last} ({len(group.frames)} frames)"


def _sure(point: np.ndarray, frame: np.ndarray, frames: int, least: int) -> np.ndarray:
    """(F,) one number for all frames connected by links of at least so many points, directly or as groups."""
    home = np.arange(frames)
    while True:
        seen = _incidence(point, home[frame], frames)
        shared = (seen @ seen.T).tocoo()
        strong = (shared.data >= least) & (shared.row < shared.col)
        if not strong.any():
            return home
        part = parts(shared.row[strong], shared.col[strong], frames)
        first = np.full(frames, frames)
        np.minimum.at(first, part, np.arange(frames))
        home = first[part][home]


def _incidence(point: np.ndarray, node: np.ndarray, nodes: int) -> csr_array:
    """(nodes, P) 1 where a node sees a point that another one sees too."""
    points = int(point.max(initial=-1)) + 1
    table = coo_array((np.ones(len(point), np.int64), (node, point)), shape=(nodes, points)).tocsr()
    table.data[:] = 1
    several = np.flatnonzero(np.asarray(table.sum(axis=0)).ravel() > 1)
    return table[:, several]


def _disjoint(found: list[WeaklyTied]) -> tuple[WeaklyTied, ...]:
    """Of groups that have frames in common the one with the fewest points, of equals the larger."""
    taken: set[int] = set()
    out = []
    for group in sorted(set(found), key=lambda g: (g.points, -len(g.frames), g.frames)):
        if not taken & set(group.frames):
            taken |= set(group.frames)
            out.append(group)
    return tuple(out)
