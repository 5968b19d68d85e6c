"""What a class must show before anything is masked: the survey itself may refute it.

A platform stands still while the scene moves, so frames must verify that anything moves. Sky has no parallax, so what
matches in it must be farther than the scene. Water lies below a horizon, so where the sky is refuted there is none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.masks.classes import NAMES, USE
from tiegraph.masks.evidence import Evidence

_MOVING = 0.1  # of the pairs of frames must verify a motion before what stands still is a platform
_NEAR = 0.33  # of the parallax at the scene's median depth: not sky
_REFUTED = 0.5  # of the matches in a sky that are near: then it is none
_LEAST = 3  # matches in the skies of all cameras, to judge by
_INNER_PX = 7  # the edge of the sky is that of trees and roofs


@dataclass(frozen=True)
class Ties:
    """Verified matches of some images: ``inside`` (5,) by the class they lie in; of those well inside of sky that tell
    how near they are, how many are ``near`` and how many ``far``."""

    inside: np.ndarray
    near: int = 0
    far: int = 0

    def __add__(self, other: Ties) -> Ties:
        return Ties(self.inside + other.inside, self.near + other.near, self.far + other.far)


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
    near = evidence.near[evidence.matched][inner[row, column]]
    near = near[np.isfinite(near)]
    return Ties(inside, int((near > _NEAR).sum()), int((near <= _NEAR).sum()))


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
    every = sum(ties.values(), NONE)
    told = every.near + every.far
    return set(ties) if told >= _LEAST and every.near > _REFUTED * told else set()


def cost(ties: Iterable[Ties]) -> tuple[int, int]:
    """(matches that are masked, all) of some ties."""
    every = sum(ties, NONE)
    return int(every.inside.sum() - every.inside[USE]), int(every.inside.sum())
