"""Sky lies above what is not sky: its edges face down, those of a pale road seen from the air face every way.

Matches cannot tell a sky from a smooth surface seen straight from above: neither has any. Over all images of a survey
their edges can.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.masks.morphology import eroded
from tiegraph.masks.tuning_learnt import AboveTuning


@dataclass(frozen=True)
class Edges:
    """Edges of a sky in some images: their ``length`` in pixels, and ``down``, the part of it that faces down less that
    which faces up."""

    down: float = 0.0
    length: float = 0.0

    def __add__(self, other: Edges) -> Edges:
        return Edges(self.down + other.down, self.length + other.length)


def edges_of(sky: np.ndarray, told: np.ndarray, tuning: AboveTuning) -> Edges:
    """Edges of a sky (h, w) bool where it is ``told`` from the scene, (h, w) bool: not at the platform, nor at the row
    below which no sky is sought."""
    down, right = np.gradient(-cv2.GaussianBlur(sky.astype(np.float32), (0, 0), tuning.blur_sigma_px))
    inner = eroded(told, tuning.reach_px)
    return Edges(float(down[inner].sum()), float(np.hypot(down, right)[inner].sum()))


def not_above(edges: Mapping[int, Iterable[Edges]], tuning: AboveTuning) -> set[int]:
    """The cameras whose sky is none, as it does not lie above the rest: those of all level cameras are judged together.

    ``edges``: of the images of each level camera, whose tops are up to within some 45 degrees; a camera that looks up
    sees sky anywhere.
    """
    every = sum((e for own in edges.values() for e in own), Edges())
    return set(edges) if every.down < tuning.min_down * every.length else set()
