"""Where frames were taken, as far as that is known before any model is made."""

from __future__ import annotations

import numpy as np

from tiegraph.scene.scene import Scene


def between_neighbours(positions: np.ndarray, scene: Scene) -> np.ndarray:
    """Positions (F, C) of the frames; those without one (NaN) stand between their neighbours on the pass, evenly by
    number. Beyond the known ends of a pass they stay unknown."""
    out = positions.copy()
    for number in np.unique(scene.sequence[scene.sequence >= 0]):
        own = np.flatnonzero(scene.sequence == number)
        own = own[np.argsort(scene.sequence_index[own], kind="stable")]
        known = np.flatnonzero(np.isfinite(positions[own]).all(axis=1))
        if len(known) > 1:
            inside = np.arange(known[0], known[-1] + 1)
            for c in range(positions.shape[1]):
                out[own[inside], c] = np.interp(inside, known, positions[own[known], c])
    return out
