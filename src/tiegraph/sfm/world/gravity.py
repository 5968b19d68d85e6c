"""Which way is up in a model: cameras are mounted upright, so their image tops point to the sky on average."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiegraph.scene.scene import Scene

RING_SIGMA_DEG = 3.0  # a ring round a levelled platform: what trim and mounting leave
LONE_SIGMA_DEG = 10.0  # a person holding a camera, or cameras to one side
_AGREEMENT = 0.8  # length of the mean of the unit vectors; nadir photographs of many headings have about 0


@dataclass(frozen=True)
class Up:
    """Upward direction (3,) in the model, its sigma, and whether a ring of cameras says so."""

    direction: np.ndarray
    sigma_deg: float
    ring: bool
    cameras: str


def up_vector(cam_from_world: np.ndarray, scene: Scene) -> Up | None:
    """Mean of -y of the side cameras over all registered images (N, 4, 4); None when they do not agree."""
    side = np.array([scene.sensor_of(k).role == "side" for k in range(len(scene))], bool)
    use = side & np.isfinite(cam_from_world).all(axis=(1, 2))
    if not use.any():
        return None
    tops = -cam_from_world[use, 1, :3]
    mean = tops.mean(axis=0)
    if np.linalg.norm(mean) < _AGREEMENT:
        return None
    looking = cam_from_world[use, 2, :3].mean(axis=0)
    several = any(sum(s.role == "side" for s in r.sensors) >= 3 for r in scene.rigs)
    ring = several and float(np.linalg.norm(looking)) < 0.5
    cameras = "the ring of side cameras" if ring else "the images"
    return Up(mean / np.linalg.norm(mean), RING_SIGMA_DEG if ring else LONE_SIGMA_DEG, ring, cameras)
