"""Loose photographs without order or position: look-alikes are previewed first, then neighbours of neighbours.

Sample and propagate (Cui et al. 2017) with visual words as the prior. What is kept is decided as on the lattice of a
pass, only that here the neighbours in the graph of previews take the place of those in time: measured on 120 rendered
images and 79 photographs, a pair with 12 matches is true in 46 to 85 % of cases if the two images tie to the same
others, in 6 to 50 % if they do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from tiegraph.network.looks.words import ImageWords
from tiegraph.network.passes import PreviewBook
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.scene import Scene

ALL_LIMIT = 100  # images that are all previewed with one another: 4950 previews, half a minute
BEST = 5  # pairs of an image kept whatever their count, so that no image stands alone
SURE = 1.2  # times min_matches: a single preview must be surer than an average over neighbouring frames
PER_IMAGE = 25  # previews an image, the most beyond ALL_LIMIT images
START = 8  # look-alikes an image starts with: nine of ten share something
BY_NAME = 2  # next photographs by name an image starts with: a camera numbers its pictures
FRIENDS = 6  # neighbours of neighbours an image is previewed with in one round
HIT_RATE = 0.15  # a round in which fewer previews tie is the last
FEW_TIES = 4  # an image with fewer goes further down its list of look-alikes
EVERY = 4  # of the frames of passes, those compared with loose photographs
# Kept: count / min_matches, between the limits of the lattice, plus SUPPORT times the cosine of the two images' ties
# reaches ENOUGH. Measured: recall 0.82 at precision 0.74 (rendered), 0.87 at 0.96 (photographs); the count alone at
# equal precision 0.79 and 0.84.
FLOOR, CEILING = 2 / 3, 2.0
SUPPORT, ENOUGH = 3.0, 2.0
# Without words, random partners take the place of look-alikes and need many more previews.
RANDOM = 20
BLIND_SHARE = 0.06  # of all pairs
BLIND_BUDGET = 80_000
BLOCK = 512  # rows of the graph that are multiplied at once


@dataclass(frozen=True)
class _Nodes:
    """Images (N,) that take part, which of them are loose, and the words of all images of the scene."""

    image: np.ndarray
    loose: np.ndarray
    words: ImageWords | None

    def __len__(self) -> int:
        return len(self.image)

    def keys(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Sorted unique numbers of node pairs of which one at least is loose."""
        low, high = np.minimum(a, b).astype(np.int64), np.maximum(a, b)
        wanted = (low != high) & (self.loose[low] | self.loose[high])
        return np.unique((low * len(self) + high)[wanted])

    def split(self, key: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes a, b of pair numbers."""
        return key // len(self), key % len(self)

    def measure(self, key: np.ndarray, book: PreviewBook) -> np.ndarray:
        """Counts (K,) of pair numbers."""
        a, b = self.split(key)
        return book.measure(self.image[a], self.image[b])


def scored_pairs(
    scene: Scene, images: np.ndarray, book: PreviewBook, settings: NetworkSettings, words: ImageWords | None = None
) -> Pairs:
    """Pairs of loose images (K,) among each other and with the images of passes, by previews.

    Up to ALL_LIMIT images every pair is previewed; beyond, PER_IMAGE an image: look-alikes by ``words`` (of all images
    of the scene) and then neighbours of neighbours. Dropped pairs carry ``weak``.
    """
    if len(images) == 0:
        return Pairs.empty()
    ordered = np.flatnonzero((scene.track[scene.frame] >= 0) & (scene.step[scene.frame] % EVERY == 0))
    chosen = np.unique(np.concatenate([images, ordered]))
    nodes = _Nodes(chosen, np.isin(chosen, images), words)
    if len(nodes) <= ALL_LIMIT:
        key = nodes.keys(*np.triu_indices(len(nodes), k=1))
    else:
        key = _propagated(nodes, book, settings)
    a, b = nodes.split(key)
    i, j = nodes.image[a], nodes.image[b]
    score = nodes.measure(key, book)
    keep = supported(a, b, score, len(nodes), settings.min_matches) | _best(i, j, score, len(scene))
    source = "exhaustive" if words is None else "retrieval"
    return Pairs.make(i, j, source, score=score, dropped=np.where(keep, 0, REASONS.index("weak")))


def supported(a: np.ndarray, b: np.ndarray, score: np.ndarray, count: int, min_matches: int) -> np.ndarray:
    """(K,) bool: whether node pairs a, b (K,), (K,) of ``count`` nodes tie, by their preview counts (K,) and by the
    cosine between the rows of their ties to all nodes; a node counts as tied to itself."""
    level = np.clip(score / min_matches, FLOOR, CEILING)
    enough = np.zeros(len(a), bool)
    graph = _graph(a, b, score, count, min_matches, own=1.0)
    length = np.sqrt(np.asarray((graph * graph).sum(axis=1)).ravel())
    for start in range(0, len(a), BLOCK * 64):
        part = slice(start, start + BLOCK * 64)
        common = np.asarray((graph[a[part]] * graph[b[part]]).sum(axis=1)).ravel()
        cosine = common / (length[a[part]] * length[b[part]])
        enough[part] = level[part] + SUPPORT * cosine >= ENOUGH
    return enough & (score >= FLOOR * min_matches)


def _graph(a: np.ndarray, b: np.ndarray, score: np.ndarray, count: int, min_matches: int, own: float = 0) -> csr_array:
    """(N, N) sparse: 0 at ``min_matches`` and below, 1 at twice as many and above; ``own`` on the diagonal."""
    weight = np.clip(score / min_matches - 1, 0, 1)
    tied = weight > 0
    every = np.arange(count) if own else np.zeros(0, int)
    row, column = np.r_[a[tied], b[tied], every], np.r_[b[tied], a[tied], every]
    return csr_array((np.r_[weight[tied], weight[tied], np.full(len(every), own)], (row, column)), shape=(count, count))


def _propagated(nodes: _Nodes, book: PreviewBook, settings: NetworkSettings) -> np.ndarray:
    """Numbers of the node pairs that were previewed: look-alikes and neighbours by name first, then, while previews
    hit and the budget lasts, neighbours of neighbours; images with few ties go further down their list."""
    count = len(nodes)
    budget = PER_IMAGE * count
    if nodes.words is None:
        budget = max(BLIND_BUDGET, int(BLIND_SHARE * count * (count - 1) / 2))
    rng = np.random.default_rng(0)
    own = np.flatnonzero(nodes.loose)
    near = [nodes.keys(own[:-step], own[step:]) for step in range(1, BY_NAME + 1)]
    key = np.unique(np.concatenate([*near, _starts(nodes, own, 0, rng)]))
    depth = 0
    while True:
        score = nodes.measure(key, book)
        a, b = nodes.split(key)
        tied = score >= SURE * settings.min_matches
        degree = np.bincount(np.r_[a[tied], b[tied]], minlength=count)
        depth += 1
        lonely = own[degree[own] < FEW_TIES]
        deeper = _starts(nodes, lonely, depth, rng)
        friends = _friends(nodes, a, b, score, settings.min_matches)
        new = np.setdiff1d(np.union1d(friends, deeper), key)
        if not len(new) or len(key) + len(new) > budget:
            return key
        hits = nodes.measure(new, book) >= SURE * settings.min_matches
        key = np.union1d(key, new)
        if nodes.words is not None and hits.mean() < HIT_RATE:
            return key


def _starts(nodes: _Nodes, start: np.ndarray, depth: int, rng: np.random.Generator) -> np.ndarray:
    """Numbers of each start's START look-alikes of places depth * START onwards; without words RANDOM partners."""
    if nodes.words is None:
        repeated = np.repeat(start, RANDOM)
        return nodes.keys(repeated, rng.integers(0, len(nodes), len(repeated)))
    if not len(start):
        return np.zeros(0, np.int64)
    other, _ = nodes.words.among(nodes.image).nearest(START * (depth + 1), start)
    other = other[:, START * depth :]
    repeated = np.repeat(start, other.shape[1])[other.ravel() >= 0]
    return nodes.keys(repeated, other.ravel()[other.ravel() >= 0])


def _friends(nodes: _Nodes, a: np.ndarray, b: np.ndarray, score: np.ndarray, min_matches: int) -> np.ndarray:
    """Numbers of the FRIENDS new pairs of each node with most in common: ties to the same nodes, times likeness."""
    count = len(nodes)
    graph = _graph(a, b, score, count, min_matches)
    known = nodes.keys(a, b)
    out = [np.zeros(0, np.int64)]
    for start in range(0, count, BLOCK):
        rows = np.arange(start, min(start + BLOCK, count))
        common = (graph[rows] @ graph).tocoo()
        row, column, value = common.coords[0] + start, common.coords[1], common.data
        fresh = (row != column) & (nodes.loose[row] | nodes.loose[column])
        fresh &= ~np.isin(np.minimum(row, column).astype(np.int64) * count + np.maximum(row, column), known)
        row, column, value = row[fresh], column[fresh], value[fresh]
        if nodes.words is not None:
            value = value * nodes.words.between(nodes.image[row], nodes.image[column])
        order = np.lexsort((column, -value, row))
        rank = np.arange(len(order)) - np.searchsorted(row[order], row[order])
        chosen = order[rank < FRIENDS]
        out.append(nodes.keys(row[chosen], column[chosen]))
    return np.unique(np.concatenate(out))


def _best(i: np.ndarray, j: np.ndarray, score: np.ndarray, images: int) -> np.ndarray:
    """(K,) bool: among the BEST counts of either image, zero counts left out."""
    row = np.tile(np.arange(len(i)), 2)
    image, value = np.concatenate([i, j]), np.concatenate([score, score])
    order = np.lexsort((-value, image))
    rank = np.arange(len(order)) - np.searchsorted(image[order], image[order])
    out = np.zeros(len(i), bool)
    out[row[order[rank < BEST]]] = True
    return out & (score > 0)
