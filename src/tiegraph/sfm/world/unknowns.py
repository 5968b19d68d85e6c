"""Of a placement beside place and turn: the scale by the rig, the antenna in it, the receiver's clock, the shape."""

from __future__ import annotations

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


@dataclass(frozen=True)
class Bend:
    """What each of the modes of a model's shape moves K places by, (K, 3, M) in units of the model, and coefficients
    (M,) by which they were moved already."""

    modes: np.ndarray
    done: np.ndarray

    @staticmethod
    def of(modes: np.ndarray) -> Bend:
        """Of places as the images have them."""
        return Bend(modes, np.zeros(modes.shape[2]))
