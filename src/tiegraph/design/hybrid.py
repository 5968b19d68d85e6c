"""Design by greedy choice: the pairs that add most to the network, until the predicted accuracy is near that of all.

Gain of a pair that would join ``new`` tracks of its ``n`` matches, between images of effective resistance R in the
network chosen so far: log(1 + R (new + 0.05 n)). That is the growth of the log-determinant of the network's Laplacian
(tree-connectivity: Khosoussi et al. 2016, arXiv 1611.00889) with the matches that bundle adjustment does not have yet.
Tree-connectivity itself is log(1 + R n). Both shrink as pairs are chosen, so choosing greedily is near the optimum.

Pairs are chosen in rounds that grow the network by 3 to 10 %, each image once a round while pairs are few: all gains
are computed together, and a pair chosen does not make its neighbours' gains stale. Measured on simulated surveys of
150 and 200 images, rounds of 3 % give the sigma of one pair at a time within 1 %.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from tiegraph.design.resistance import Net, laplacian, of_tracks
from tiegraph.design.tracks import Candidates, Tracks, entries

_log = logging.getLogger(__name__)

_KNOWN = 0.05  # worth of a match whose track is joined already: another observation against outliers
_LEAST = 0.01  # of what an unseen pair was expected to join is counted always: no chosen pair ties nothing
_FINE, _COARSE, _MANY = 0.03, 0.10, 20_000  # growth of a round for small networks and for those of many images
_DENSE = 4  # pairs an image from which on rounds are coarse in small networks too
_LOOK = 0.10  # growth of the network between two predictions of its accuracy, which cost more than a round
_HALVINGS = 3  # of the last step, to find where the budget was met
_DRIFT = {
    "hybrid": 2.5,
    "tree": 1.7,
}  # power from the ratio of predicted sigmas to that of adjusted ones: ``Predictor``

_RIG_DRIFT = 8.0  # the same for frames of a known rig, whose net is stiffer than their adjustment: 2 on KITTI, 11 on
# PandaSet, 16 on canal_demo, where rig and intrinsics are adjusted too (design_real.py); too large costs only pairs


@dataclass(frozen=True)
class Choice:
    """Candidates chosen, in the order they were; ``loss`` predicted increase of the position sigma over all candidates,
    a share (NaN: not asked for); ``rounds`` how many it took."""

    places: np.ndarray
    loss: float
    rounds: int


@dataclass(frozen=True)
class Budget:
    """When to stop: at ``pairs`` pairs, or at the predicted ``loss`` (a share) where that is given."""

    pairs: int
    loss: float | None = None


def choose(
    candidates: Candidates, start: np.ndarray, budget: Budget, by_tracks: bool = True, unit: np.ndarray | None = None
) -> Choice:
    """Greedy design from the candidates at start (K,), which must connect what is connectable; never fewer than those.

    ``by_tracks``: gain by new tracks (hybrid), else by matches (tree-connectivity). ``unit`` (N,): images of one number
    move as one (the frame of a known rig); by default each by itself.
    """
    predictor = Predictor(candidates, unit) if budget.loss is not None else None
    tracks = Tracks(candidates)
    chosen, weight = np.zeros(len(candidates), bool), np.zeros(len(candidates))
    chosen[start] = True
    weight[start] = candidates.expected[start]
    tracks.choose(start, tracks.new())
    order, loss, rounds, looked, before = [start], np.nan, 0, 0, 0
    drift = _DRIFT["hybrid" if by_tracks else "tree"]
    growth = _FINE if candidates.images <= _MANY else _COARSE
    while True:
        count = int(chosen.sum())
        done = count == len(candidates)
        if predictor is not None and (done or count >= (1 + _LOOK) * looked):
            before, looked = looked, count
            loss = predictor.loss(tracks.chosen, drift, tracks)
            _log.info("round %d: %d of %d pairs, predicted loss %.1f %%", rounds, count, len(chosen), 100 * loss)
            if budget.loss is not None and loss <= budget.loss:
                places = np.concatenate(order)
                end, loss = _shortest(places, (max(before, len(start)), count), loss, budget.loss, (predictor, drift))
                return Choice(places[:end], loss, rounds)
        room = min(budget.pairs, len(candidates)) - count
        if room <= 0:
            break
        new = tracks.new() if by_tracks else np.where(chosen, 0.0, candidates.expected)
        worth = new + _KNOWN * candidates.expected if by_tracks else new
        gain = np.where(chosen, -1.0, np.log1p(_resistance(candidates, weight) * worth))
        pace = growth if count < _DENSE * candidates.images else _COARSE
        each = max(1, round(2 * pace * count / candidates.images))
        picked = _apart(candidates, gain, min(max(1, int(pace * count)), room), each)
        tracks.choose(picked, new)
        chosen[picked] = True
        weight[picked] = np.maximum(new[picked], _KNOWN * candidates.expected[picked])
        order.append(picked)
        rounds += 1
    return Choice(np.concatenate(order), loss, rounds)


def _shortest(
    places: np.ndarray, between: tuple[int, int], loss: float, allowed: float, by: tuple[Predictor, float]
) -> tuple[int, float]:
    """The least number of the first places, within bounds, whose predicted loss is allowed, and that loss."""
    low, high = between
    predictor, drift = by
    for _ in range(_HALVINGS):
        middle = (low + high) // 2
        if middle <= low:
            break
        chosen = np.zeros(predictor.pairs, bool)
        chosen[places[:middle]] = True
        there = predictor.loss(chosen, drift)
        low, high, loss = (low, middle, there) if there <= allowed else (middle, high, loss)
    return high, loss


def _resistance(c: Candidates, weight: np.ndarray) -> np.ndarray:
    net = Net(laplacian(c.i, c.j, weight, c.images))
    return np.where(np.isfinite(r := net.resistance(c.i, c.j)), r, 0.0)


def _apart(c: Candidates, gain: np.ndarray, count: int, each: int) -> np.ndarray:
    """Places of up to count pairs of the largest gain, at most ``each`` of an image."""
    free = [each] * c.images
    picked: list[int] = []
    live = np.flatnonzero(gain >= 0)
    width = min(len(live), 20 * count)  # sorting all for each round would cost more than choosing
    while True:
        top = live if width == len(live) else live[np.argpartition(-gain[live], width)[:width]]
        top = top[np.argsort(-gain[top], kind="stable")]
        for e, i, j in zip(top.tolist(), c.i[top].tolist(), c.j[top].tolist()):
            if free[i] and free[j]:
                free[i] -= 1
                free[j] -= 1
                picked.append(e)
                if len(picked) == count:
                    break
        if picked or width == len(live):
            return np.array(picked, int)
        width = len(live)


class Predictor:
    """Mean position variance of the images for any choice of candidates, by the one-dimensional adjustment of
    ``resistance``.

    Seen pairs count by the tracks they join. What unseen pairs are expected to join, beside the tracks that hold both
    images already, counts one a match, as far as the seen pairs have left tracks of the images apart: a feature counts
    once, however many pairs hope for it. Images of one ``unit`` share one unknown: of a rig, the positions of frames
    count, and a camera that sees little hangs on the others.
    """

    def __init__(self, candidates: Candidates, unit: np.ndarray | None = None) -> None:
        self._candidates = candidates
        n = candidates.images
        number = np.arange(n) if unit is None else np.unique(unit, return_inverse=True)[1]
        self._rigid = int(number.max(initial=-1)) + 1 < n
        self._unit = csr_array((np.ones(n), (number, np.arange(n))), shape=(int(number.max(initial=-1)) + 1, n))
        tracks = _joined(candidates, np.ones(len(candidates), bool))
        self._final = tracks.pieces()
        self._all = self.variance(np.ones(len(candidates), bool), tracks)
        self._seen = float(candidates.seen.mean()) if len(candidates) else 1.0

    @property
    def pairs(self) -> int:
        """Number of candidates."""
        return len(self._candidates)

    def loss(self, chosen: np.ndarray, drift: float, tracks: Tracks | None = None) -> float:
        """Predicted increase of the position sigma over all candidates, a share: ratio of sigmas ** power - 1.

        The levelling net knows no rotations, whose errors add to those of positions, and a choice is judged by the very
        tracks it was made by: power ``drift``, fitted to exact covariances of bundle adjustments of full tracks at
        losses of 5 to 30 % (benchmarks/network/design_simulated.py). Where few pairs were seen the net makes losses too
        large instead, and the power goes down to 1.
        """
        power = 1.0 + ((_RIG_DRIFT if self._rigid else drift) - 1.0) * self._seen**2
        value = self.variance(chosen, tracks)
        return max((value / self._all) ** (0.5 * power) - 1.0, 0.0) if self._all > 0 else 0.0

    def variance(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """Variance in units of no meaning for chosen (E,) bool; ``tracks``: theirs, if they are joined already."""
        c = self._candidates
        tracks = _joined(c, chosen) if tracks is None else tracks
        seen = tracks.incidence()
        matrix = of_tracks(seen)
        unseen = np.flatnonzero(chosen & ~c.seen)
        if len(unseen):
            i, j, expected = c.i[unseen], c.j[unseen], c.expected[unseen]
            new = np.maximum(expected - entries(tracks.joint(), i, j), _LEAST * expected)
            apart = np.maximum(tracks.pieces() - self._final, 0.0)
            asked = np.bincount(i, new, c.images) + np.bincount(j, new, c.images)
            share = np.minimum(apart / np.maximum(asked, 1e-9), 1.0)
            new *= np.maximum(np.minimum(share[i], share[j]), _LEAST)
            matrix = csr_array(matrix + laplacian(i, j, new, c.images))
        return Net(csr_array(self._unit @ matrix @ self._unit.T)).variance()


def _joined(candidates: Candidates, chosen: np.ndarray) -> Tracks:
    """The tracks of the seen ones among the chosen pairs."""
    tracks = Tracks(candidates)
    tracks.join(np.flatnonzero(chosen & candidates.seen))
    return tracks
