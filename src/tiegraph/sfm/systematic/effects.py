"""Information of the observations on a shared error, in addition to the unknowns of the adjustment."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from tiegraph.sfm.adjustment.jacobians import Layout, System
from tiegraph.sfm.adjustment.normal import Normal, at_their_minimum, by_blocks, point_inverse, reduced

_RIDGE = 1e-6  # of the information: directions that the unknowns absorb completely


@dataclass(frozen=True)
class Effect:
    """A shared error: the effect of its coefficients on the gradient (C, K), and their second moment (K, K)."""

    gradient: np.ndarray
    moment: np.ndarray

    def covariance(self, solved: np.ndarray) -> np.ndarray:
        """(F, F) covariance of functions of the unknowns, from their solutions (C, F)."""
        moved = solved.T @ self.gradient
        return np.asarray(moved @ self.moment @ moved.T)


@dataclass(frozen=True)
class Score:
    """Score of K additional unknowns at zero (``EffectWeights.score``)."""

    gradient: np.ndarray  # (C, K) effect on the gradient of all points
    score: np.ndarray  # (K,)
    noise: np.ndarray  # (K, K) its covariance
    information: np.ndarray  # (K, K) on them, with the other unknowns eliminated

    def ridged(self) -> np.ndarray:
        """(K, K) invertible covariance of the score."""
        return self.noise + _RIDGE * np.diag(np.maximum(np.diag(self.information), 1e-12))


class EffectWeights:
    """The observations with their robust weights, and the factor of their normal equations."""

    def __init__(
        self, seen: System, weights: tuple[np.ndarray, np.ndarray], share: float, prior: sparse.spmatrix, layout: Layout
    ) -> None:
        """``weights`` (2O,) of the gradient and of the curvature; ``share``: share of the points that is in ``seen``;
        ``prior`` (C, C): prior information times the variance of a pixel."""
        self.seen, self.share, self._first = seen, share, weights[0]
        self._known = np.zeros(len(seen.residual))
        self._root = sparse.diags(np.sqrt(weights[1]))
        self._jc, self.jp = (self._root @ seen.cameras).tocsr(), (self._root @ seen.points).tocsr()
        self._inverse = by_blocks(point_inverse(self.jp))
        self.cross = (self._jc.T @ self.jp).tocsr()
        self._crossed = self.cross.T.tocsr()  # (3P, C)
        own = reduced(self._jc, self._crossed, self._inverse, 6 * len(layout.frame_ids))
        self.normal = Normal(own / share + prior, layout)
        self._pull = at_their_minimum(seen.points, np.sqrt(weights[1]), self._first * seen.residual, self._inverse)
        self._of_point = gradients(seen.cameras, seen.points, self._pull)
        self._whole = np.asarray(self._of_point.sum(axis=0)).ravel()
        self.scatter = (self._of_point.T @ self._of_point).tocsr()  # (C, C)

    def without(self, known: np.ndarray) -> EffectWeights:
        """The same with the residuals reduced by this known part (2O,) of the errors of the observations."""
        own = self._root @ known
        by_point = self._inverse @ (self.jp.T @ own)
        moved = self.normal.solve((self._jc.T @ own - self.cross @ by_point)[:, None])[:, 0] / self.share
        points = by_point - self._inverse @ (self.cross.T @ moved)
        out = copy.copy(self)
        out._known = self._known + own - self._jc @ moved - self.jp @ points
        return out

    def weight(self, observations: np.ndarray) -> np.ndarray:
        """Weights of these observations in the gradient."""
        return np.asarray(self._first[2 * observations])

    def score(self, columns: sparse.csr_matrix) -> Score:
        """Score of additional unknowns with these columns (2O, K), at zero: effect on the gradient (C, K) of all
        points; and for the sampled points the score (K,), its covariance (K, K), and the information (K, K) with the
        others eliminated.
        """
        rows = np.flatnonzero(np.diff(columns.indptr))  # one camera or frame in a large model: a small part of all
        columns, jc, jp = columns[rows], self._jc[rows], self.jp[rows]
        own = (sparse.diags(self._root.diagonal()[rows]) @ columns).tocsr()
        by_point = (jp.T @ own).tocsr()
        taken = (self._inverse @ by_point).tocsr()
        gradient = (jc.T @ own).toarray() - _transposed_product(self._crossed, taken)
        solved = self.normal.solve(gradient)
        information = (own.T @ own - by_point.T @ taken).toarray() - gradient.T @ solved / self.share
        each = gradients(columns, self.seen.points[rows], self._pull[rows])
        solved /= self.share
        mixed = _transposed_product(self._of_point, each).T @ solved
        noise = (each.T @ each).toarray() - mixed - mixed.T + solved.T @ (self.scatter @ solved)
        score = np.asarray(each.sum(axis=0)).ravel() - self._whole @ solved
        score -= own.T @ self._known[rows]
        return Score(gradient=gradient / self.share, score=score, noise=noise, information=information)


def _transposed_product(a: sparse.csr_matrix, b: sparse.csr_matrix) -> np.ndarray:
    """(C, K) product a'b of (R, C) and (R, K) where few rows of ``b`` are non-zero."""
    rows = np.flatnonzero(np.diff(b.indptr))
    return np.asarray((a[rows].T @ b[rows]).toarray())


def gradients(jc: sparse.csr_matrix, jp: sparse.csr_matrix, weighted: np.ndarray) -> sparse.csr_matrix:
    """(P, C) gradient of each point's share of the cost from its weighted residuals (2O,), with its own three
    unknowns at their minimum."""
    number = jp.indices[jp.indptr[:-1]] // 3  # each observation involves one point
    rows = np.arange(len(weighted))
    gather = sparse.csr_matrix((weighted, (number, rows)), shape=(jp.shape[1] // 3, len(weighted)))
    return (gather @ jc).tocsr()


def likeliest(score: np.ndarray, noise: np.ndarray, effect: np.ndarray) -> tuple[float, float]:
    """Gain in log likelihood over no effect, and size of the effect (K, K), for a score (K,) with this noise (K, K)."""
    root = np.linalg.cholesky(noise)
    half = np.linalg.solve(root, np.linalg.solve(root, effect).T)
    values, vectors = np.linalg.eigh((half + half.T) / 2)
    values, seen = np.maximum(values, 0), (vectors.T @ np.linalg.solve(root, score)) ** 2
    if values.max(initial=0.0) <= 0:
        return 0.0, 0.0
    tried = np.geomspace(1e-8, 1e4, 121) / values.max()  # times the size at which the effect equals the noise
    wider = 1 + tried[:, None] * values
    gain = 0.5 * np.sum(seen * (1 - 1 / wider) - np.log(wider), axis=1)
    most = int(np.argmax(gain))
    return (float(gain[most]), float(tried[most])) if gain[most] > 0 else (0.0, 0.0)


def posterior(
    score: np.ndarray, noise: np.ndarray, information: np.ndarray, field: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean (K,) and second moment (K, K) of coefficients with prior covariance ``field``. The mean stays in
    the moment because the model is not corrected for it."""
    across = field @ information
    kept = np.linalg.solve(noise + information @ across, across.T).T
    mean = kept @ score
    return mean, np.asarray(field - kept @ across.T + np.outer(mean, mean))
