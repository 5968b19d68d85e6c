"""What a class must show before anything is masked: the survey itself may refute it.

A platform stands still while the scene moves, so frames must verify that anything moves. Sky has no parallax, so what
matches in it must be farther than the scene. Water lies below a horizon, so where the sky is refuted there is none.
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
    """Verified matches of some images: ``inside`` (5,) by the class they lie in; of those well inside of sky that tell
    how near they are, how many are ``near`` and how many ``far``. ``told``: of all, how many tell it; ``area``: of
    these images, in images; ``room``: of it, what is well inside of sky; ``white``: what is overexposed."""

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
        """Whether what lies in the sky is near, and as dense as a surface has matches."""
        judged = self.near + self.far
        dense = self.near * self.area > tuning.dense * self.told * self.room
        return judged >= tuning.least_matches and self.near > tuning.refuted * judged and dense


NONE = MatchCounts(np.zeros(len(NAMES), int))


def matches_in(
    labels: np.ndarray, sky: np.ndarray, matchability: Matchability | None, tuning: ProofTuning
) -> MatchCounts:
    """Where the matches of an image lie in its classes (h, w) u1 and its sky (h, w) bool."""
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
    """Whether enough pairs of frames, ``found`` of each, verify that the cameras move; what stands still in a rig that
    does not is the scene."""
    return sum(len(pair) > 0 for pair in found) > tuning.min_moving * len(found)


def without_sky(ties: Mapping[int, MatchCounts], tuning: ProofTuning) -> set[int]:
    """The cameras whose sky is refuted by what lies in it, those of all together: above one is sky if it is above
    the others. (`canal_demo`: where each judged alone, one lost a true sky beside pale walls, 92 -> 79 % IoU.)"""
    return set(ties) if sum(ties.values(), NONE).refuted(tuning) else set()


def white_ties(ties: Iterable[MatchCounts], tuning: ProofTuning) -> bool:
    """Whether overexposed areas hold matches as a surface does: white paint and paper, not a burnt-out sky or deck."""
    every = sum(ties, NONE)
    here, all_of_them = int(every.inside[OVEREXPOSED]), int(every.inside.sum())
    return here >= tuning.least_matches and here * every.area > tuning.dense * all_of_them * every.white
