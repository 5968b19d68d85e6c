"""Matcher ``upright``: nearest descriptors of features that are turned alike, for cameras that do not roll."""

import numpy as np

from tiegraph.features.matchers import Features, by_nearest
from tiegraph.features.settings import MatchSettings

MOST = np.radians(30)  # of roll between two images


def match(a: Features, b: Features, settings: MatchSettings) -> np.ndarray:
    """(K, 2) rows of the features of a and b that match."""
    rows = by_nearest(a, b, settings)
    roll = a.keypoints[rows[:, 0], 3] - b.keypoints[rows[:, 1], 3]
    return rows[np.cos(roll) > np.cos(MOST)]
