"""Bags of visual words learnt on the survey's own previews, to find look-alikes (Sivic & Zisserman 2003).

Two small two-level vocabularies (Nister & Stewenius 2006) instead of VLAD (Jegou 2010; Arandjelovic 2013): measured on
300 rendered images, 40 retrieved images hold 0.35 instead of 0.31 of the pairs that share 15 % of their surface, on 79
photographs 0.83 instead of 0.79 of the pairs that SIFT verifies; whitening by the few images of one survey makes VLAD
worse (0.23). Nothing is downloaded.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, hstack

from tiegraph.network.tuning.retrieval import VocabularyTuning

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


def bags_of_words(descriptors: Sequence[np.ndarray], tuning: VocabularyTuning) -> BagsOfWords:
    """Words of images with root-SIFT descriptors (K, 128) u1 each; K = 0 is legal. Deterministic.

    ``descriptors`` is read a few times, image by image: it may load on demand.
    """
    total = sum(len(d) for d in descriptors)
    if total == 0:
        return BagsOfWords(csr_array((len(descriptors), 1), dtype=np.float32))
    words = int(np.clip(total / 12, 256, 65536))  # 8 to 16 features a word are equally good from 79 to 300 images
    parts = []
    for seed in range(tuning.vocabularies):
        # (K, 128) f4 descriptors, the same share of every image
        share = min(1.0, tuning.training / total)
        rng = np.random.default_rng(seed)
        taken = [d[rng.random(len(d)) < share] for d in descriptors]
        taken = np.concatenate(taken).astype(np.float32).reshape(-1, 128)
        vocabulary = _learn(taken, words, seed, tuning.rounds)
        parts.append(_weighted(_counted(descriptors, vocabulary)))
    both = csr_array(hstack(parts).tocsr(), dtype=np.float32)
    return BagsOfWords(_unit(both))


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
    """(N, W) how often each image has each word; many images are looked up together, to have few calls for many
    words."""
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
