"""Tracks of the design: the preview features joined by the chosen pairs, and the tracks one more pair would join."""

from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array

from tiegraph.design.tuning import NetTuning
from tiegraph.scene.pairs import PreviewMatches
from tiegraph.scene.sorting import BLOCK, blocks, spread, unite


@dataclass(frozen=True)
class Candidates:
    """E pairs a design may choose from, in an order of their own.

    ``expected`` (E,) matches of the previews, measured or expected, > 0; the matches of pair e are ``left`` and
    ``right`` (nodes: features that match anything, numbered image by image) from ``start[e]`` to ``start[e + 1]``;
    ``seen`` (E,): previewed, so that its matches are known; ``first`` (N + 1,) first node of every image.
    """

    i: np.ndarray
    j: np.ndarray
    expected: np.ndarray
    seen: np.ndarray
    start: np.ndarray
    left: np.ndarray
    right: np.ndarray
    first: np.ndarray

    def __len__(self) -> int:
        return len(self.i)

    @property
    def images(self) -> int:
        """Number of images."""
        return len(self.first) - 1

    @staticmethod
    def make(
        i: np.ndarray, j: np.ndarray, expected: np.ndarray, ties: PreviewMatches | None, images: int
    ) -> "Candidates":
        """Candidates of pairs i < j (E,) from the preview matches of those that were previewed."""
        ties = PreviewMatches.empty() if ties is None else ties
        row = ties.find(i, j)
        count = np.where(row >= 0, np.append(ties.counts(), 0)[row], 0)
        start = np.concatenate([[0], np.cumsum(count)])
        width = int(ties.matches.max(initial=0)) + 1
        whole = np.int32 if images * width < 1 << 31 else np.int64
        left, right = np.empty(start[-1], whole), np.empty(start[-1], whole)
        number = np.zeros(images * width + 1, np.int32)  # of the feature of every image, used or not
        for pairs in blocks(start):
            own = slice(start[pairs.start], start[pairs.stop])
            match = ties.matches[spread(ties.start[row[pairs]], count[pairs])]
            left[own] = np.repeat(i[pairs].astype(whole), count[pairs]) * width + match[:, 0]
            right[own] = np.repeat(j[pairs].astype(whole), count[pairs]) * width + match[:, 1]
            number[1:][left[own]] = number[1:][right[own]] = 1
        np.cumsum(number, out=number)
        for ends in (left, right):
            for k in range(0, len(ends), BLOCK):
                ends[k : k + BLOCK] = number[ends[k : k + BLOCK]]
        return Candidates(
            i=i,
            j=j,
            expected=np.maximum(expected, 1.0),
            seen=(row >= 0) & (count > 0),
            start=start,
            left=left,
            right=right,
            first=number[::width][: images + 1].copy(),
        )


