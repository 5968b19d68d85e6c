"""Graphs of images and frames: forests, components, cuts, bridges, articulation points, links between groups, weakly
tied groups, and the strongest pairs of each image."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_flow, minimum_spanning_tree

from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import ranks
from tiegraph.text import some


def parts(i: np.ndarray, j: np.ndarray, nodes: int) -> np.ndarray:
    """(nodes,) component of every node under links i, j (K,), in no particular order."""
    graph = coo_array((np.ones(len(i), np.int8), (i, j)), shape=(nodes, nodes))
    return connected_components(graph.tocsr(), directed=False)[1]


def symmetric(i: np.ndarray, j: np.ndarray, value: np.ndarray, nodes: int) -> csr_array:
    """(nodes, nodes) with the values (K,) of links i, j (K,) at both places, those of one place added up."""
    ends = np.concatenate([i, j]), np.concatenate([j, i])
    return coo_array((np.tile(value, 2), ends), shape=(nodes, nodes)).tocsr()


def forest(i: np.ndarray, j: np.ndarray, strength: np.ndarray, nodes: int) -> np.ndarray:
    """Places of a maximum spanning forest by strength (K,) of links i, j (K,); parallel links and loops may occur."""
    low, high = np.minimum(i, j).astype(np.int64), np.maximum(i, j).astype(np.int64)
    order = np.lexsort((-strength, low * nodes + high))
    key = (low * nodes + high)[order]
    best = order[np.concatenate([[True], np.diff(key) != 0])[: len(order)] & (low != high)[order]]
    if not len(best):
        return best
    cost = strength[best].max() + 1.0 - strength[best]  # positive: scipy takes zeros for missing links
    ends = (low[best].astype(np.int32), high[best].astype(np.int32))  # csgraph before scipy 1.16 takes no others
    tree = minimum_spanning_tree(coo_array((cost, ends), shape=(nodes, nodes)).tocsr()).tocoo()
    kept = np.minimum(*tree.coords).astype(np.int64) * nodes + np.maximum(*tree.coords)
    return best[np.isin(low[best] * nodes + high[best], kept)]


def cheapest_cut(capacity: csr_array, a: int, b: int) -> np.ndarray:
    """(nodes,) bool: the side of node a where the least integer capacity is cut between nodes a and b (minimum cut)."""
    rest = capacity - maximum_flow(capacity, a, b).flow
    rest.data[rest.data < 0] = 0
    rest.eliminate_zeros()
    side = np.zeros(capacity.shape[0], bool)
    side[breadth_first_order(rest, a, return_predecessors=False)] = True
    return side


@dataclass(frozen=True)
class FrameLinks:
    """Links between frames a < b (K,): ``row`` the first pair of a link, ``several`` whether there is another."""

    a: np.ndarray
    b: np.ndarray
    row: np.ndarray
    several: np.ndarray


def frame_links(i: np.ndarray, j: np.ndarray, scene: Scene) -> FrameLinks:
    """The links between frames from pairs of images i, j (P,); pairs within a frame make none."""
    low, high = np.sort(scene.frame[np.stack([i, j])], axis=0)
    row = np.flatnonzero(low != high)
    key = low[row].astype(np.int64) * scene.frames + high[row]
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    row = row[first]
    return FrameLinks(a=low[row], b=high[row], row=row, several=count > 1)


@dataclass(frozen=True)
class Cuts:
    """Bridges (K,) bool of links, articulation points (n,) bool of nodes, ``side`` (K,) nodes that depend on a bridge
    (the smaller side; 0 = no bridge) and ``falls`` (n,) nodes disconnected by the loss of an articulation point."""

    bridge: np.ndarray
    joint: np.ndarray
    side: np.ndarray
    falls: np.ndarray


def cuts(a: np.ndarray, b: np.ndarray, nodes: int, double: np.ndarray | None = None) -> Cuts:
    """Bridges and articulation points of a graph of links a, b (K,) without parallels; a link that is ``double`` (K,)
    is no bridge. Depth first search (Tarjan 1972) without recursion."""
    double = np.zeros(len(a), bool) if double is None else double
    ends = np.concatenate([a, b])
    around = np.argsort(ends, kind="stable")
    start = np.r_[0, np.cumsum(np.bincount(ends.astype(np.int64), minlength=nodes))].tolist()
    other, link = np.concatenate([b, a])[around].tolist(), np.tile(np.arange(len(a)), 2)[around].tolist()
    found, low, size, parent = [-1] * nodes, [0] * nodes, [1] * nodes, [-1] * nodes
    into = [-1] * nodes  # link to the parent
    place = start.copy()
    order: list[int] = []
    for root in range(nodes):
        if found[root] >= 0:
            continue
        stack = [root]
        found[root] = low[root] = len(order)
        order.append(root)
        while stack:
            v = stack[-1]
            if place[v] == start[v + 1]:
                stack.pop()
                continue
            w, e = other[place[v]], link[place[v]]
            place[v] += 1
            if found[w] < 0:
                found[w] = low[w] = len(order)
                order.append(w)
                parent[w], into[w] = v, e
                stack.append(w)
            elif e != into[v]:
                low[v] = min(low[v], found[w])
    for v in reversed(order):
        if parent[v] >= 0:
            size[parent[v]] += size[v]
            low[parent[v]] = min(low[parent[v]], low[v])
    return _judged(np.array([parent, into, found, low, size]), parts(a, b, nodes), double)


def _judged(tree: np.ndarray, part: np.ndarray, double: np.ndarray) -> Cuts:
    """Bridges and articulation points from the search tree: parent, link to it, number, low point, subtree size."""
    parent, into, found, low, size = tree
    whole = np.bincount(part)[part] if len(part) else np.zeros(0, int)
    bridge, side = np.zeros(len(double), bool), np.zeros(len(double), int)
    child = np.flatnonzero(parent >= 0)
    hangs = child[low[child] > found[parent[child]]]
    hangs = hangs[~double[into[hangs]]]
    bridge[into[hangs]] = True
    side[into[hangs]] = np.minimum(size[hangs], whole[hangs] - size[hangs])
    below = child[low[child] >= found[parent[child]]]  # subtrees that reach no further up than their parent
    count = np.bincount(parent[below], minlength=len(part))
    lost = np.bincount(parent[below], size[below], minlength=len(part)).astype(int)
    root = parent < 0
    joint = np.where(root, count > 1, count > 0)
    biggest = np.zeros(len(part), int)
    np.maximum.at(biggest, parent[below], size[below])
    rest = np.maximum(biggest, whole - 1 - lost)  # the biggest piece stays connected
    return Cuts(bridge=bridge, joint=joint, side=side, falls=np.where(joint, whole - 1 - rest, 0))


@dataclass(frozen=True)
class Group:
    """Images that form a unit and must be tied to the others: a camera, a pass or a section."""

    kind: str
    name: str
    member: np.ndarray  # (N,) bool


def groups(scene: Scene) -> Iterator[Group]:
    """Cameras, passes and sections of a scene, each kind only where there are at least two of it."""
    for kind, label, names in (
        ("camera", scene.sensor_key, [s.name for s in scene.all_sensors]),
        ("pass", scene.sequence[scene.frame], scene.sequences),
        ("section", scene.section[scene.frame], ()),
    ):
        numbers = np.unique(label)
        for k in numbers[numbers >= 0] if len(numbers) > 1 else []:
            yield Group(kind, names[k] if names else f"{k}", label == k)


def two_links(i: np.ndarray, j: np.ndarray, member: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Places of up to two pairs that tie a group (N,) bool to the rest and have no image in common, the strongest.

    One if all pairs across share an image, none if there is no pair across.
    """
    across = np.flatnonzero(member[i] != member[j])
    if not len(across):
        return across
    across = across[np.argsort(-strength[across], kind="stable")]
    inner, outer = np.where(member[i], i, j)[across], np.where(member[i], j, i)[across]
    free = np.flatnonzero((inner != inner[0]) & (outer != outer[0]))
    if len(free):
        return across[[0, free[0]]]
    same_inner = np.flatnonzero((inner == inner[0]) & (outer != outer[0]))
    same_outer = np.flatnonzero((inner != inner[0]) & (outer == outer[0]))
    if len(same_inner) and len(same_outer):  # both share an end of the strongest pair, different ones: without it
        return across[[same_inner[0], same_outer[0]]]
    return across[:1]


