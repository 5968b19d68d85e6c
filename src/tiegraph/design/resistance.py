"""Effective resistances and accuracy of a network of images, like a levelling net: one unknown an image.

An image is an unknown height, a track of k images k observations of one unknown point. Eliminating the points leaves
the normal matrix L = sum over tracks (I - 1 1^T / k), a graph Laplacian: the one-dimensional bundle adjustment.
Its pseudo-inverse gives the variance of the difference of two images (effective resistance) and of all images.
"""

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from tiegraph.design.tracks import Candidates, Tracks, entries
from tiegraph.design.tuning import NetTuning

_GROUND = 1e-7  # of the mean diagonal: makes the matrix of a floating net regular


def laplacian(i: np.ndarray, j: np.ndarray, weight: np.ndarray, nodes: int) -> csr_array:
    """(n, n) Laplacian of weighted links i, j (K,); links of a node with itself do not count."""
    weight = np.where(i == j, 0.0, weight)
    off = coo_array((-np.tile(weight, 2), (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(nodes, nodes))
    degree = np.bincount(i, weight, nodes) + np.bincount(j, weight, nodes)
    return csr_array(off.tocsr() + diags_array(degree))


def of_tracks(seen: csr_array) -> csr_array:
    """(N, N) Laplacian of tracks from the observations (N, T): every track eliminated."""
    size = np.asarray(seen.sum(axis=0)).ravel()
    share = csr_array(seen @ diags_array(1.0 / np.maximum(size, 1.0)))
    return csr_array(diags_array(np.asarray(seen.sum(axis=1)).ravel()) - share @ seen.T)


class Net:
    """A Laplacian factorised once: resistances between nodes and the mean variance of the nodes."""

    def __init__(self, matrix: csr_array, tuning: NetTuning, seed: int = 0) -> None:
        self._tuning = tuning
        self.nodes = matrix.shape[0]
        self.part = connected_components(matrix, directed=False)[1]
        self._size = np.bincount(self.part)
        self._rng = np.random.default_rng(seed)
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
        """(n, projections) f4 random draws of the nodes with the pseudo-inverse as covariance."""
        upper = self._matrix.tocoo()
        link = upper.row < upper.col
        row, col, weight = upper.row[link], upper.col[link], np.sqrt(np.maximum(-upper.data[link], 0.0))
        right = np.empty((self.nodes, self._tuning.projections))
        for k in range(self._tuning.projections):
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
        return (exact + float(np.sum(rest * self._factor.solve(rest))) / self._tuning.waves) / self.nodes

    def _signs(self) -> np.ndarray:
        return self._centred(self._rng.choice((-1.0, 1.0), (self.nodes, self._tuning.waves)))

    def _centred(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors (n, K) less their mean in every component."""
        pick = csr_array((np.ones(self.nodes), (self.part, np.arange(self.nodes))), shape=(len(self._size), self.nodes))
        return vectors - ((pick @ vectors) / self._size[:, None])[self.part]


class Predictor:
    """Mean position variance of the images for any choice of candidates, by the one-dimensional adjustment of
    ``resistance``.

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
