"""Design by greedy choice: the pairs that add most to the network, until the accuracy by previews is near that of all.

Gain of a pair that would join ``new`` tracks of its ``n`` matches, between images of effective resistance R in the
network chosen so far: log(1 + R (new + known n)), where matches of tracks that are joined already count little. That is
the growth of the log-determinant of the network's Laplacian (tree-connectivity: Khosoussi et al. 2016, arXiv
1611.00889) with the matches that bundle adjustment does not have yet. It shrinks as pairs are chosen, so choosing
greedily is near the optimum.

Pairs are chosen in rounds that grow the network by a few percent, each image once a round while pairs are few: all
gains are computed together, and a pair chosen does not make its neighbours' gains stale.
"""

import logging
from dataclasses import dataclass

import numpy as np

from tiegraph.design.resistance import Net, Predictor, laplacian
from tiegraph.design.tracks import Candidates, Tracks
from tiegraph.design.tuning import NetTuning, Tuning

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Choice:
    """Candidates chosen, in the order they were; ``loss`` increase of the position sigma over all candidates by the
    measure, a share (NaN: not asked for); ``rounds`` how many it took."""

    places: np.ndarray
    loss: float
    rounds: int


@dataclass(frozen=True)
class Budget:
    """When to stop: at ``pairs`` pairs, or at the ``loss`` (a share) where that is given."""

    pairs: int
    loss: float | None = None


def choose(
    candidates: Candidates, start: np.ndarray, budget: Budget, tuning: Tuning, judge: Predictor | None = None
) -> Choice:
    """Greedy design from the candidates at start (K,), which must connect what is connectable; never fewer than those.

    ``judge`` predicts the loss where the budget asks for one; by default images count one by one.
    """
    judge = Predictor(candidates, tuning.net) if judge is None and budget.loss is not None else judge
    tracks, own = Tracks(candidates, tuning.net), tuning.growth
    chosen = np.zeros(len(candidates), bool)
    weight = np.zeros(len(candidates))  # of the chosen links of the net
    chosen[start] = True
    weight[start] = candidates.expected[start]
    tracks.choose(start, tracks.new())
    order, loss, rounds, looked, before = [start], np.nan, 0, 0, tracks
    growth = own.fine if candidates.images <= 20_000 else own.coarse
    while True:
        count = int(chosen.sum())
        done = count == len(candidates)
        if judge is not None and budget.loss is not None and (done or count >= (1 + own.look) * looked):
            loss = judge.loss(tracks.chosen, tracks)
            _log.info("round %d: %d of %d pairs, loss over previews %.1f %%", rounds, count, len(chosen), 100 * loss)
            if loss <= budget.loss:
                places = np.concatenate(order)
                between = max(looked, len(start)), count
                end, loss = _shortest(places, before, between, (loss, budget.loss), judge)
                return Choice(places[:end], loss, rounds)
            before, looked = tracks.copy(), count
        room = min(budget.pairs, len(candidates)) - count
        if room <= 0:
            break
        new = tracks.new()
        pace = growth if count < 4.0 * candidates.images else own.coarse
        wanted = min(max(1, int(pace * count)), room)
        each = max(1, round(2 * pace * count / candidates.images))
        gain = np.where(chosen, -1.0, _gains(candidates, weight, new, tuning.net))
        picked = _apart(candidates, gain, wanted, each)
        if not len(picked):  # nothing tells the rest apart
            picked = np.flatnonzero(~chosen)[:room]
        weight[picked] = np.maximum(new[picked], tuning.net.known * candidates.expected[picked])
        tracks.choose(picked, new)
        chosen[picked] = True
        order.append(picked)
        rounds += 1
    return Choice(np.concatenate(order), loss, rounds)


def _gains(c: Candidates, weight: np.ndarray, new: np.ndarray, tuning: NetTuning) -> np.ndarray:
    """(E,) log(1 + R (new + known n)), R the effective resistance in the net of links of ``weight`` (E,)."""
    resistance = Net(laplacian(c.i, c.j, weight, c.images), tuning).resistance(c.i, c.j)
    return np.log1p(np.where(np.isfinite(resistance), resistance, 0.0) * (new + tuning.known * c.expected))


def _shortest(
    places: np.ndarray,
    tracks: Tracks,
    between: tuple[int, int],
    losses: tuple[float, float],
    judge: Predictor,
) -> tuple[int, float]:
    """The least number of the first places, within bounds, of an allowed loss, and it; ``tracks``: of those up to the
    lower bound; ``losses``: that at the upper bound, allowed."""
    (low, high), (loss, allowed) = between, losses
    for _ in range(4):
        middle = (low + high) // 2
        if middle <= low:
            break
        further = tracks.copy()
        more = places[low:middle]
        further.chosen[more] = True
        further.join(more[tracks.candidates.seen[more]])
        there = judge.loss(further.chosen, further)
        if there <= allowed:
            high, loss = middle, there
        else:
            low, tracks = middle, further
    return high, loss


def _apart(c: Candidates, gain: np.ndarray, count: int, each: int) -> np.ndarray:
    """Places of up to count pairs of the largest gain, at most ``each`` of an image."""
    free = [each] * c.images
    picked: list[int] = []
    live = np.flatnonzero(gain >= 0)
    width = min(len(live), 20 * count)  # sorting all would cost too much
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
