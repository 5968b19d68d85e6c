"""Sky lies above what is not sky: its edges face down, those of a pale road seen from the air face every way.

Matches cannot tell a sky from a smooth surface seen straight from above: neither has any. Over all images of a survey
their edges can.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

# Of the length of all edges, what faces down more than up: 0.4 and more of skies, behind ragged trees too; 0.15 and
# less of what only looks like sky, from the air, on facades and sand (benchmarks/masks/above.py).
_ABOVE = 0.25
_BLUR_PX = 5.0  # at lookup.LOOK_PX: twigs and the steps of a border are no edges of their own
_REACH_PX = 25  # side of the square over which the blur carries an edge: so near to what is not told, it is not its own


@dataclass(frozen=True)
class Edges:
    """Edges of a sky in some images: their ``length`` in pixels, and ``down``, the part of it that faces down less that
    which faces up."""

    down: float = 0.0
    length: float = 0.0

    def __add__(self, other: Edges) -> Edges:
        return Edges(self.down + other.down, self.length + other.length)


def edges_of(sky: np.ndarray, told: np.ndarray) -> Edges:
    """Edges of a sky (h, w) bool where it is ``told`` from the scene, (h, w) bool: not at the platform, nor at the row
    below which no sky is sought."""
    down, right = np.gradient(-cv2.GaussianBlur(sky.astype(np.float32), (0, 0), _BLUR_PX))
    inner = cv2.erode(told.astype(np.uint8), np.ones((_REACH_PX, _REACH_PX), np.uint8)) > 0
    return Edges(float(down[inner].sum()), float(np.hypot(down, right)[inner].sum()))


def not_above(edges: Mapping[int, Iterable[Edges]]) -> set[int]:
    """The cameras whose sky is none, as it does not lie above the rest: those of all level cameras are judged together.

    ``edges``: of the images of each level camera, whose tops are up to within some 45 degrees; a camera that looks up
    sees sky anywhere.
    """
    every = sum((e for own in edges.values() for e in own), Edges())
    return set(edges) if every.down < _ABOVE * every.length else set()
