"""Loose photographs without order or position: previews find their neighbours, and neighbours' neighbours."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from tiegraph.network.passes import PreviewBook
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.scene import Scene

ALL_LIMIT = 400  # images that are all previewed with one another: 80 000 previews, minutes
BEST = 5  # pairs of an image kept whatever their count, so that no image stands alone
SURE = 1.2  # times min_matches: a single preview must be surer than an average over neighbouring frames
BY_NAME = 6  # next photographs by name an image starts with: a camera numbers its pictures
RANDOM = 20  # random partners an image starts with, and gets again while it has few ties
FEW_TIES = 4
FRIENDS = 40  # neighbours of neighbours an image is previewed with in one round
PREVIEW_SHARE = 0.06  # of all pairs: the most that previews may take beyond ALL_LIMIT images
EVERY = 4  # of the frames of passes, those compared with loose photographs


def scored_pairs(scene: Scene, images: np.ndarray, book: PreviewBook, settings: NetworkSettings) -> Pairs:
    """Pairs of loose images (K,) among each other and with the images of passes, by preview counts.

    Up to ALL_LIMIT images every pair is previewed; beyond, some pairs first and then neighbours of neighbours (sample
    and propagate, Cui et al. 2017). Dropped pairs carry ``weak``.
    """
    if len(images) == 0:
        return Pairs.empty()
    ordered = np.flatnonzero((scene.track[scene.frame] >= 0) & (scene.step[scene.frame] % EVERY == 0))
    nodes = np.unique(np.concatenate([images, ordered]))
    loose = np.isin(nodes, images)
    if len(nodes) <= ALL_LIMIT:
        a, b = np.triu_indices(len(nodes), k=1)
        wanted = loose[a] | loose[b]
        i, j = nodes[a[wanted]], nodes[b[wanted]]
        score = book.measure(i, j)
    else:
        i, j, score = _propagated(nodes, loose, book, settings)
    keep = (score >= SURE * settings.min_matches) | _best(i, j, score, len(scene))
    return Pairs.make(i, j, "exhaustive", score=score, dropped=np.where(keep, 0, REASONS.index("weak")))


def _propagated(
    nodes: np.ndarray, loose: np.ndarray, book: PreviewBook, settings: NetworkSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rounds of previews: neighbours by name and random partners first, then neighbours of neighbours; images that
    still have few ties get more random partners while the budget lasts."""
    rng = np.random.default_rng(0)
    count = len(nodes)
    budget = max(ALL_LIMIT**2 // 2, int(PREVIEW_SHARE * count * (count - 1) / 2))
    own = np.flatnonzero(loose)
    near = np.concatenate([np.stack([own[:-step], own[step:]]) for step in range(1, BY_NAME + 1)], axis=1)
    key = np.union1d(_keys(near[0], near[1], count), _random(own, count, rng))
    while True:
        a, b = key // count, key % count
        tied = book.measure(nodes[a], nodes[b]) >= SURE * settings.min_matches
        degree = np.bincount(np.r_[a[tied], b[tied]], minlength=count)
        more = np.union1d(_friends(a[tied], b[tied], loose), _random(own[degree[own] < FEW_TIES], count, rng))
        new = np.setdiff1d(more, key)
        if not len(new) or len(key) + len(new) > budget:
            return nodes[a], nodes[b], book.measure(nodes[a], nodes[b])
        key = np.union1d(key, new)


def _random(starts: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Keys of RANDOM partners for each start."""
    repeated = np.repeat(starts, RANDOM)
    return _keys(repeated, rng.integers(0, count, len(repeated)), count)


def _keys(a: np.ndarray, b: np.ndarray, count: int) -> np.ndarray:
    low, high = np.minimum(a, b).astype(np.int64), np.maximum(a, b)
    return np.unique((low * count + high)[low != high])


def _friends(a: np.ndarray, b: np.ndarray, loose: np.ndarray) -> np.ndarray:
    """Keys of the FRIENDS node pairs of each node with most common neighbours."""
    count = len(loose)
    graph = csr_array((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, a])), shape=(count, count))
    common = (graph @ graph).tocoo()
    row, column, value = common.coords[0], common.coords[1], common.data
    wanted = (row != column) & (loose[row] | loose[column])
    row, column, value = row[wanted], column[wanted], value[wanted]
    order = np.lexsort((-value, row))
    rank = np.arange(len(order)) - np.searchsorted(row[order], row[order])
    chosen = order[rank < FRIENDS]
    return _keys(row[chosen], column[chosen], count)


def _best(i: np.ndarray, j: np.ndarray, score: np.ndarray, images: int) -> np.ndarray:
    """(K,) bool: among the BEST counts of either image, zero counts left out."""
    row = np.tile(np.arange(len(i)), 2)
    image, value = np.concatenate([i, j]), np.concatenate([score, score])
    order = np.lexsort((-value, image))
    rank = np.arange(len(order)) - np.searchsorted(image[order], image[order])
    out = np.zeros(len(i), bool)
    out[row[order[rank < BEST]]] = True
    return out & (score > 0)
