"""Design: the candidate pairs that are matched at full resolution.

First the pairs that any design keeps: those that connect every image, and every part, to the rest. A pair may
fail: only matching at full resolution confirms a preview. So one pair is not enough to connect an image. Across every
cut of the graph of candidates, around a single image and between two halves of the survey alike, the strongest
pairs stay until as many as ``wanted`` of them are expected to be verified, or all of them.

The others are chosen greedily: those that add most to the network, until the accuracy by previews is near that of all.
Gain of a pair that would join ``new`` tracks of its ``n`` matches, between images of effective resistance R in the
network chosen so far: log(1 + R (new + known n)), where matches of tracks that are joined already count little. That is
the growth of the log-determinant of the network's Laplacian (tree-connectivity: Khosoussi et al. 2016, arXiv
1611.00889) with the matches that bundle adjustment does not have yet. It shrinks as pairs are chosen, so choosing
greedily is near the optimum. Pairs are chosen in rounds that grow the network by a few percent, each image once a round
while pairs are few: all gains are computed together, and a pair chosen does not make its neighbours' gains stale.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from tiegraph.design.coverage import Coverage
from tiegraph.design.matchprediction import counted_matches, expected_matches, predict_matches, verified_chance
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tracks import Candidates, Net, Predictor, Tracks, laplacian
from tiegraph.design.tuning import Tuning
from tiegraph.errors import choose as choose_entry
from tiegraph.scene.graph import cuts, forest, frame_links, groups, parts, strongest_places, two_links
from tiegraph.scene.pairs import Pairs, PreviewMatches, Visibility
from tiegraph.scene.scene import Scene

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DesignResult:
    """The pair table with the pairs left out dropped (``cut``, ``similar``, ``weak``), notes, figures
    by name, and tables {"columns", "rows"} by name."""

    pairs: Pairs
    notes: tuple[str, ...] = ()
    counts: dict[str, float] = field(default_factory=dict)
    tables: dict[str, dict[str, Any]] = field(default_factory=dict)


_OWN = ("hybrid", "top", "all")
Method = Callable[[Pairs, Scene, np.ndarray], DesignResult]
METHODS: dict[str, Method] = {}
"""Methods by name that thin pairs by the matches (P,) expected of them, beside those of this module."""


def takes_all(pairs: Pairs, scene: Scene, settings: DesignSettings, tuning: Tuning) -> bool:
    """Whether every kept pair is matched: there is none, it is asked for, or these are loose photographs with
    so few that matching them is a small part of the run.

    In passes false pairs of repeated walls cost more than time (canal_demo with all 2734 pairs 9.1 mm, with the 1604
    chosen ones 4.8 mm).
    """
    count = len(pairs.kept())
    loose = bool(np.all(scene.sequence[scene.frame] < 0))
    may_choose = settings.method == "hybrid" and settings.budget == "loss"
    few = may_choose and loose and count <= tuning.few_pairs * len(scene)
    return count == 0 or settings.method == "all" or few


def design(
    pairs: Pairs,
    scene: Scene,
    ties: PreviewMatches | None,
    settings: DesignSettings,
    tuning: Tuning,
    visibility: Visibility | None = None,
) -> DesignResult:
    """Choose by the method of the settings; connected parts stay connected, except with some of ``METHODS``.

    ``ties``: preview matches of the pairs that were previewed; for the others matches are expected from the score or
    the overlap. ``visibility``, the points of a coarse model each image sees, predicts the tracks that all would join.
    Methods hybrid and top keep a maximum spanning forest of the images, two pairs without a common image from
    every camera, pass and section to the rest, and a second link wherever frames would depend on one; hybrid
    also the strongest pairs of every image and part (``holding``), within a share of a budget of pairs.
    If there are few pairs, all are taken (``takes_all``).
    """
    count = len(pairs.kept())
    if takes_all(pairs, scene, settings, tuning):
        few = settings.method != "all" and count > 0
        return _made(pairs, pairs, (f"all {count} pairs: matching so few costs next to nothing",) if few else (), {})
    expected = expected_matches(pairs, ties)
    if settings.method not in _OWN:
        # The pairs left by a method besides those of this module
        method = cast(Method, choose_entry("design method", settings.method, METHODS))
        thin = method(pairs, scene, expected)
        return _made(pairs, thin.pairs, thin.notes, thin.counts)
    kept = _kept(pairs, expected, ties, visibility, tuning)
    allowed = np.iinfo(np.int64).max if settings.budget == "loss" else int(len(scene) * settings.pairs_per_image / 2)
    room = 0 if settings.method == "top" else int(tuning.start_share * allowed)
    start = _start(kept, scene, room, tuning)
    places, loss, rounds = _chosen(kept, start, scene, allowed, settings, tuning)
    second = _second_links(kept, places, scene)
    cut = np.ones(len(pairs), bool)
    cut[kept.row[np.concatenate([places, second])]] = False
    chosen = pairs.drop(cut, "cut")
    share = f"{settings.method}: {len(places)} of {len(kept.row)} pairs ({100 * len(places) / len(kept.row):.1f} %)"
    if settings.method != "top" and settings.budget == "loss":
        share += (
            f"; over the previews' tracks their position sigma is {100 * loss:.1f} % above that of all (asked: "
            f"{settings.loss_percent:g} %), the loss at full resolution is known only after matching all"
        )
    elif len(start) > allowed:
        share += f": the budget of {allowed} pairs is not enough to keep the images connected"
    # What the steps chose, by name
    counts = {"start": float(len(start)), "second_links": float(len(second)), "rounds": float(rounds)}
    if np.isfinite(loss):
        counts["preview_loss_percent"] = round(100 * loss, 2)
    return _made(pairs, chosen, () if settings.method == "top" else (share,), counts)


@dataclass(frozen=True)
class _Kept:
    """K kept pairs: rows in the table, images, expected matches (K,), known or predicted preview matches."""

    row: np.ndarray
    i: np.ndarray
    j: np.ndarray
    strength: np.ndarray
    known: PreviewMatches | None


def _kept(
    pairs: Pairs, expected: np.ndarray, ties: PreviewMatches | None, visibility: Visibility | None, tuning: Tuning
) -> _Kept:
    """The kept pairs; the coarse model, where it sees both images, predicts matches better than the previews."""
    row = np.flatnonzero(pairs.dropped == 0)
    i, j, strength = pairs.i[row], pairs.j[row], expected[row]
    if visibility is None:
        return _Kept(row=row, i=i, j=j, strength=strength, known=ties)
    expected, known = predict_matches(i, j, counted_matches(pairs, ties)[row], visibility, tuning.match_prediction)
    strength = np.where(np.isfinite(expected), expected, strength)
    return _Kept(row=row, i=i, j=j, strength=strength, known=known)


def _chosen(
    kept: _Kept, start: np.ndarray, scene: Scene, allowed: int, settings: DesignSettings, tuning: Tuning
) -> tuple[np.ndarray, float, int]:
    """From the start, the strongest pairs of each image, or those with the largest gain within the budget."""
    if settings.method == "top":
        top = strongest_places(kept.i, kept.j, kept.strength, scene, settings.pairs_per_image)
        return np.union1d(start, top), np.nan, 0
    candidates = Candidates.make(kept.i, kept.j, kept.strength, kept.known, len(scene))
    if settings.budget == "pairs":
        return choose(candidates, start, allowed, tuning)
    # Images that move as one: those of a frame whose rig is known; others have numbers of their own
    known = np.array([r.known() for r in scene.rigs], bool)[scene.rig[scene.frame]]
    judge = Predictor(candidates, tuning.net, np.where(known, scene.frame, scene.frames + np.arange(len(scene))))
    return choose(candidates, start, allowed, tuning, judge, settings.loss_percent / 100)


def _made(before: Pairs, after: Pairs, notes: tuple[str, ...], counts: dict[str, float]) -> DesignResult:
    """The result with the numbers of pairs before and after."""
    figures = {"candidates": float(np.sum(before.dropped == 0)), "pairs": float(np.sum(after.dropped == 0)), **counts}
    return DesignResult(pairs=after, notes=notes, counts=figures)


def with_coverage(made: DesignResult, found: Coverage) -> DesignResult:
    """A result with its weak links."""
    figures = {k: float(v) for k, v in found.counts.items() if k not in ("images", "pairs")}
    said = () if found.sound else found.lines
    tables = {**made.tables, "weak links": found.table}
    return replace(made, notes=(*made.notes, *said), counts={**made.counts, **figures}, tables=tables)


def _start(kept: _Kept, scene: Scene, room: int, tuning: Tuning) -> np.ndarray:
    """Places of the pairs that every design keeps: a maximum spanning forest, two links of every group, and within
    ``room`` pairs the further rounds of ``holding``."""
    i, j, strength = kept.i, kept.j, kept.strength
    chance = verified_chance(strength, tuning.match_prediction)
    rounds = holding(i, j, strength, chance, len(scene), tuning)
    places = np.unique(np.concatenate([rounds[0], *(two_links(i, j, g.member, strength) for g in groups(scene))]))
    more = np.concatenate([*rounds[1:], places[:0]])
    more = more[~np.isin(more, places)]
    return np.concatenate([places, more[: max(room - len(places), 0)]])


def _second_links(kept: _Kept, chosen: np.ndarray, scene: Scene) -> np.ndarray:
    """Places of pairs that give every single link between frames a second one, where there is a candidate for it.

    A spanning forest over the doubly connected components: it crosses every cut that the chosen pairs cross once
    and another candidate crosses too (Nagamochi and Ibaraki 1992).
    """
    i, j, strength = kept.i, kept.j, kept.strength
    links = frame_links(i[chosen], j[chosen], scene)
    bridge = cuts(links.a, links.b, scene.frames, links.several).bridge
    piece = parts(links.a[~bridge], links.b[~bridge], scene.frames)[scene.frame]
    free = np.setdiff1d(np.arange(len(i)), chosen)
    single = chosen[links.row[bridge]]  # a second link should not start from the images of the first
    weaker = np.isin(i[free], np.r_[i[single], j[single]]) | np.isin(j[free], np.r_[i[single], j[single]])
    own = strength[free] / np.where(weaker, strength.max(initial=1.0), 1.0)
    return free[forest(piece[i[free]], piece[j[free]], own, len(scene))]


# --- the pairs that any design keeps ----------------------------------------------------------------------------------


def holding(
    i: np.ndarray, j: np.ndarray, strength: np.ndarray, chance: np.ndarray, nodes: int, tuning: Tuning
) -> list[np.ndarray]:
    """Places of the pairs i, j (P,) that stay, in rounds; ``chance`` (P,) of being verified rises with ``strength``.

    Each round is a maximum spanning forest of the remaining pairs, so k rounds have the k strongest pairs across every
    cut (Nagamochi and Ibaraki 1992). A pair is finished when its ends are connected in so many forests that the weakest
    pairs on the paths between them are together worth ``wanted`` sure ones: those cross each cut that it crosses.
    """
    left, sure = np.arange(len(i)), np.zeros(len(i))
    rounds: list[np.ndarray] = []
    tenths = [k / 10 for k in range(1, 10)]  # a probability counts as the next one below
    steps = (*zip(tenths, tenths), (tuning.sure, 1.0))
    while len(left):
        tree = left[forest(i[left], j[left], strength[left], nodes)]
        rounds.append(tree)
        left = np.setdiff1d(left, tree)
        weakest = np.zeros(len(left))
        for least, worth in steps:
            sound = tree[chance[tree] >= least]
            part = parts(i[sound], j[sound], nodes)
            weakest[part[i[left]] == part[j[left]]] = worth
        sure[left] += weakest
        left = left[sure[left] < tuning.wanted]
    return rounds


def choose(
    candidates: Candidates,
    start: np.ndarray,
    most: int,
    tuning: Tuning,
    judge: Predictor | None = None,
    enough: float = 0.0,
) -> tuple[np.ndarray, float, int]:
    """Greedy design from the candidates at start (K,), which must connect all connectable images; never fewer pairs.

    It stops at ``most`` pairs, or where the loss that ``judge`` predicts is ``enough``. Returns places of the chosen
    candidates in their order, the loss (increase of the position sigma over all candidates, a share; NaN: not
    computed), and the number of rounds.
    """
    tracks = Tracks(candidates, tuning.net)
    chosen = np.zeros(len(candidates), bool)
    weight = np.zeros(len(candidates))  # of the chosen links of the net
    chosen[start] = True
    weight[start] = candidates.expected[start]
    tracks.choose(start, tracks.new())
    order, loss, rounds, looked, before = [start], np.nan, 0, 0, tracks
    while True:
        count = int(chosen.sum())
        done = count == len(candidates)
        if judge is not None and (done or count >= (1 + tuning.growth_look) * looked):
            loss = judge.loss(tracks.chosen, tracks)
            _log.info("round %d: %d of %d pairs, loss over previews %.1f %%", rounds, count, len(chosen), 100 * loss)
            if loss <= enough:
                places = np.concatenate(order)
                between = max(looked, len(start)), count
                end, loss = _shortest(places, before, between, (loss, enough), judge)
                return places[:end], loss, rounds
            before, looked = tracks.copy(), count
        room = min(most, len(candidates)) - count
        if room <= 0:
            break
        new = tracks.new()
        wanted = min(max(1, int(tuning.growth * count)), room)
        each = max(1, round(2 * tuning.growth * count / candidates.images))
        net = Net(laplacian(candidates.i, candidates.j, weight, candidates.images), tuning.net)
        resistance = net.resistance(candidates.i, candidates.j)
        worth = new + tuning.net.known * candidates.expected
        gain = np.log1p(np.where(np.isfinite(resistance), resistance, 0.0) * worth)
        gain[chosen] = -1.0
        picked = _apart(candidates, gain, wanted, each)
        if not len(picked):  # the rest have equal gains
            picked = np.flatnonzero(~chosen)[:room]
        weight[picked] = np.maximum(new[picked], tuning.net.known * candidates.expected[picked])
        tracks.choose(picked, new)
        chosen[picked] = True
        order.append(picked)
        rounds += 1
    return np.concatenate(order), loss, rounds


def _shortest(
    places: np.ndarray,
    tracks: Tracks,
    between: tuple[int, int],
    losses: tuple[float, float],
    judge: Predictor,
) -> tuple[int, float]:
    """The least number of the first places, within bounds, of an allowed loss, and its loss; ``tracks``: of those up to
    the lower bound; ``losses``: that at the upper bound, allowed."""
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