class Tracks:
    """Sets of nodes joined so far (union-find), and for pairs without a preview the tracks they are expected to join.

    The design's only state that changes: ``choose`` joins. An unseen pair (i, j) is expected to join its expected
    matches less the tracks that contain both images already, ``J``. Choosing it joins ``v`` unknown tracks, so the
    expectation is propagated: ``extra`` of (i, j) grows by v, and of every candidate (i, k) by v times the share of j's
    features that k shares with j (one step, as if these v were any of j's features).
    """

    def __init__(self, candidates: Candidates, tuning: NetTuning) -> None:
        self.candidates = candidates
        self._tuning = tuning
        self.parent = np.arange(candidates.first[-1], dtype=np.int32)
        self.extra = np.zeros(len(candidates))
        self.chosen = np.zeros(len(candidates), bool)
        self.shared = np.zeros(len(candidates))  # J of unseen pairs
        self._joint: csr_array | None = None
        most = np.zeros(candidates.images)
        np.maximum.at(most, candidates.i, candidates.expected)
        np.maximum.at(most, candidates.j, candidates.expected)
        self.features = np.maximum(np.diff(candidates.first), most)

    def new(self) -> np.ndarray:
        """(E,) tracks each pair would join: counted where its matches are known, else expected."""
        c = self.candidates
        out = np.maximum(c.expected - self.shared - self.extra, 0.0)
        known = self._counted()
        out[c.seen] = np.maximum(known[c.seen] - self.extra[c.seen], 0.0)
        out[self.chosen] = 0.0
        return out

    def _counted(self) -> np.ndarray:
        """(E,) matches whose two nodes are not joined yet."""
        c = self.candidates
        apart = np.zeros(int(c.start[-1]), bool)
        for k in range(0, len(apart), BLOCK):
            block = slice(k, k + BLOCK)
            apart[block] = self.parent[c.left[block]] != self.parent[c.right[block]]
        total = np.concatenate([[0], np.cumsum(apart, dtype=np.int32)])
        return np.diff(total[c.start]).astype(float)

    def choose(self, places: np.ndarray, new: np.ndarray) -> None:
        """Join the tracks of the candidates at places (K,), which were to join ``new`` (E,)."""
        c = self.candidates
        self.chosen[places] = True
        self.join(places[c.seen[places]])
        unseen = places[~c.seen[places]]
        if not c.seen.all():
            matrix = self.joint()
            wanted = np.flatnonzero(~c.seen & ~self.chosen)
            self.shared[wanted] = entries(matrix, c.i[wanted], c.j[wanted])
            if len(unseen):
                self._expect(unseen, new[unseen], matrix)

    def join(self, places: np.ndarray) -> None:
        """Join the matches of the candidates at places (K,), all of them seen. A track is named by its first node, in
        whatever order it was joined."""
        self._joint = None
        c = self.candidates
        count = np.diff(c.start)[places]
        own = blocks(np.concatenate([[0], np.cumsum(count)]))
        rows = (spread(c.start[places[k]], count[k]) for k in own)
        self.parent = unite(self.parent, ((c.left[at], c.right[at]) for at in rows))

    def copy(self) -> "Tracks":
        """A copy, to be joined further independently."""
        other = copy(self)
        other.parent, other.chosen = self.parent.copy(), self.chosen.copy()
        other.extra, other.shared = self.extra.copy(), self.shared.copy()
        return other

    def _expect(self, places: np.ndarray, new: np.ndarray, joint: csr_array) -> None:
        """Propagate the tracks joined by unseen pairs to the pairs beside them."""
        c, n = self.candidates, self.candidates.images
        self.extra[places] += new
        v = _symmetric(c.i[places], c.j[places], new, n)
        both = joint + _symmetric(c.i, c.j, self.extra, n)
        share = diags_array(1.0 / np.maximum(self.features, 1.0)) @ both
        share.data = np.minimum(share.data, 1.0)
        carried = csr_array(v @ share)
        carried.sum_duplicates()
        self.extra += entries(carried, c.i, c.j) + entries(carried, c.j, c.i)

    def incidence(self) -> csr_array:
        """(N, T) observations of the tracks of at least two nodes in each image.

        A few wrong matches are enough to make one track of a large part of all features. It would link every image
        with every other: a track of more than ``wide_images`` counts as one track for each so many in a row.
        """
        most = self._tuning.wide_images
        label, first = self.parent, self.candidates.first
        size = np.bincount(label, minlength=len(label))
        wide = np.flatnonzero(size[label] > most)
        if len(wide):
            image = np.searchsorted(first, wide, side="right") - 1
            views = np.bincount(np.unique(label[wide].astype(np.int64) << 32 | image) >> 32, minlength=len(size))
            wide, image = wide[views[label[wide]] > most], image[views[label[wide]] > most]
            piece = np.unique(label[wide].astype(np.int64) << 32 | image // most, return_inverse=True)[1]
            label = label.copy()
            label[wide] = len(size) + piece
            size = np.bincount(label)
        kept = size[label] >= 2
        number = np.cumsum(size >= 2) - 1
        column = number[label[kept]]
        start = np.concatenate([[0], np.cumsum(kept)])[first]
        shape = (self.candidates.images, int(np.sum(size >= 2)))
        out = csr_array((np.ones(len(column), np.float32), column, start), shape=shape)
        out.sum_duplicates()  # a wrong track has many features of one image, and products would take them one by one
        return out

    def pieces(self) -> np.ndarray:
        """(N,) tracks and single features by image, a track divided among its observations; an image that was never
        previewed has as many single features as its pairs expect."""
        size = np.bincount(self.parent, minlength=len(self.parent))
        first = self.candidates.first
        total = np.concatenate([[0.0], np.cumsum(1.0 / size[self.parent])])
        return np.diff(total[first]) + np.maximum(self.features - np.diff(first), 0.0)

    def joint(self) -> csr_array:
        """(N, N) tracks that two images share; computed once after each joining, because it is the slowest step."""
        if self._joint is None:
            seen = self.incidence()
            self._joint = csr_array(seen @ seen.T)
            self._joint.sort_indices()
        return self._joint


def _symmetric(i: np.ndarray, j: np.ndarray, value: np.ndarray, n: int) -> csr_array:
    row, column = np.concatenate([i, j]), np.concatenate([j, i])
    return coo_array((np.tile(value, 2), (row, column)), shape=(n, n)).tocsr()


def entries(matrix: csr_array, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(K,) entries of a sparse matrix at rows i and columns j (K,), zero where it has none."""
    matrix.sum_duplicates()
    return np.asarray(matrix[i, j]) if len(i) else np.zeros(0)
