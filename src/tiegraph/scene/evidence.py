"""What says what of a survey, with which sigma, and where two of them cannot both be right.

A *statement* is one source's value of one quantity: the rig's file of the scale, the images of it, the positions of it.
Statements of one quantity are tested against each other; so are residuals against what noise looks like (``trend``): a
line, a curve or a step is not noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import norm

CHANCE = 0.001  # that what agrees is called a contradiction, for each test
LIMIT = float(norm.isf(CHANCE / 2))  # 3.29 sigmas


@dataclass(frozen=True)
class Statement:
    """What one source says of one quantity. ``value`` and ``sigma`` in ``unit``; ``used``: the result rests on it."""

    quantity: str  # "scale", "heading", "tilt", "clock", "place of cam1", "focal length of cam0", ...
    source: str  # "rig as given", "images", "GNSS positions", "control points", "EXIF", "gravity", ...
    value: float
    sigma: float
    unit: str
    used: bool = False


@dataclass(frozen=True)
class Contradiction:
    """Two statements of one quantity that differ by more than chance allows."""

    first: Statement
    second: Statement
    sigmas: float  # the difference in its own sigmas

    def text(self, culprit: str = "") -> str:
        """One sentence with the figures, and the likeliest culprit in words."""
        a, b = self.first, self.second
        said = f"{a.quantity}: {_said(a)} and {_said(b)} contradict each other by {self.sigmas:.1f} sigmas"
        return f"{said}: {culprit}" if culprit else said


def contradictions(statements: Sequence[Statement]) -> list[Contradiction]:
    """Statements of one quantity that cannot both be right, the worst first; without a sigma one says nothing."""
    known = [s for s in statements if np.isfinite([s.value, s.sigma]).all() and s.sigma > 0]
    out = []
    for a, b in combinations(known, 2):
        if a.quantity == b.quantity and a.source != b.source:
            sigmas = abs(a.value - b.value) / float(np.hypot(a.sigma, b.sigma))
            if sigmas > LIMIT:
                out.append(Contradiction(a, b, sigmas))
    return sorted(out, key=lambda c: -c.sigmas)


def table(statements: Sequence[Statement]) -> dict:
    """Table of a receipt, one statement a row; the quantity's verdict in the last column."""
    found = contradictions(statements)
    rows = []
    for s in statements:
        against = [c.second if c.first is s else c.first for c in found if s is c.first or s is c.second]
        verdict = f"contradicts {against[0].source}" if against else ""
        rows.append([s.quantity, s.source, s.value, s.sigma, s.unit, "used" if s.used else "", verdict])
    return {"columns": ["quantity", "source", "value", "sigma", "unit", "", "verdict"], "rows": rows}


def _said(s: Statement) -> str:
    return f"{s.source} {s.value:.5g} +- {s.sigma:.2g} {s.unit}".rstrip()
