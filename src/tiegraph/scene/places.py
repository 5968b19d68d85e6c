"""Where frames were taken: before any model is made, and by the places of their images."""

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


def of_frames(centre: np.ndarray, scene: Scene) -> np.ndarray:
    """(F, 3) place of each frame: of its first image with one, of centre (N, 3); NaN = none has."""
    out = np.full((scene.frames, 3), np.nan)
    for k in np.flatnonzero(np.isfinite(centre).all(axis=1))[::-1]:
        out[scene.frame[k]] = centre[k]
    return out
