"""Loose photographs without order or position: look-alikes are previewed first, then neighbours of neighbours.

Sample and propagate (Cui et al. 2017) with visual words as the prior. Pairs are kept as on the lattice of a pass,
except that the neighbours in the graph of previews take the place of those in time: measured on 120 rendered images
and 79 photographs, a pair with 12 matches is true in 46 to 85 % of cases if the two images tie to the same others, in
6 to 50 % if they do not.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from tiegraph.network.passes import MatchCache
from tiegraph.network.retrieval.vocabulary import BagsOfWords
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.network.tuning.retrieval import LooseTuning
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import among_best

BLOCK = 512  # rows of the graph that are multiplied at once


@dataclass(frozen=True)
class _Nodes:
    """The participating images (N,), which of them are loose, and the words of all images of the scene."""

    image: np.ndarray
    loose: np.ndarray
    words: BagsOfWords | None

    def __len__(self) -> int:
        return len(self.image)

    def keys(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Sorted unique numbers of node pairs with at least one loose image."""
        low, high = np.minimum(a, b).astype(np.int64), np.maximum(a, b)
        wanted = (low != high) & (self.loose[low] | self.loose[high])
        return np.unique((low * len(self) + high)[wanted])

    def split(self, key: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes a, b of pair numbers."""
        return key // len(self), key % len(self)

    def measure(self, key: np.ndarray, cache: MatchCache) -> np.ndarray:
        """Counts (K,) of pair numbers."""
        a, b = self.split(key)
        return cache.measure(self.image[a], self.image[b])


def scored_pairs(
    scene: Scene,
    images: np.ndarray,
    cache: MatchCache,
    settings: CandidatesSettings,
    tuning: Tuning,
    words: BagsOfWords | None = None,
) -> Pairs:
    """Pairs of loose images (K,) among each other and with the images of passes, by previews.

    Up to ``all_limit`` images every pair is previewed; beyond, a number per image: look-alikes by ``words`` (of all
    images of the scene) and then neighbours of neighbours. Dropped pairs carry ``weak``.
    """
    if len(images) == 0:
        return Pairs.empty()
    loose = tuning.retrieval.loose
    ordered = np.flatnonzero(
        (scene.sequence[scene.frame] >= 0) & (scene.sequence_index[scene.frame] % 4 == 0)  # one frame of four
    )
    chosen = np.unique(np.concatenate([images, ordered]))
    nodes = _Nodes(chosen, np.isin(chosen, images), words)
    if len(nodes) <= loose.all_limit:
        key = nodes.keys(*np.triu_indices(len(nodes), k=1))
    else:
        key = _propagated(nodes, cache, settings.min_matches, tuning)
    a, b = nodes.split(key)
    i, j = nodes.image[a], nodes.image[b]
    score = nodes.measure(key, cache)
    keep = supported((a, b), score, len(nodes), settings.min_matches, tuning)
    keep |= among_best(np.r_[i, j], np.r_[score, score], loose.best).reshape(2, -1).any(axis=0) & (score > 0)
    source = "exhaustive" if words is None else "retrieval"
    return Pairs.make(i, j, source, score=score, dropped=np.where(keep, 0, REASONS.index("weak")))


def supported(
    nodes: tuple[np.ndarray, np.ndarray], score: np.ndarray, count: int, min_matches: int, tuning: Tuning
) -> np.ndarray:
    """(K,) bool: whether node pairs a, b (K,), (K,) of ``count`` nodes tie, by their preview counts (K,) and by the
    cosine between the rows of their ties to all nodes; a node counts as tied to itself."""
    (a, b), counts, loose = nodes, tuning.counts, tuning.retrieval.loose
    level = np.clip(score / min_matches, counts.floor, counts.ceiling)
    enough = np.zeros(len(a), bool)
    graph = _graph(a, b, score, count, min_matches, own=1.0)
    length = np.sqrt(np.asarray((graph * graph).sum(axis=1)).ravel())
    for start in range(0, len(a), BLOCK * 64):
        part = slice(start, start + BLOCK * 64)
        common = np.asarray((graph[a[part]] * graph[b[part]]).sum(axis=1)).ravel()
        cosine = common / (length[a[part]] * length[b[part]])
        enough[part] = level[part] + loose.support * cosine >= loose.enough
    return enough & (score >= counts.floor * min_matches)


def _graph(a: np.ndarray, b: np.ndarray, score: np.ndarray, count: int, min_matches: int, own: float = 0) -> csr_array:
    """(N, N) sparse: 0 at ``min_matches`` and below, 1 at twice as many and above; ``own`` on the diagonal."""
    weight = np.clip(score / min_matches - 1, 0, 1)
    tied = weight > 0
    every = np.arange(count) if own else np.zeros(0, int)
    row, column = np.r_[a[tied], b[tied], every], np.r_[b[tied], a[tied], every]
    return csr_array((np.r_[weight[tied], weight[tied], np.full(len(every), own)], (row, column)), shape=(count, count))


def _propagated(nodes: _Nodes, cache: MatchCache, min_matches: int, tuning: Tuning) -> np.ndarray:
    """Numbers of the previewed node pairs: look-alikes and neighbours by name first, then, while previews tie and the
    budget lasts, neighbours of neighbours; images with few ties go further down their list."""
    count, loose, sure = len(nodes), tuning.retrieval.loose, tuning.retrieval.sure_alike * min_matches
    budget = tuning.previews_an_image * count
    if nodes.words is None:
        budget = max(80_000, int(0.06 * count * (count - 1) / 2))
    rng = np.random.default_rng(0)
    own = np.flatnonzero(nodes.loose)
    near = [nodes.keys(own[:-step], own[step:]) for step in range(1, loose.by_name + 1)]
    key = np.unique(np.concatenate([*near, _starts(nodes, own, 0, rng, loose)]))
    depth = 0
    while True:
        score = nodes.measure(key, cache)
        a, b = nodes.split(key)
        tied = score >= sure
        degree = np.bincount(np.r_[a[tied], b[tied]], minlength=count)
        depth += 1
        lonely = own[degree[own] < loose.few_ties]
        deeper = _starts(nodes, lonely, depth, rng, loose)
        friends = _friends(nodes, (a, b), score, min_matches, 6)
        new = np.setdiff1d(np.union1d(friends, deeper), key)
        if not len(new) or len(key) + len(new) > budget:
            return key
        hits = nodes.measure(new, cache) >= sure
        key = np.union1d(key, new)
        if nodes.words is not None and hits.mean() < loose.hit_rate:
            return key


def _starts(nodes: _Nodes, start: np.ndarray, depth: int, rng: np.random.Generator, tuning: LooseTuning) -> np.ndarray:
    """Numbers of each start's look-alikes, the next ones of its list with each ``depth``; random partners without
    words."""
    if nodes.words is None:
        repeated = np.repeat(start, 20)
        return nodes.keys(repeated, rng.integers(0, len(nodes), len(repeated)))
    if not len(start):
        return np.zeros(0, np.int64)
    other, _ = nodes.words.among(nodes.image).nearest(tuning.start * (depth + 1), start)
    other = other[:, tuning.start * depth :]
    repeated = np.repeat(start, other.shape[1])[other.ravel() >= 0]
    return nodes.keys(repeated, other.ravel()[other.ravel() >= 0])


def _friends(
    nodes: _Nodes, known: tuple[np.ndarray, np.ndarray], score: np.ndarray, min_matches: int, most: int
) -> np.ndarray:
    """Numbers of the new pairs, ``most`` for each node, with the highest score: common ties times similarity."""
    (a, b), count = known, len(nodes)
    graph = _graph(a, b, score, count, min_matches)
    old = nodes.keys(a, b)
    out = [np.zeros(0, np.int64)]
    for start in range(0, count, BLOCK):
        rows = np.arange(start, min(start + BLOCK, count))
        common = (graph[rows] @ graph).sorted_indices().tocoo()
        row, column, value = common.coords[0] + start, common.coords[1], common.data
        fresh = (row != column) & (nodes.loose[row] | nodes.loose[column])
        fresh &= ~np.isin(np.minimum(row, column).astype(np.int64) * count + np.maximum(row, column), old)
        row, column, value = row[fresh], column[fresh], value[fresh]
        if nodes.words is not None:
            value = value * nodes.words.between(nodes.image[row], nodes.image[column])
        chosen = among_best(row, value, most)
        out.append(nodes.keys(row[chosen], column[chosen]))
    return np.unique(np.concatenate(out))
