"""The shape of a survey: how far it may be bent, given its images, and the uncertainty between two frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pycolmap
from scipy.spatial.distance import pdist, squareform

from tiegraph.geometry.transforms import Similarity, rms_length
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.jacobians import frame_pose
from tiegraph.sfm.covariance import PositionSigma

SHAPE = "shape.npz"  # of the largest model, in the folder of models
_MODES = 60  # at most: the rest is noise from frame to frame
_EXPLAINED = 0.99999  # share of the variance in the modes: positions of 2 cm bend a corridor known to metres


@dataclass(frozen=True)
class Shape:
    """The errors of N frames of a model after the best similarity of all of them: the large eigenvectors of their
    covariance, times their sigmas, and the variance of the rest, from frame to frame.

    ``index`` (N,) the scene's frames, ascending; ``place`` (N, 3); ``modes`` (M, N, 3) of unit variance each;
    ``rest`` (N, 3); lengths in model units, along its axes. ``turn`` (3, 3) rad squared: covariance of the rotation
    of a typical frame relative to the frames' positions.
    """

    index: np.ndarray
    place: np.ndarray
    modes: np.ndarray
    rest: np.ndarray
    turn: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))

    @staticmethod
    def of(
        model: pycolmap.Reconstruction,
        sigma: PositionSigma,
        scene: Scene,
        steps: Sequence[Mapping[int, np.ndarray]] = (),
    ) -> Shape | None:
        """From the covariance of an adjustment, and from steps to alternative places (``PositionSigma.covering``);
        None without a covariance, and if it is as large as the whole model, because the linearisation about the
        positions is then invalid."""
        covariance = sigma.covering(steps).covariance
        if sigma.covariance is None or covariance is None:
            return None
        frames = [model.frame(k) for k in sigma.frame_ids]
        named = [[model.image(d.id).name for d in f.image_ids if model.exists_image(d.id)] for f in frames]
        first = [min(scene.image_index[n] for n in own) for own in named]
        rows = np.lexsort((scene.sensor[first], scene.frame[first]))
        rows = rows[np.unique(scene.frame[first][rows], return_index=True)[1]]  # the first of cameras with own times
        at = (3 * rows[:, None] + np.arange(3)).ravel()
        place = np.array([frame_pose(frames[k]).inverse().translation for k in rows])
        own_m = rms_length(np.sqrt(np.clip(np.diag(sigma.covariance)[at], 0, None)).reshape(-1, 3))
        if not own_m < rms_length(place - place.mean(axis=0)):
            return None
        values, vectors = np.linalg.eigh(covariance[np.ix_(at, at)])
        values, vectors = np.clip(values[::-1], 0, None), vectors[:, ::-1]
        count = min(_MODES, int(np.searchsorted(np.cumsum(values), _EXPLAINED * values.sum())) + 1)
        modes = (vectors[:, :count] * np.sqrt(values[:count])).T.reshape(count, -1, 3)
        rest = np.clip(np.diag(covariance)[at].reshape(-1, 3) - np.sum(modes**2, axis=0), 0, None)
        shape = Shape(index=scene.frame[first][rows], place=place, modes=modes, rest=rest)
        if sigma.turns is None:
            return shape
        usual = np.argsort(np.trace(sigma.turns, axis1=1, axis2=2))[len(sigma.turns) // 2]
        return replace(shape, turn=sigma.turns[usual])

    @property
    def sigma(self) -> np.ndarray:
        """(N,) root sums of squares of the frames' position sigmas."""
        return np.asarray(np.sqrt(np.sum(self.modes**2, axis=(0, 2)) + self.rest.sum(axis=1)))

    def sizes(self) -> dict[str, float]:
        """Median and 90th percentile of ``sigma``."""
        return {"median": float(np.median(self.sigma)), "p90": float(np.percentile(self.sigma, 90))}

    def at(self, frames: np.ndarray) -> np.ndarray:
        """(K, 3, M) the modes at frames (K,) of the scene, interpolated between known frames."""
        flat = self.modes.transpose(2, 0, 1).reshape(-1, len(self.index))
        known = np.stack([np.interp(frames, self.index, row) for row in flat], axis=1)
        return known.reshape(len(frames), 3, -1)

    def step(self, frames: np.ndarray, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(K, 3) movement of frames (K,) of the scene by coefficients (M,) of the modes, and sigmas (K, 3) of the
        part that the modes do not represent."""
        modes = self.at(frames)
        rest = np.stack([np.interp(frames, self.index, row) for row in self.rest.T], axis=1)
        return modes @ coefficients, np.sqrt(rest + (1 - _EXPLAINED) * np.sum(modes**2, axis=2))

    def coefficients(self, moved: np.ndarray) -> np.ndarray:
        """(M,) coefficients of the modes for a movement ``moved`` (F, 3) of the frames of the scene."""
        flat, there = self.modes.reshape(len(self.modes), -1), np.nan_to_num(moved[self.index])
        return np.asarray(np.linalg.lstsq(flat.T, there.ravel(), rcond=None)[0])

    def moved(self, similarity: Similarity) -> Shape:
        """The same in the world frame."""
        turn = similarity.scale * similarity.rotation
        modes, rest = self.modes @ turn.T, self.rest @ (turn**2).T
        own = similarity.rotation @ self.turn @ similarity.rotation.T
        return replace(self, place=similarity(self.place), modes=modes, rest=rest, turn=own)

    def told(self, left: np.ndarray, covariance: np.ndarray) -> Shape:
        """The same after other observations determined the coefficients of the modes with this covariance (M, M); the
        movement that they asked for and that was not made, ``left`` (M,), is added."""
        values, vectors = np.linalg.eigh(covariance + np.outer(left, left))
        roots = vectors * np.sqrt(np.clip(values, 0, None))
        return replace(self, modes=np.einsum("kj,kni->jni", roots, self.modes))

    def between(self, min_pairs: int) -> list[tuple[float, float, int]]:
        """By distance: distance, sigma of the vector between two frames (root mean square over pairs), number of
        pairs; only with at least ``min_pairs`` pairs. The sigma of the scale is not included."""
        flat = np.moveaxis(self.modes, 1, 0).reshape(len(self.index), -1)
        variance = pdist(flat, "sqeuclidean")
        own = self.rest.sum(axis=1)
        variance += squareform(own[:, None] + own[None, :], checks=False)
        apart = pdist(self.place)
        there = apart > 0
        step = np.round(2 * np.log2(apart[there])).astype(int)  # rows for each doubling of the distance
        apart, variance = apart[there], variance[there]
        return [
            (float(np.median(apart[of])), float(np.sqrt(variance[of].mean())), int(of.sum()))
            for of in (step == k for k in np.unique(step))
            if of.sum() >= min_pairs
        ]
