"""The passes on the map: where the cameras went, which frames are missing, and how far the map reaches."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.scene.scene import Scene, between_neighbours


@dataclass(frozen=True)
class Track:
    """A pass on the map: name, positions (T, 3) of its frames in order (NaN = not registered), and where the missing
    ones probably are (M, 3)."""

    name: str
    positions: np.ndarray
    missing: np.ndarray


def frame_positions(scene: Scene, centres: np.ndarray) -> np.ndarray:
    """(F, 3) mean of the registered projection centres (N, 3) of each frame, NaN where none is registered."""
    seen = np.isfinite(centres).all(axis=1)
    count = np.bincount(scene.frame[seen], minlength=scene.frames)
    sums = [np.bincount(scene.frame[seen], weights=centres[seen, c], minlength=scene.frames) for c in range(3)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack(sums, axis=1) / np.where(count > 0, count, np.nan)[:, None]


def tracks(scene: Scene, positions: np.ndarray) -> list[Track]:
    """The passes with the places of their missing frames, interpolated along the pass or taken from the prior."""
    between = between_neighbours(positions, scene)
    guess = np.where(np.isfinite(between), between, scene.world_from_rig[:, :3, 3])
    out = []
    for t in [*range(len(scene.sequences)), -1]:
        frames = scene.in_order(scene.sequence == t)
        if not len(frames):
            continue
        at = positions[frames]
        missing = guess[frames][~np.isfinite(at[:, 0]) & np.isfinite(guess[frames, 0])]
        out.append(Track(scene.sequences[t] if t >= 0 else "images", at, missing))
    return out


def extent(found: Sequence[Track], gnss: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner (2,) of the passes and their surroundings."""
    points = np.concatenate(
        [t.positions[:, :2] for t in found] + [t.missing[:, :2] for t in found] or [np.zeros((0, 2))]
    )
    points = points[np.isfinite(points[:, 0])]
    if not len(points):
        points = gnss[:, :2] if len(gnss) else np.zeros((1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float(np.max(high - low)), 1e-6)
    pad = 0.22 * size + np.maximum(0, 0.6 * size - (high - low)) / 2
    return low - pad, high + pad
