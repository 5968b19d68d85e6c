"""A model seen from above, where nothing but its cameras says what is up."""

from __future__ import annotations

import numpy as np

from tiegraph.geometry import transforms

_UPRIGHT = 0.05  # weight of a camera's own upright against the horizon that its x axis lies in


def levelled(cam_from_world: np.ndarray) -> np.ndarray:
    """(4, 4) rigid transform of a world into one with z up, the path of the cameras (N, 4, 4; NaN = no pose) along x.

    People and vehicles hold cameras level, or they look straight down: x axes lie in the horizon.
    """
    placed = np.isfinite(cam_from_world).all(axis=(1, 2))
    out = np.eye(4)
    if not placed.any():
        return out
    rotation, centre = cam_from_world[placed, :3, :3], transforms.centre(cam_from_world[placed])
    x, y, z = (rotation[:, a] for a in range(3))
    spread = x.T @ x + _UPRIGHT * (len(y) * np.eye(3) - y.T @ y)
    up = np.linalg.eigh(spread)[1][:, 0]
    up *= -1.0 if np.sum((y + z) @ up) > 0 else 1.0
    flat = centre - centre.mean(axis=0)
    flat = flat - np.outer(flat @ up, up)
    along = np.linalg.svd(flat)[2][0] if np.abs(flat).max() > 1e-9 else x[0]
    along = along - (along @ up) * up
    along /= np.linalg.norm(along)
    out[:3, :3] = np.stack([along, np.cross(up, along), up])
    out[:3, 3] = -out[:3, :3] @ centre.mean(axis=0)
    return out
