"""Loose photographs without order or position, and the words by which look-alikes are found.

Bags of visual words are learnt on the survey's own previews (Sivic & Zisserman 2003): two small two-level vocabularies
(Nister & Stewenius 2006) instead of VLAD (Jegou 2010; Arandjelovic 2013), because on 300 rendered images 40 retrieved
images hold 0.35 instead of 0.31 of the pairs that share 15 % of their surface, on 79 photographs 0.83 instead of 0.79
of the pairs that SIFT verifies. Nothing is downloaded.

Look-alikes are previewed first, then neighbours of neighbours: sample and propagate (Cui et al. 2017). Pairs are kept
as on the lattice of a pass, except that the neighbours in the graph of previews take the place of those in time: on
120 rendered images and 79 photographs, a pair with 12 matches is true in 46 to 85 % of cases if the two images tie to
the same others, in 6 to 50 % if they do not.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, hstack

from tiegraph.network.passes import Context
from tiegraph.network.tuning import Tuning
from tiegraph.scene.evidence import FEW
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.sorting import among_best

CHUNK = 40_000  # descriptors looked up at once
BLOCK = 256  # images whose similarities are held at once


@dataclass(frozen=True)
class BagsOfWords:
    """Weighted words of N images: rows of ``weights`` (N, W) have length 1, or 0 for an image without features."""

    weights: csr_array

    def __len__(self) -> int:
        return int(self.weights.shape[0])

    def among(self, images: np.ndarray) -> "BagsOfWords":
        """The words of some images (K,), in this order."""
        return BagsOfWords(csr_array(self.weights[images]))

    def nearest(
        self, count: int, queries: np.ndarray | None = None, wanted: Callable[[np.ndarray], np.ndarray] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The ``count`` most similar other images of each query: indices (Q, C) i4, -1 = no more, cosines (Q, C) f4.

        ``queries`` (Q,) indices, all images by default; ``wanted``, given indices (B,), returns (B, N) bool: which
        images may be named. Memory is linear in the images.
        """
        asked = np.arange(len(self)) if queries is None else np.asarray(queries)
        count = max(0, min(count, len(self) - 1))
        index = np.full((len(asked), count), -1, np.int32)
        cosine = np.zeros((len(asked), count), np.float32)
        turned = self.weights.T.tocsr() if count else None
        for start in range(0, len(asked) if count else 0, BLOCK):
            part = slice(start, start + BLOCK)
            rows = asked[part]
            block = (self.weights[rows] @ turned).toarray()
            block[np.arange(len(rows)), rows] = 0
            if wanted is not None:
                block = np.where(wanted(rows), block, 0)
            best = np.argpartition(-block, count - 1, axis=1)[:, :count]
            value = np.take_along_axis(block, best, axis=1)
            order = np.lexsort((best, -value), axis=1)
            cosine[part] = np.take_along_axis(value, order, axis=1)
            index[part] = np.where(cosine[part] > 0, np.take_along_axis(best, order, axis=1), -1)
        return index, cosine

    def between(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """(K,) f4 cosines of image pairs (K,), (K,)."""
        out = np.zeros(len(i), np.float32)
        for start in range(0, len(i), CHUNK):
            part = slice(start, start + CHUNK)
            out[part] = np.asarray((self.weights[i[part]] * self.weights[j[part]]).sum(axis=1)).ravel()
        return out


def bags_of_words(
    descriptors: Sequence[np.ndarray], training: int = 200_000, rounds: int = 8, vocabularies: int = 2
) -> BagsOfWords:
    """Words of images with root-SIFT descriptors (K, 128) u1 each; K = 0 is legal. Deterministic.

    ``descriptors`` is read a few times, image by image: it may load on demand. ``training``: descriptors from which
    a vocabulary is learnt, at most (100 MB), by so many ``rounds`` of k-means.
    """
    total = sum(len(d) for d in descriptors)
    if total == 0:
        return BagsOfWords(csr_array((len(descriptors), 1), dtype=np.float32))
    words = int(np.clip(total / 12, 256, 65536))  # 8 to 16 features a word are equally good from 79 to 300 images
    parts = []
    for seed in range(vocabularies):  # two with different starts find 0.01 to 0.02 more than one
        rng = np.random.default_rng(seed)
        taken = np.concatenate([d[rng.random(len(d)) < training / total] for d in descriptors])  # of all alike
        taken = taken.astype(np.float32).reshape(-1, 128)
        vocabulary = _learn(taken, words, seed, rounds)
        parts.append(_weighted(_counted(descriptors, vocabulary)))
    return BagsOfWords(_unit(csr_array(hstack(parts).tocsr(), dtype=np.float32)))


def words_of(context: Context) -> BagsOfWords:
    """The words of all images of a scene, by their previews."""
    return bags_of_words(context.descriptors())


def nearest_images(descriptors: Sequence[np.ndarray], count: int, **how: int) -> tuple[np.ndarray, np.ndarray]:
    """The ``count`` most similar images of each of N images with descriptors (K, 128) u1: indices (N, C) i4, -1 = no
    more, and cosines (N, C) f4, best first. Linear memory; 4000 images of 800 features take half a minute.
    ``how``: of ``bags_of_words``."""
    return bags_of_words(descriptors, **how).nearest(count)


@dataclass(frozen=True)
class _Vocabulary:
    """Two levels: cells (C, 128) f4, and the words (W_c, 128) f4 of each cell, numbered on from ``first`` (C + 1,)."""

    cells: np.ndarray
    words: tuple[np.ndarray, ...]
    first: np.ndarray

    def look_up(self, x: np.ndarray) -> np.ndarray:
        """(K,) word of each descriptor (K, 128)."""
        cell = _closest(x, self.cells)
        order = np.argsort(cell, kind="stable")
        bounds = np.searchsorted(cell[order], np.arange(len(self.cells) + 1))
        out = np.empty(len(x), np.int64)
        for c in np.flatnonzero(np.diff(bounds)):
            rows = order[bounds[c] : bounds[c + 1]]
            out[rows] = self.first[c] + _closest(x[rows], self.words[c])
        return out


def _learn(x: np.ndarray, words: int, seed: int, rounds: int) -> _Vocabulary:
    rng = np.random.default_rng(seed)
    side = max(1, round(np.sqrt(words)))
    cells = _k_means(x, side, rng, rounds)
    cell = _closest(x, cells)
    each = [
        _k_means(x[cell == c], side, rng, rounds) if (cell == c).any() else cells[c : c + 1] for c in range(len(cells))
    ]
    return _Vocabulary(cells, tuple(each), np.concatenate([[0], np.cumsum([len(w) for w in each])]))


def _k_means(x: np.ndarray, k: int, rng: np.random.Generator, rounds: int) -> np.ndarray:
    """At most ``k`` centres (C, 128) of descriptors (K, 128) by Lloyd's rounds from random starts."""
    k = min(k, len(x))
    centres = x[np.sort(rng.permutation(len(x))[:k])]
    for _ in range(rounds):
        label = _closest(x, centres)
        size = np.bincount(label, minlength=k)
        members = csr_array((np.ones(len(x), np.float32), (label, np.arange(len(x)))), shape=(k, len(x)))
        centres = np.where(size[:, None] > 0, (members @ x) / np.maximum(size, 1)[:, None], centres)
    return centres.astype(np.float32)


def _closest(x: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """(K,) nearest centre of each descriptor."""
    half = 0.5 * np.sum(centres * centres, axis=1)
    out = np.empty(len(x), np.int64)
    for start in range(0, len(x), CHUNK // 4):
        part = slice(start, start + CHUNK // 4)
        out[part] = np.argmax(x[part] @ centres.T - half, axis=1)
    return out


def _counted(descriptors: Sequence[np.ndarray], vocabulary: _Vocabulary) -> csr_array:
    """(N, W) how often each image has each word; many images are looked up together."""
    shape = len(descriptors), int(vocabulary.first[-1])
    rows: list[np.ndarray] = []
    held: list[np.ndarray] = []
    words: list[np.ndarray] = []
    for k, d in enumerate(descriptors):
        held.append(np.asarray(d, np.uint8).reshape(-1, 128))
        rows.append(np.full(len(d), k, np.int32))
        if k + 1 == len(descriptors) or sum(map(len, held)) >= CHUNK:
            words.append(vocabulary.look_up(np.concatenate(held).astype(np.float32)).astype(np.int32))
            held = []
    row, word = np.concatenate(rows), np.concatenate(words)
    return csr_array((np.ones(len(word), np.float32), (row, word)), shape=shape)


def _weighted(counts: csr_array) -> csr_array:
    """Term frequency and inverse document frequency, each damped; rows of length 1."""
    images = counts.shape[0]
    having = np.bincount(counts.indices, minlength=counts.shape[1])
    rare = np.log(images / np.clip(having, 1, images)) ** 0.5  # common words still count in a survey
    data = counts.data**0.5 * rare[counts.indices]  # burstiness: Jegou 2009
    return _unit(csr_array((data.astype(np.float32), counts.indices, counts.indptr), shape=counts.shape))


def _unit(rows: csr_array) -> csr_array:
    length = np.sqrt(np.asarray((rows * rows).sum(axis=1)).ravel())
    data = rows.data / np.repeat(np.maximum(length, 1e-12), np.diff(rows.indptr))
    return csr_array((data.astype(np.float32), rows.indices, rows.indptr), shape=rows.shape)


_ROWS = 512  # rows of the graph that are multiplied at once


@dataclass(frozen=True)
class _Nodes:
    """The participating images (N,), which of them are loose, and the words of all images of the scene."""

    image: np.ndarray
    loose: np.ndarray
    words: BagsOfWords

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

    def measure(self, key: np.ndarray, context: Context) -> np.ndarray:
        """Counts (K,) of pair numbers."""
        a, b = self.split(key)
        return context.cache.measure(self.image[a], self.image[b])


def scored_pairs(context: Context, images: np.ndarray, words: BagsOfWords) -> Pairs:
    """Pairs of loose images (K,) among each other and with the images of passes, by previews.

    As long as previews are free every pair is previewed; beyond, a number per image: look-alikes by ``words`` (of all
    images of the scene) and then neighbours of neighbours. Dropped pairs carry ``weak``.
    """
    if len(images) == 0:
        return Pairs.empty()
    scene, least, tuning = context.scene, context.settings.min_matches, context.tuning
    ordered = np.flatnonzero(
        (scene.sequence[scene.frame] >= 0) & (scene.sequence_index[scene.frame] % 4 == 0)  # one frame of four
    )
    chosen = np.unique(np.concatenate([images, ordered]))
    nodes = _Nodes(chosen, np.isin(chosen, images), words)
    if len(nodes) * (len(nodes) - 1) / 2 <= tuning.free_previews:
        key = nodes.keys(*np.triu_indices(len(nodes), k=1))
    else:
        key = _propagated(nodes, context)
    a, b = nodes.split(key)
    i, j = nodes.image[a], nodes.image[b]
    score = nodes.measure(key, context)
    keep = supported((a, b), score, len(nodes), least, tuning)
    keep |= among_best(np.r_[i, j], np.r_[score, score], tuning.best_photos).reshape(2, -1).any(axis=0) & (score > 0)
    return Pairs.make(i, j, "retrieval", score=score, dropped=np.where(keep, 0, REASONS.index("weak")))


def supported(
    nodes: tuple[np.ndarray, np.ndarray], score: np.ndarray, count: int, min_matches: int, tuning: Tuning
) -> np.ndarray:
    """(K,) bool: whether node pairs a, b (K,), (K,) of ``count`` nodes tie, by their preview counts (K,) and by the
    cosine between the rows of their ties to all nodes; a node counts as tied to itself."""
    (a, b), counts = nodes, tuning.counts
    level = np.clip(score / min_matches, counts.floor, counts.ceiling)
    enough = np.zeros(len(a), bool)
    graph = _graph(a, b, score, count, min_matches, own=1.0)
    length = np.sqrt((graph * graph).sum(axis=1))
    for start in range(0, len(a), _ROWS * 64):
        part = slice(start, start + _ROWS * 64)
        common = (graph[a[part]] * graph[b[part]]).sum(axis=1)
        cosine = common / (length[a[part]] * length[b[part]])
        enough[part] = level[part] + tuning.retrieval.support * cosine >= counts.ceiling
    return enough & (score >= counts.floor * min_matches)


def _graph(a: np.ndarray, b: np.ndarray, score: np.ndarray, count: int, min_matches: int, own: float = 0) -> csr_array:
    """(N, N) sparse: 0 at ``min_matches`` and below, 1 at twice as many and above; ``own`` on the diagonal."""
    weight = np.clip(score / min_matches - 1, 0, 1)
    tied = weight > 0
    every = np.arange(count) if own else np.zeros(0, int)
    row, column = np.r_[a[tied], b[tied], every], np.r_[b[tied], a[tied], every]
    return csr_array((np.r_[weight[tied], weight[tied], np.full(len(every), own)], (row, column)), shape=(count, count))


def _propagated(nodes: _Nodes, context: Context) -> np.ndarray:
    """Numbers of the previewed node pairs: look-alikes and neighbours by name, then, while previews tie and the budget
    lasts, neighbours of neighbours; images with few ties go further down their list."""
    count, tuning, least = len(nodes), context.tuning, context.settings.min_matches
    sure, each = tuning.counts.sure * least, tuning.retrieval.look_alikes
    budget = tuning.previews_an_image * count
    own = np.flatnonzero(nodes.loose)
    near = [nodes.keys(own[:-step], own[step:]) for step in range(1, context.settings.sequence_frames + 1)]
    key = np.unique(np.concatenate([*near, _starts(nodes, own, 0, each)]))
    depth = 0
    while True:
        score = nodes.measure(key, context)
        a, b = nodes.split(key)
        tied = score >= sure
        degree = np.bincount(np.r_[a[tied], b[tied]], minlength=count)
        depth += 1
        lonely = own[degree[own] < FEW]
        deeper = _starts(nodes, lonely, depth, each)
        friends = _friends(nodes, (a, b), score, least, each)
        new = np.setdiff1d(np.union1d(friends, deeper), key)
        if not len(new) or len(key) + len(new) > budget:
            return key
        hits = nodes.measure(new, context) >= sure
        key = np.union1d(key, new)
        if hits.mean() < tuning.retrieval.hit_rate:
            return key


def _starts(nodes: _Nodes, start: np.ndarray, depth: int, each: int) -> np.ndarray:
    """Numbers of ``each`` look-alikes of every start, further down its list with ``depth``."""
    if not len(start):
        return np.zeros(0, np.int64)
    other, _ = nodes.words.among(nodes.image).nearest(each * (depth + 1), start)
    other = other[:, each * depth :]
    repeated = np.repeat(start, other.shape[1])[other.ravel() >= 0]
    return nodes.keys(repeated, other.ravel()[other.ravel() >= 0])


def _friends(
    nodes: _Nodes, known: tuple[np.ndarray, np.ndarray], score: np.ndarray, min_matches: int, each: int
) -> np.ndarray:
    """Numbers of the new pairs, ``each`` for a node, with the highest score: common ties times similarity."""
    (a, b), count = known, len(nodes)
    graph = _graph(a, b, score, count, min_matches)
    old = nodes.keys(a, b)
    out = [np.zeros(0, np.int64)]
    for start in range(0, count, _ROWS):
        rows = np.arange(start, min(start + _ROWS, count))
        common = (graph[rows] @ graph).sorted_indices().tocoo()
        row, column, value = common.coords[0] + start, common.coords[1], common.data
        fresh = (row != column) & (nodes.loose[row] | nodes.loose[column])
        fresh &= ~np.isin(np.minimum(row, column).astype(np.int64) * count + np.maximum(row, column), old)
        row, column, value = row[fresh], column[fresh], value[fresh]
        value = value * nodes.words.between(nodes.image[row], nodes.image[column])
        chosen = among_best(row, value, each)
        out.append(nodes.keys(row[chosen], column[chosen]))
    return np.unique(np.concatenate(out))
