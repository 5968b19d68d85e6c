"""What a class must show before anything is masked: the survey itself may refute it.

A platform stands still while the scene moves, so frames must verify that anything moves. Sky has no parallax, so what
matches in it must be farther than the scene. Water lies below a horizon, so where the sky is refuted there is none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np

from tiegraph.masks.classes import NAMES, OVEREXPOSED, USE
from tiegraph.masks.evidence import Evidence

_MOVING = 0.1  # of the pairs of frames must verify a motion before what stands still is a platform
_NEAR = 0.33  # of the parallax at the scene's median depth: not sky
_REFUTED = 0.5  # of the matches in a sky that are near: then it is none
_LEAST = 3  # matches in the skies of all cameras, to judge by
# Side of the square by which the edge of a sky is left out, at lookup.LOOK_PX: it is that of trees and roofs, whose key
# points reach into it. With 7 of them the true skies of KITTI, PandaSet and kerry_park were refuted.
_INNER_PX = 21
# Of the matches that an equal area of the images has: fewer are wires, lamps and tops of trees in a true sky (0.07 on
# PandaSet, 0.01 on kerry_park; where forest is taken for it, uav_bands, 0.32 and more).
_DENSE = 0.2


@dataclass(frozen=True)
class Ties:
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

    def __add__(self, other: Ties) -> Ties:
        return Ties(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)})

    @property
    def refuted(self) -> bool:
        """Whether what lies in the sky is near, and as dense as a surface has matches."""
        judged = self.near + self.far
        dense = self.near * self.area > _DENSE * self.told * self.room
        return judged >= _LEAST and self.near > _REFUTED * judged and dense


NONE = Ties(np.zeros(len(NAMES), int))


def ties_in(labels: np.ndarray, sky: np.ndarray, evidence: Evidence | None) -> Ties:
    """Where the matches of an image lie in its classes (h, w) u1 and its sky (h, w) bool."""
    if evidence is None:
        return NONE
    row, column = _pixels(evidence, labels.shape)
    inside = np.bincount(labels[row, column], minlength=len(NAMES))
    if evidence.near is None:
        return Ties(inside)
    inner = cv2.erode(sky.astype(np.uint8), np.ones((_INNER_PX, _INNER_PX), np.uint8), borderValue=1) > 0
    distance = evidence.near[evidence.matched]
    told = np.isfinite(distance)
    near = distance[inner[row, column] & told]
    counts = int((near > _NEAR).sum()), int((near <= _NEAR).sum()), int(told.sum())
    white = float((labels == OVEREXPOSED).mean())
    return Ties(inside, *counts, area=1, room=float(inner.mean()), white=white)


def _pixels(evidence: Evidence, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    column, row = (evidence.xy[evidence.matched] * (shape[1], shape[0])).astype(int).T
    return row.clip(0, shape[0] - 1), column.clip(0, shape[1] - 1)


def moves(found: Sequence[Sequence[Evidence]]) -> bool:
    """Whether enough pairs of frames, ``found`` of each, verify that the cameras move; what stands still in a rig that
    does not is the scene."""
    return sum(len(pair) > 0 for pair in found) > _MOVING * len(found)


def without_sky(ties: Mapping[int, Ties]) -> set[int]:
    """The cameras whose sky is refuted by what lies in it, those of all together: above one is sky if it is above
    the others. (`canal_demo`: where each judged alone, one lost a true sky beside pale walls, 92 -> 79 % IoU.)"""
    return set(ties) if sum(ties.values(), NONE).refuted else set()


def white_ties(ties: Iterable[Ties]) -> bool:
    """Whether overexposed areas hold matches as a surface does: white paint and paper, not a burnt-out sky or deck."""
    every = sum(ties, NONE)
    here, all_of_them = int(every.inside[OVEREXPOSED]), int(every.inside.sum())
    return here >= _LEAST and here * every.area > _DENSE * all_of_them * every.white


def cost(ties: Iterable[Ties]) -> tuple[int, int]:
    """(matches that are masked, all) of some ties."""
    every = sum(ties, NONE)
    return int(every.inside.sum() - every.inside[USE]), int(every.inside.sum())
