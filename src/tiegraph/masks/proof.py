"""Tests of a class before anything is masked: the survey itself may refute it.

A platform is fixed while the scene moves, so frames must verify motion. Sky has no parallax, so its matches
must be farther than the scene. Water lies below a horizon, so where the sky is refuted there is none.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from tiegraph.masks import NAMES, OVEREXPOSED
from tiegraph.masks.matchability import Matchability
from tiegraph.masks.morphology import eroded
from tiegraph.masks.tuning_learnt import ProofTuning


@dataclass(frozen=True)
class MatchCounts:
    """Verified matches of some images: ``inside`` (5,) by their class; of those well inside of sky with a known
    distance, how many are ``near`` and how many ``far``. ``told``: of all, how many have a known one; ``area``: of
    these images, in images; ``room``: of it, the part well inside of sky; ``white``: the overexposed part."""

    inside: np.ndarray
    near: int = 0
    far: int = 0
    told: int = 0
    area: int = 0
    room: float = 0.0
    white: float = 0.0

    def __add__(self, other: "MatchCounts") -> "MatchCounts":
        return MatchCounts(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)})

    def refuted(self, tuning: ProofTuning) -> bool:
        """Whether the matches in the sky are near, and as dense as those of a surface."""
        judged = self.near + self.far
        dense = self.near * self.area > tuning.dense * self.told * self.room
        return judged >= tuning.least_matches and self.near > tuning.refuted * judged and dense


NONE = MatchCounts(np.zeros(len(NAMES), int))


def matches_in(
    labels: np.ndarray, sky: np.ndarray, matchability: Matchability | None, tuning: ProofTuning
) -> MatchCounts:
    """The matches of an image by its classes (h, w) u1 and its sky (h, w) bool."""
    if matchability is None:
        return NONE
    column, row = (matchability.xy[matchability.matched] * (labels.shape[1], labels.shape[0])).astype(int).T
    row, column = row.clip(0, labels.shape[0] - 1), column.clip(0, labels.shape[1] - 1)
    inside = np.bincount(labels[row, column], minlength=len(NAMES))
    if matchability.near is None:
        return MatchCounts(inside)
    inner = eroded(sky, tuning.inner_px)
    distance = matchability.near[matchability.matched]
    told = np.isfinite(distance)
    near = distance[inner[row, column] & told]
    counts = int((near > tuning.near).sum()), int((near <= tuning.near).sum()), int(told.sum())
    white = float((labels == OVEREXPOSED).mean())
    return MatchCounts(inside, *counts, area=1, room=float(inner.mean()), white=white)


def moves(found: Sequence[Sequence[Matchability]], tuning: ProofTuning) -> bool:
    """Whether enough pairs of frames, ``found`` of each, verify that the cameras move; fixed parts in a rig that
    does not are the scene."""
    return sum(len(pair) > 0 for pair in found) > tuning.min_moving * len(found)


def without_sky(ties: Mapping[int, MatchCounts], tuning: ProofTuning) -> set[int]:
    """The cameras whose sky is refuted by its matches, those of all together: above one camera is sky if it is above
    the others. (`canal_demo`: where each judged alone, one lost a true sky beside pale walls, 92 -> 79 % IoU.)"""
    return set(ties) if sum(ties.values(), NONE).refuted(tuning) else set()


def white_ties(ties: Iterable[MatchCounts], tuning: ProofTuning) -> bool:
    """Whether overexposed areas match as a surface does: white paint and paper, not a burnt-out sky or deck."""
    every = sum(ties, NONE)
    here, all_of_them = int(every.inside[OVEREXPOSED]), int(every.inside.sum())
    return here >= tuning.least_matches and here * every.area > tuning.dense * all_of_them * every.white
