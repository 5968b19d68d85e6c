"""Design by greedy choice: the pairs that add most to the network, until the predicted accuracy is near that of all.

Gain of a pair that would join ``new`` tracks of its ``n`` matches, between images of effective resistance R in the
network chosen so far: log(1 + R (new + 0.05 n)). That is the growth of the log-determinant of the network's Laplacian
(tree-connectivity: Khosoussi et al. 2016, arXiv 1611.00889) with the matches that bundle adjustment does not have yet.
Tree-connectivity itself is log(1 + R n). Both shrink as pairs are chosen, so choosing greedily is near the optimum.

Pairs are chosen in rounds that grow the network by 3 to 10 %, each image at most once a round, so that all gains can be
computed together and a pair chosen does not make its neighbours' gains stale. Measured on simulated surveys of 150 and
200 images, rounds of 3 % give the sigma of one pair at a time within 1 %.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from tiegraph.network.resistance import EXACT, Net, laplacian, of_tracks
from tiegraph.network.tracks import Candidates, Tracks, entries

_log = logging.getLogger(__name__)

_KNOWN = 0.05  # worth of a match whose track is joined already: another observation against outliers
_FINE, _COARSE, _MANY = 0.03, 0.10, 20_000  # growth of a round for small networks and for those of many images
_LOOK = 0.10  # growth of a large network between two predictions of its accuracy, which cost more than a round
_DRIFT = 2.0  # power from the ratio of predicted sigmas to that of adjusted ones: rotations drift too; see ``_loss``


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


def choose(candidates: Candidates, start: np.ndarray, budget: Budget, by_tracks: bool = True) -> Choice:
    """Greedy design from the candidates at start (K,), which must connect what is connectable; never fewer than those.

    ``by_tracks``: gain by new tracks (hybrid), else by matches (tree-connectivity).
    """
    goal = predicted_variance(candidates, np.ones(len(candidates), bool)) if budget.loss is not None else np.nan
    tracks = Tracks(candidates)
    chosen, weight = np.zeros(len(candidates), bool), np.zeros(len(candidates))
    chosen[start] = True
    weight[start] = candidates.expected[start]
    tracks.choose(start, tracks.new())
    order, loss, rounds, looked = [start], np.nan, 0, 0
    growth = _FINE if candidates.images <= _MANY else _COARSE
    while True:
        count = int(chosen.sum())
        done = count == len(candidates)
        if budget.loss is not None and (candidates.images <= EXACT or done or count >= (1 + _LOOK) * looked):
            loss, looked = _loss(tracks, goal), count
            _log.info("round %d: %d of %d pairs, predicted loss %.1f %%", rounds, count, len(chosen), 100 * loss)
            if loss <= budget.loss:
                break
        room = min(budget.pairs, len(candidates)) - count
        if room <= 0:
            break
        new = tracks.new() if by_tracks else np.where(chosen, 0.0, candidates.expected)
        worth = new + _KNOWN * candidates.expected if by_tracks else new
        gain = np.where(chosen, -1.0, np.log1p(_resistance(candidates, weight) * worth))
        picked = _apart(candidates, gain, min(max(1, int(growth * count)), room))
        tracks.choose(picked, new)
        chosen[picked] = True
        weight[picked] = np.maximum(new[picked], _KNOWN * candidates.expected[picked])
        order.append(picked)
        rounds += 1
    return Choice(np.concatenate(order), loss, rounds)


def _resistance(c: Candidates, weight: np.ndarray) -> np.ndarray:
    net = Net(laplacian(c.i, c.j, weight, c.images))
    return np.where(np.isfinite(r := net.resistance(c.i, c.j)), r, 0.0)


def _apart(c: Candidates, gain: np.ndarray, count: int) -> np.ndarray:
    """Places of up to count pairs of the largest gain of which no two have an image in common."""
    free = np.ones(c.images, bool)
    picked: list[int] = []
    live = np.flatnonzero(gain >= 0)
    width = min(len(live), 20 * count)  # sorting all for each round would cost more than choosing
    while True:
        top = live if width == len(live) else live[np.argpartition(-gain[live], width)[:width]]
        top = top[np.argsort(-gain[top], kind="stable")]
        for e, i, j in zip(top.tolist(), c.i[top].tolist(), c.j[top].tolist()):
            if free[i] and free[j]:
                free[i] = free[j] = False
                picked.append(e)
                if len(picked) == count:
                    break
        if picked or width == len(live):
            return np.array(picked, int)
        width = len(live)


def _loss(tracks: Tracks, goal: float) -> float:
    """Predicted increase of the position sigma over all candidates, a share.

    The power was fitted to exact bundle adjustment covariances (benchmarks/network/design_simulated.py).
    """
    value = predicted_variance(tracks.candidates, tracks.chosen, tracks)
    return max((value / goal) ** (0.5 * _DRIFT) - 1.0, 0.0) if goal > 0 else 0.0


def predicted_variance(candidates: Candidates, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
    """Mean position variance of the images by the tracks of the chosen pairs (E,) bool, in units of no meaning.

    The one-dimensional bundle adjustment of ``resistance``; the tracks an unseen pair is expected to join beside those
    that hold both images already count as tracks of two.
    """
    c = candidates
    if tracks is None:
        tracks = Tracks(c)
        tracks.choose(np.flatnonzero(chosen & c.seen), np.zeros(len(c)))
    seen = tracks.incidence()
    matrix = of_tracks(seen)
    unseen = np.flatnonzero(chosen & ~c.seen)
    if len(unseen):
        shared = entries(csr_array(seen @ seen.T), c.i[unseen], c.j[unseen])
        new = np.maximum(c.expected[unseen] - shared, _KNOWN * c.expected[unseen])
        matrix = csr_array(matrix + laplacian(c.i[unseen], c.j[unseen], new / 2, c.images))
    return Net(matrix).variance()
