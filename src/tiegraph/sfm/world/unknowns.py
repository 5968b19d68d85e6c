"""Unknowns of a georeference beside the similarity: scale from the rig, antenna, receiver's clock offset, shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LogScale:
    """Logarithm of the metres per model unit from the rig, and its sigma."""

    value: float
    sigma: float


@dataclass(frozen=True)
class LeverArm:
    """The antenna in the rig frame, metres: prior value, and whether it is an unknown of the fit."""

    place: np.ndarray  # (3,)
    estimate: bool = False


@dataclass(frozen=True)
class FittedArm:
    """The antenna in the rig frame, metres: as given, or as estimated with its covariance."""

    place: np.ndarray  # (3,)
    covariance: np.ndarray  # (3, 3) square metres; NaN = not estimated


@dataclass(frozen=True)
class Clock:
    """Delay of the receiver's clock relative to the cameras', and its sigma, seconds; NaN = not estimated."""

    offset_s: float
    sigma_s: float


@dataclass(frozen=True)
class Bend:
    """Movement of K places by each mode of a model's shape, (K, 3, M) in model units, and coefficients (M,) already
    applied."""

    modes: np.ndarray
    done: np.ndarray

    @staticmethod
    def of(modes: np.ndarray) -> Bend:
        """For places as determined by the images."""
        return Bend(modes, np.zeros(modes.shape[2]))
