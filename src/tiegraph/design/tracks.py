"""Tracks of the design (the preview features joined by the chosen pairs, and the tracks one more pair would join), and
the accuracy that they give.

The network is adjusted like a levelling net, one unknown an image: an image is an unknown height, a track of k images k
observations of one unknown point. Eliminating the points leaves the normal matrix L = sum over tracks (I - 1 1^T / k),
a graph Laplacian: the one-dimensional bundle adjustment. Its pseudo-inverse gives the variance of the difference of two
images (effective resistance) and of all images.
"""

from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from tiegraph.design.tuning import NetTuning
from tiegraph.scene.graph import symmetric
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
        v = symmetric(c.i[places], c.j[places], new, n)
        both = joint + symmetric(c.i, c.j, self.extra, n)
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


def entries(matrix: csr_array, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(K,) entries of a sparse matrix at rows i and columns j (K,), zero where it has none."""
    matrix.sum_duplicates()
    return np.asarray(matrix[i, j]) if len(i) else np.zeros(0)


_GROUND = 1e-7  # of the mean diagonal: makes the matrix of a floating net regular


def laplacian(i: np.ndarray, j: np.ndarray, weight: np.ndarray, nodes: int) -> csr_array:
    """(n, n) Laplacian of weighted links i, j (K,); links of a node with itself do not count."""
    weight = np.where(i == j, 0.0, weight)
    degree = np.bincount(i, weight, nodes) + np.bincount(j, weight, nodes)
    return csr_array(symmetric(i, j, -weight, nodes) + diags_array(degree))


def of_tracks(seen: csr_array) -> csr_array:
    """(N, N) Laplacian of tracks from the observations (N, T): every track eliminated."""
    size = np.asarray(seen.sum(axis=0)).ravel()
    share = csr_array(seen @ diags_array(1.0 / np.maximum(size, 1.0)))
    return csr_array(diags_array(np.asarray(seen.sum(axis=1)).ravel()) - share @ seen.T)


class Net:
    """A Laplacian factorised once: resistances between nodes and the mean variance of the nodes."""

    def __init__(self, matrix: csr_array, tuning: NetTuning) -> None:
        self._tuning = tuning
        self.nodes = matrix.shape[0]
        self.part = connected_components(matrix, directed=False)[1]
        self._size = np.bincount(self.part)
        self._rng = np.random.default_rng(0)
        self._matrix = matrix
        self._dense = self._inverse(matrix) if self.nodes <= 700 else None
        if self._dense is None:
            ground = _GROUND * max(float(matrix.diagonal().mean()), 1e-12)
            grounded = (matrix + ground * eye_array(self.nodes)).tocsc()
            self._factor = splu(grounded, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def _inverse(self, matrix: csr_array) -> np.ndarray:
        """Pseudo-inverse: with the mean of every component fixed the matrix is regular."""
        same = self.part[:, None] == self.part[None]
        mean = np.where(same, 1.0 / self._size[self.part][:, None], 0.0)
        scale = max(float(matrix.diagonal().mean()), 1e-12)
        return np.linalg.inv(matrix.toarray() + scale * mean) - mean / scale

    def resistance(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """(K,) effective resistance between nodes i and j (K,); inf between components."""
        if self._dense is not None:
            diagonal = np.diag(self._dense)
            out = diagonal[i] + diagonal[j] - 2 * self._dense[i, j]
        else:
            sample = self._samples()
            out = np.empty(len(i))
            for k in range(0, len(i), 1 << 18):
                block = slice(k, k + (1 << 18))
                out[block] = np.mean((sample[i[block]] - sample[j[block]]) ** 2, axis=1)
        return np.where(self.part[i] == self.part[j], np.maximum(out, 0.0), np.inf)

    def _samples(self) -> np.ndarray:
        """(n, draws) f4 random draws of the nodes with the pseudo-inverse as covariance."""
        upper = self._matrix.tocoo()
        link = upper.row < upper.col
        row, col, weight = upper.row[link], upper.col[link], np.sqrt(np.maximum(-upper.data[link], 0.0))
        right = np.empty((self.nodes, self._tuning.draws))
        for k in range(self._tuning.draws):
            noise = weight * self._rng.choice((-1.0, 1.0), len(weight))
            right[:, k] = np.bincount(row, noise, self.nodes) - np.bincount(col, noise, self.nodes)
        return self._factor.solve(right).astype(np.float32)

    def variance(self) -> float:
        """Mean variance of the nodes about the mean of their component (trace of the pseudo-inverse by nodes).

        Of a large net an estimate: the part of a few long waves exactly, the rest at random (Hutch++, Meyer et al.
        2021, arXiv 2010.09649); plain random vectors would be off by a fifth, because long waves are most of it.
        """
        if self._dense is not None:
            return float(np.trace(self._dense)) / self.nodes
        waves = self._centred(self._factor.solve(self._signs()))
        waves = np.linalg.qr(self._centred(self._factor.solve(waves)))[0]
        exact = float(np.sum(waves * self._factor.solve(waves)))
        rest = self._signs()
        rest = self._centred(rest - waves @ (waves.T @ rest))
        return (exact + float(np.sum(rest * self._factor.solve(rest))) / self._tuning.draws) / self.nodes

    def _signs(self) -> np.ndarray:
        return self._centred(self._rng.choice((-1.0, 1.0), (self.nodes, self._tuning.draws)))

    def _centred(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors (n, K) less their mean in every component."""
        pick = csr_array((np.ones(self.nodes), (self.part, np.arange(self.nodes))), shape=(len(self._size), self.nodes))
        return vectors - ((pick @ vectors) / self._size[:, None])[self.part]


class Predictor:
    """Mean position variance of the images for any choice of candidates, by the one-dimensional adjustment.

    Previewed pairs count by the tracks they join. The tracks that other pairs are expected to join, beside those that
    contain both images already, count one a match, as far as the previewed pairs have left tracks of the images
    unjoined: a feature counts once, for any number of pairs. Images of one ``unit`` share one unknown: of a rig, the
    positions of frames count, and a camera with few features depends on the others.
    """

    def __init__(self, candidates: Candidates, tuning: NetTuning, unit: np.ndarray | None = None) -> None:
        self._candidates, self._tuning = candidates, tuning
        n = candidates.images
        number = np.arange(n) if unit is None else np.unique(unit, return_inverse=True)[1]
        rigid = int(number.max(initial=-1)) + 1 < n
        self._power = tuning.power_rig if rigid else tuning.power
        self._unit = csr_array((np.ones(n), (number, np.arange(n))), shape=(int(number.max(initial=-1)) + 1, n))
        tracks = joined(candidates, np.ones(len(candidates), bool), tuning)
        self._final = tracks.pieces()
        self._all = self.variance(np.ones(len(candidates), bool), tracks)
        self._seen = float(candidates.seen.mean()) if len(candidates) else 1.0

    def loss(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """Predicted increase of the position sigma over all candidates, a share: ratio of sigmas ** power - 1.

        The levelling net has no rotations, whose errors add to those of positions, and a choice is judged by the very
        tracks it was made by: a power, fitted to exact covariances of bundle adjustments of full tracks at
        losses of 5 to 30 % (benchmarks/network/design_simulated.py). With few previewed pairs the net makes losses too
        large instead, and the power goes down to 1.
        """
        power = 1.0 + (self._power - 1.0) * self._seen**2
        value = self.variance(chosen, tracks)
        return max((value / self._all) ** (0.5 * power) - 1.0, 0.0) if self._all > 0 else 0.0

    def variance(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """Variance in arbitrary units for chosen (E,) bool; ``tracks``: theirs, if they are joined already."""
        c = self._candidates
        tracks = joined(c, chosen, self._tuning) if tracks is None else tracks
        seen = tracks.incidence()
        matrix = of_tracks(seen)
        unseen = np.flatnonzero(chosen & ~c.seen)
        if len(unseen):
            i, j, expected = c.i[unseen], c.j[unseen], c.expected[unseen]
            new = np.maximum(expected - entries(tracks.joint(), i, j), self._tuning.least_share * expected)
            apart = np.maximum(tracks.pieces() - self._final, 0.0)
            asked = np.bincount(i, new, c.images) + np.bincount(j, new, c.images)
            share = np.minimum(apart / np.maximum(asked, 1e-9), 1.0)
            new *= np.maximum(np.minimum(share[i], share[j]), self._tuning.least_share)
            matrix = csr_array(matrix + laplacian(i, j, new, c.images))
        return Net(csr_array(self._unit @ matrix @ self._unit.T), self._tuning).variance()


def joined(candidates: Candidates, chosen: np.ndarray, tuning: NetTuning) -> Tracks:
    """The tracks of the previewed ones among the chosen pairs."""
    tracks = Tracks(candidates, tuning)
    tracks.join(np.flatnonzero(chosen & candidates.seen))
    return tracks
