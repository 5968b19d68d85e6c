"""Which images of a survey stand for it: a connected stretch of its path, of every pass that runs along it."""

from __future__ import annotations

import numpy as np

from tiegraph.scene.scene import Scene


def stretch(scene: Scene, centres: np.ndarray, images: int) -> np.ndarray:
    """Numbers (K,), increasing, of the images of a block of about so many: whole frames, the nearest to the middle one.

    ``centres``: (F, 3) places of the frames, NaN = not known. A frame without a place stands where the next one with
    a place does in the order of its pass (loose photographs: of their names), so that what was not registered is in
    the block too: to leave it out would flatter whoever is judged. The middle is that of the longest pass.
    Raises ValueError if no frame has a place.
    """
    placed = _filled(scene, centres)
    size = np.bincount(scene.frame, minlength=scene.frames)
    away = np.linalg.norm(placed - placed[_middle(scene)], axis=1)
    nearest = np.argsort(away, kind="stable")
    taken = nearest[: int(np.searchsorted(np.cumsum(size[nearest]), images)) + 1]
    return np.flatnonzero(np.isin(scene.frame, taken))


def _filled(scene: Scene, centres: np.ndarray) -> np.ndarray:
    known = np.all(np.isfinite(centres), axis=1)
    if not known.any():
        raise ValueError("no frame has a place")
    out = np.array(centres, float)
    for sequence in np.unique(scene.sequence):
        mine = _in_order(scene, int(sequence))
        there = np.flatnonzero(known[mine])
        source = np.flatnonzero(known) if not len(there) else mine[there]
        order = np.arange(len(mine))
        at = np.zeros(len(mine), int) if not len(there) else np.abs(order[:, None] - there).argmin(axis=1)
        out[mine] = centres[source[at]]
    return out


def _middle(scene: Scene) -> int:
    passes, frames = np.unique(scene.sequence, return_counts=True)
    mine = _in_order(scene, int(passes[np.argmax(frames)]))
    return int(mine[len(mine) // 2])


def _in_order(scene: Scene, sequence: int) -> np.ndarray:
    mine = np.flatnonzero(scene.sequence == sequence)
    return mine[np.argsort(scene.sequence_index[mine], kind="stable")]
