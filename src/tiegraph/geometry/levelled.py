"""A model seen from above, where nothing but its cameras says what is up."""

from __future__ import annotations

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.geometry.gravity import UpTuning, up_vector


def levelled(cam_from_world: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """(4, 4) rigid transform of a world into one with z up, the path of the cameras (N, 4, 4; NaN = no pose) along x.

    ``frame`` (N,) of each camera. Up is what ``gravity`` says; where it says nothing, they look straight down.
    """
    placed = np.isfinite(cam_from_world).all(axis=(1, 2))
    out = np.eye(4)
    if not placed.any():
        return out
    rotation, centre = cam_from_world[placed, :3, :3], transforms.centre(cam_from_world[placed])
    found = up_vector(cam_from_world, frame, UpTuning())
    up = -rotation[:, 2].mean(axis=0) if found is None else found.direction
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    flat = centre - centre.mean(axis=0)
    flat = flat - np.outer(flat @ up, up)
    along = np.linalg.svd(flat, full_matrices=False)[2][0] if np.abs(flat).max() > 1e-9 else rotation[0, 0]
    along = along - (along @ up) * up
    along /= np.linalg.norm(along)
    out[:3, :3] = np.stack([along, np.cross(up, along), up])
    out[:3, 3] = -out[:3, :3] @ centre.mean(axis=0)
    return out