def best_line(gain: np.ndarray, cost: float) -> np.ndarray:
    """(C,) place in each row of ``gain`` (C, R) of the line with the largest sum, less ``cost`` for each place it
    moves from one row to the next. Dynamic programming."""
    slope = cost * np.arange(gain.shape[1])
    best = [gain[0]]
    for column in gain[1:]:
        before = best[-1]
        down = np.maximum.accumulate(before + slope) - slope
        up = np.maximum.accumulate((before - slope)[::-1])[::-1] + slope
        best.append(column + np.maximum(down, up))
    line = [int(np.argmax(best[-1]))]
    for before in best[-2::-1]:
        line.append(int(np.argmax(before - np.abs(slope - slope[line[-1]]))))
    return np.array(line[::-1])


def components(pairs: Pairs, images: int) -> np.ndarray:
    """(N,) component of every image in the graph of kept pairs, the largest is 0."""
    kept = pairs.kept()
    labels = parts(kept.i, kept.j, images)
    return np.argsort(np.argsort(-np.bincount(labels, minlength=1), kind="stable"))[labels]


def component_notes(pairs: Pairs, scene: Scene) -> tuple[str, ...]:
    """Disconnected images: those without a pair, by name, and the components of the rest."""
    labels = components(pairs, len(scene))
    size = np.bincount(labels, minlength=1)
    notes = []
    lonely = [scene.names[k] for k in np.flatnonzero(size[labels] == 1)] if len(scene) > 1 else []
    if lonely:
        notes.append(f"{len(lonely)} images have no pair: {some(lonely, 10)}")
    several = np.flatnonzero(size > 1)
    if len(several) > 1:
        named = [f"{size[k]} images with {scene.names[int(np.argmax(labels == k))]}" for k in several]
        kept = pairs.kept()  # every image stands for its frame
        whole = not parts(scene.frame[kept.i], scene.frame[kept.j], scene.frames).any()
        held = "; the frames of the rig connect them" if whole else ""
        notes.append(f"the pairs fall into {len(several)} components: {some(named, 10)}{held}")
    return tuple(notes)


