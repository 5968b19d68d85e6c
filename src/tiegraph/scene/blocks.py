"""A large survey in blocks of bounded size, so that the time to map it grows linearly with its images.

The frames are a graph, linked by the preview matches of their images and by their order. Normalised cuts (Shi & Malik
2000), nested until every part is small enough, keep images of the same place together: both passes there, whatever
their order. Each part then takes from its neighbours the frames with the most ties to it; by these shared frames two
blocks are joined again (as in Zhu et al. 2018, Very large-scale global SfM by distributed motion averaging).

Where walls repeat, a third of the matches tie distant places, and a cut through such a graph puts these into
one block, where nothing contradicts them. So if frames have prior positions, only links between near frames count:
each block is then one section of the path with all its passes, and ties between distant places are in no block.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from tiegraph.scene.graph import parts
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.scene import Scene, between_neighbours
from tiegraph.scene.tuning import BlocksTuning

# Of the inverse iterations for the second eigenvector; the next eigenvalues of a long path lie close together, so
# several vectors iterate together.
_ITERATIONS, _VECTORS = 12, 4


class Links(Protocol):
    """Ties of two images i, j (T,) of any origin, with their number of matches."""

    @property
    def i(self) -> np.ndarray: ...

    @property
    def j(self) -> np.ndarray: ...

    def counts(self) -> np.ndarray:
        """(T,) matches."""


@dataclass(frozen=True)
class Block:
    """Images mapped together: ``images`` (K,) increasing; ``own`` (K,) bool, the others are lent by neighbours."""

    images: np.ndarray
    own: np.ndarray

    def __len__(self) -> int:
        return len(self.images)

    def part_of(self, scene: Scene, ties: PreviewMatches) -> tuple[Scene, PreviewMatches]:
        """The scene of the block's images and the ties between them, numbered in that scene."""
        number = np.full(len(scene), -1)
        number[self.images] = np.arange(len(self))
        inside = ties.where((number[ties.i] >= 0) & (number[ties.j] >= 0))
        return scene.only(self.images), PreviewMatches(
            i=number[inside.i], j=number[inside.j], start=inside.start, matches=inside.matches
        )


def blocks_of(scene: Scene, ties: Links, tuning: BlocksTuning) -> tuple[Block, ...]:
    """Blocks of a survey by its ties; a single one for a small survey. Every image is some block's own, except
    those of small components without ties to the rest."""
    everything = np.arange(len(scene))
    if in_one_piece(scene, tuning):
        return (Block(everything, np.ones(len(scene), bool)),)
    size = np.bincount(scene.frame, minlength=scene.frames)
    graph, ties_between = _links(scene, ties, tuning)
    label = _cut(graph, size, round(_times(scene, tuning) * tuning.own), tuning)
    lent = _lent(graph, ties_between, label, size, tuning)
    out = []
    for k in range(label.max() + 1):
        inside = label[scene.frame] == k
        images = np.flatnonzero(inside | lent[k][scene.frame])
        if len(images) >= tuning.least:
            out.append(Block(images, inside[images]))
    return tuple(out)


def in_one_piece(scene: Scene, tuning: BlocksTuning) -> bool:
    """Whether a survey is small enough to be mapped as a whole."""
    return len(scene) <= _times(scene, tuning) * tuning.whole


def _times(scene: Scene, tuning: BlocksTuning) -> float:
    """Factor of the block size: 1 if most frames have positions in one world, which keep distant places out of a
    block."""
    world = scene.pose_world()
    return 1.0 if np.bincount(world[world >= 0], minlength=1).max() > 0.5 * scene.frames else tuning.unplaced


def _links(scene: Scene, ties: Links, tuning: BlocksTuning) -> tuple[csr_array, csr_array]:
    """(F, F) strength of the links between frames by preview matches and order; (F, F) pairs of images that tie."""
    a, b, count = scene.frame[ties.i], scene.frame[ties.j], ties.counts().astype(float)
    apart = (a != b) & ~_far(scene, a, b, tuning.near)
    matches = _symmetric(a[apart], b[apart], count[apart], scene.frames)
    pairs = _symmetric(a[apart], b[apart], np.ones(int(apart.sum())), scene.frames)
    order = np.lexsort((scene.sequence_index, scene.rig, scene.sequence))
    before, after = order[:-1], order[1:]
    next_ = (scene.sequence[before] == scene.sequence[after]) & (scene.rig[before] == scene.rig[after])
    next_ &= scene.sequence[before] >= 0
    level = tuning.order * float(matches.data.mean()) if matches.nnz else 1.0
    path = _symmetric(before[next_], after[next_], np.full(int(next_.sum()), level), scene.frames)
    return csr_array(matches + path), pairs


def _far(scene: Scene, a: np.ndarray, b: np.ndarray, near: int) -> np.ndarray:
    """(T,) bool: links between frames a, b (T,) neither of which is among the ``near`` nearest ones of the other, by
    prior positions. Frames without one are interpolated between their neighbours on the pass; those beyond its known
    ends are linked with the ``near`` around them on the pass alone, because a false link of one of them would pull the
    end of a pass elsewhere. For other frames nothing is known."""
    pose = np.array(scene.world_from_rig)
    positions = pose[:, :3, 3] = between_neighbours(pose[:, :3, 3], scene)
    world = scene.with_(world_from_rig=pose).pose_world()
    beside = csr_array((scene.frames, scene.frames), dtype=bool)
    for number in np.unique(world[world >= 0]):
        frames = np.flatnonzero(world == number)
        _, nearest = cKDTree(positions[frames]).query(positions[frames], k=min(near + 1, len(frames)))
        nearest = frames[nearest.reshape(len(frames), -1)]
        here = np.repeat(frames, nearest.shape[1])
        beside = beside + csr_array((np.ones(nearest.size, bool), (here, nearest.ravel())), shape=beside.shape)
    beside = csr_array(beside + beside.T)
    compared = (world[a] >= 0) & (world[a] == world[b])
    beyond = (world < 0) & np.isin(scene.sequence, scene.sequence[(world >= 0) & (scene.sequence >= 0)])
    follow = (scene.sequence[a] == scene.sequence[b]) & (scene.sequence[a] >= 0)
    follow &= np.abs(scene.sequence_index[a] - scene.sequence_index[b]) <= near // 2
    return ((beyond[a] | beyond[b]) & ~follow) | (compared & ~np.asarray(beside[a, b]).ravel())


