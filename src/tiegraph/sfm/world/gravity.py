"""Which way is up in a model: cameras are mounted upright, so their image tops point to the sky on average."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.world import UpTuning


@dataclass(frozen=True)
class Up:
    """Upward direction (3,) in the model, its sigma, and whether cameras all round say so: of a ring, or a pair back to
    back, the tops of some go up where those of the others go down."""

    direction: np.ndarray
    sigma_deg: float
    ring: bool
    cameras: str


def up_vector(cam_from_world: np.ndarray, scene: Scene, tuning: UpTuning) -> Up | None:
    """Mean of -y of the side cameras over all registered images (N, 4, 4); None when they do not agree.

    The sigma of cameras all round is 3 deg, or more where the platform itself leans so much from frame to frame (a
    camera on a pole).
    """
    side = np.array([scene.sensor_of(k).role == "side" for k in range(len(scene))], bool)
    use = side & np.isfinite(cam_from_world).all(axis=(1, 2))
    if not use.any():
        return None
    tops = -cam_from_world[use, 1, :3]
    mean = tops.mean(axis=0)
    if np.linalg.norm(mean) < tuning.agreement:
        return None
    mean /= np.linalg.norm(mean)
    count, (top, looking) = _of_frames(scene.frame[use], (tops, cam_from_world[use, 2, :3]))
    several = count > 1
    if not several.any() or float(np.linalg.norm(looking[several], axis=1).mean()) >= tuning.round:
        return Up(direction=mean, sigma_deg=tuning.lone_sigma_deg, ring=False, cameras="the images")
    leaning = np.degrees(np.arccos(np.clip(top[several] @ mean / np.linalg.norm(top[several], axis=1), -1, 1)))
    sigma = max(tuning.ring_sigma_deg, float(np.sqrt(np.mean(leaning**2))))
    return Up(direction=mean, sigma_deg=sigma, ring=True, cameras="the ring of side cameras")


def _of_frames(frame: np.ndarray, values: Sequence[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """How many images (N,) each frame has (G,), and the means (G, 3) over them of each of the values (N, 3)."""
    frames, at, count = np.unique(frame, return_inverse=True, return_counts=True)
    means = []
    for v in values:
        total = np.zeros((len(frames), 3))
        np.add.at(total, at, v)
        means.append(total / count[:, None])
    return count, means
