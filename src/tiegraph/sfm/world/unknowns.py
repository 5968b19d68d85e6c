"""Of a placement beside place and turn: the rig's word on the scale, the receiver's antenna in the rig, its clock."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LogScale:
    """Logarithm of the metres a unit of the model has by the rig, and sigma of it."""

    value: float
    sigma: float


@dataclass(frozen=True)
class LeverArm:
    """The antenna in the rig frame, metres, as believed before the fit, and whether it is an unknown of it."""

    place: np.ndarray  # (3,)
    estimate: bool = False


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
