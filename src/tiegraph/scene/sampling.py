"""Some of many things, where all would take too long."""

from __future__ import annotations

import numpy as np


def evenly(count: int, most: int) -> np.ndarray:
    """(K,) places of at most ``most`` of ``count`` things, spread evenly over them, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