def _symmetric(a: np.ndarray, b: np.ndarray, value: np.ndarray, n: int) -> csr_array:
    ends = np.concatenate([a, b]), np.concatenate([b, a])
    return coo_array((np.tile(value, 2), ends), shape=(n, n)).tocsr()


# ---------------------------------------------------------------- cutting


def _cut(graph: csr_array, size: np.ndarray, own: int, tuning: BlocksTuning) -> np.ndarray:
    """(F,) part of every frame; none has more than ``own`` images, unless one frame has."""
    label = np.zeros(len(size), int)
    row, column = graph.tocoo().coords
    piece = parts(row, column, len(size))
    todo = [np.flatnonzero(piece == k) for k in range(piece.max() + 1)]
    done: list[np.ndarray] = []
    while todo:
        frames = todo.pop()
        count = -(-int(size[frames].sum()) // own)
        if count < 2 or len(frames) < 2:
            done.append(frames)
            continue
        first = _first_side(csr_array(graph[frames][:, frames]), size[frames], (count // 2, count), own, tuning)
        todo += [frames[first], frames[~first]]
    for k, frames in enumerate(done):
        label[frames] = k
    return label


def _first_side(
    graph: csr_array, size: np.ndarray, blocks: tuple[int, int], own: int, tuning: BlocksTuning
) -> np.ndarray:
    """(F,) bool: the side for the first of some ``blocks``, (some, all), by the cheapest cut."""
    share, total = blocks[0] / blocks[1], float(size.sum())
    order = np.argsort(_second_vector(graph), kind="stable")
    place = np.argsort(order)
    coo = graph.tocoo()
    low, high = np.minimum(*place[np.stack(coo.coords)]), np.maximum(*place[np.stack(coo.coords)])
    # Links that a cut after place k severs: from k or before to behind it.
    severed = np.cumsum(np.bincount(low, coo.data, len(order)) - np.bincount(high, coo.data, len(order)))[:-1]
    done = np.cumsum(size[order])[:-1] / total
    allowed = np.abs(done - share) <= tuning.margin * min(share, 1 - share)
    # Neither side may need one block more than intended: an extra block costs more than a cut through ties.
    allowed &= (done * total <= blocks[0] * own) & ((1 - done) * total <= (blocks[1] - blocks[0]) * own)
    allowed[np.argmin(np.abs(done - share))] = True
    volume = np.cumsum(np.bincount(place[coo.coords[0]], coo.data, len(order)))
    cost = severed / np.maximum(np.minimum(volume[:-1], volume[-1] - volume[:-1]), 1e-12)
    return place <= np.argmin(np.where(allowed, cost, np.inf))


def _second_vector(graph: csr_array) -> np.ndarray:
    """(F,) second eigenvector of the normalised Laplacian over the root of the degrees: neighbours have near values."""
    degree = np.asarray(graph.sum(axis=1)).ravel()
    root = np.sqrt(np.maximum(degree, 1e-12))
    normal = diags_array(1 / root) @ graph @ diags_array(1 / root)
    solve = splu((diags_array(np.full(len(root), 1.0 + 1e-9)) - normal).tocsc()).solve
    first = root / np.linalg.norm(root)
    block = np.random.default_rng(0).normal(size=(len(root), _VECTORS))
    for _ in range(_ITERATIONS):
        block = solve(block)
        block -= np.outer(first, first @ block)
        block = np.linalg.qr(block)[0]
    _, turn = np.linalg.eigh(block.T @ (normal @ block))
    return (block @ turn[:, -1]) / root


# ---------------------------------------------------------------- lending


def _lent(
    graph: csr_array, pairs: csr_array, label: np.ndarray, size: np.ndarray, tuning: BlocksTuning
) -> list[np.ndarray]:
    """For every part (F,) bool: the frames it takes from its neighbours, of each those with the most ties to it."""
    count = label.max() + 1
    member = csr_array((np.ones(len(label)), label, np.arange(len(label) + 1)), shape=(len(label), count))
    between = (member.T @ pairs @ member).toarray()
    strength = csr_array(graph @ member).tocsc()  # of every frame to every part
    out = []
    for k in range(count):
        taken = np.zeros(len(label), bool)
        column = slice(strength.indptr[k], strength.indptr[k + 1])
        tied, value = strength.indices[column], strength.data[column]
        for other in np.flatnonzero(between[k] >= tuning.least_ties):
            mine = label[tied] == other
            if other != k:
                frames = tied[mine][np.argsort(-value[mine], kind="stable")]
                enough = np.searchsorted(np.cumsum(size[frames]), tuning.lent) + 1
                taken[frames[: np.maximum(enough, tuning.least_lent_frames)]] = True
        out.append(taken)
    return out
