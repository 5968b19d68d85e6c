"""What a receiver adds to the unknowns of a placement: where its antenna is in the rig, how late its clock is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FittedArm:
    """The antenna in the rig frame, metres: as given, or as estimated with its covariance."""

    place: np.ndarray  # (3,)
    covariance: np.ndarray  # (3, 3) square metres; NaN = not estimated


@dataclass(frozen=True)
class Clock:
    """By how much the receiver's clock is behind the cameras', and sigma of it, seconds; NaN = not estimated."""

    offset_s: float
    sigma_s: float