def strongest_pairs(pairs: Pairs, scene: Scene, per_image: int) -> Pairs:
    """The ``per_image`` best kept pairs of each image, those of following frames, and a maximum spanning forest by
    preview matches.

    Pairs that were never previewed rank last. Those of a camera's following frames are always included, because walls
    may repeat anywhere but hardly from one frame to the next: they keep a pass connected (``canal`` without them, 9
    pairs an image: torn at a bridge, 13 m).
    """
    kept = pairs.kept()
    strength = np.nan_to_num(kept.score.astype(float), nan=0.0)
    chosen = following(kept, scene)
    chosen[forest(kept.i, kept.j, strength, len(scene))] = True
    chosen[strongest_places(kept.i, kept.j, strength, scene, per_image)] = True
    return kept.where(chosen)


def following(pairs: Pairs, scene: Scene) -> np.ndarray:
    """(P,) bool: pairs of one camera's images of two frames that follow each other on a pass."""
    sequence, step = scene.sequence[scene.frame], scene.sequence_index[scene.frame]
    order = np.lexsort((step, scene.sensor_key, sequence))
    near = (sequence[order][1:] == sequence[order][:-1]) & (scene.sensor_key[order][1:] == scene.sensor_key[order][:-1])
    near &= sequence[order][1:] >= 0
    after = np.full(len(scene), -1)
    after[order[:-1][near]] = order[1:][near]
    return (after[pairs.i] == pairs.j) | (after[pairs.j] == pairs.i)


def strongest_places(i: np.ndarray, j: np.ndarray, strength: np.ndarray, scene: Scene, count: int) -> np.ndarray:
    """Places of the ``count`` best of pairs i, j (P,) of each image.

    An image ranks its partners round robin over their passes and cameras, the strongest of each first: by strength
    alone the next frames of the same camera would fill the list, and short bases make a weak network.
    """
    place = np.tile(np.arange(len(i)), 2)
    image, partner = np.concatenate([i, j]), np.concatenate([j, i])
    strength = np.tile(strength, 2)
    sensors = len(scene.all_sensors)
    group = (scene.sequence[scene.frame].astype(np.int64) + 1) * sensors + scene.sensor_key
    turn = ranks(image.astype(np.int64) * (group.max(initial=0) + 1) + group[partner], -strength, partner)
    return np.unique(place[ranks(image, turn, -strength, group[partner]) < count])


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
