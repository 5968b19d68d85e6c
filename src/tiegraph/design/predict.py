"""How far the position sigma of chosen pairs is from that of all: a one-dimensional adjustment of the tracks."""

import numpy as np
from scipy.sparse import csr_array

from tiegraph.design.resistance import Net, laplacian, of_tracks
from tiegraph.design.tracks import Candidates, Tracks, entries
from tiegraph.design.tuning import NetTuning


class Predictor:
    """Mean position variance of the images for any choice of candidates, by the one-dimensional adjustment of
    ``resistance``.

    Seen pairs count by the tracks they join. What unseen pairs are expected to join, beside the tracks that hold both
    images already, counts one a match, as far as the seen pairs have left tracks of the images apart: a feature counts
    once, however many pairs hope for it. Images of one ``unit`` share one unknown: of a rig, the positions of frames
    count, and a camera that sees little hangs on the others.
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

        The levelling net knows no rotations, whose errors add to those of positions, and a choice is judged by the very
        tracks it was made by: a power, fitted to exact covariances of bundle adjustments of full tracks at
        losses of 5 to 30 % (benchmarks/network/design_simulated.py). Where few pairs were seen the net makes losses too
        large instead, and the power goes down to 1.
        """
        power = 1.0 + (self._power - 1.0) * self._seen**2
        value = self.variance(chosen, tracks)
        return max((value / self._all) ** (0.5 * power) - 1.0, 0.0) if self._all > 0 else 0.0

    def variance(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """Variance in units of no meaning for chosen (E,) bool; ``tracks``: theirs, if they are joined already."""
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
    """The tracks of the seen ones among the chosen pairs."""
    tracks = Tracks(candidates, tuning)
    tracks.join(np.flatnonzero(chosen & candidates.seen))
    return tracks
