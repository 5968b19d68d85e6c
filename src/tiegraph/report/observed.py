"""What the images observe, sampled from a sparse model: how far its points are, how small a pixel is, what the lens
leaves of the residuals."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.scene.scene import Scene

_ASKED = 60  # observations of an image
_CELLS = 12  # across the longer side of an image
_FEW = 5  # residuals of a cell that say nothing


@dataclass(frozen=True, eq=False)
class LensResiduals:
    """Mean residuals of a camera in the cells of its image, px: middles (K, 2), observed minus computed (K, 2)."""

    size: tuple[int, int]
    at: np.ndarray
    moved: np.ndarray
    observations: int


@dataclass(frozen=True, eq=False)
class Observed:
    """Of each image of a scene (N,), NaN where it sees no point: the size of a pixel (ground sampling distance) at the
    median distance, along the line of sight, of the points that it sees, in units of the model; by sensor key the
    residuals of the lens."""

    gsd: np.ndarray
    lenses: dict[int, LensResiduals]


def observed(model: Any, scene: Scene) -> Observed:
    """Of a ``pycolmap.Reconstruction``; images go by name."""
    gsd = np.full(len(scene), np.nan)
    seen: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    sizes: dict[int, tuple[int, int]] = {}
    for image in model.images.values():
        k = scene.image_index.get(image.name)
        rows = image.get_observation_point2D_idxs() if k is not None and image.has_pose else []
        asked = [image.point2D(rows[r]) for r in np.linspace(0, len(rows) - 1, min(len(rows), _ASKED)).astype(int)]
        pose, camera = image.cam_from_world().matrix() if asked else np.eye(4)[:3], model.cameras[image.camera_id]
        local = np.array([model.points3D[p.point3D_id].xyz for p in asked]).reshape(-1, 3) @ pose[:, :3].T + pose[:, 3]
        ahead = local[:, 2] > 0
        if ahead.any():
            gsd[k] = np.median(local[ahead, 2]) / camera.mean_focal_length()
            xy, key = np.array([p.xy for p in asked])[ahead], int(scene.sensor_key[k])
            sizes[key] = (camera.width, camera.height)
            seen.setdefault(key, []).append((xy, xy - np.asarray(camera.img_from_cam(local[ahead]), float)))
    return Observed(gsd, {key: _cells(sizes[key], found) for key, found in sorted(seen.items())})


def _cells(size: tuple[int, int], found: list[tuple[np.ndarray, np.ndarray]]) -> LensResiduals:
    """Mean residuals cell by cell; each is held to the middle nine tenths, for one wrong match outweighs many."""
    xy, off = (np.concatenate(parts) for parts in zip(*found))
    good = np.isfinite(off).all(axis=1)
    xy, off = xy[good], off[good]
    off = np.clip(off, *np.quantile(off, [0.05, 0.95], axis=0)) if len(off) else off
    side = max(size) / _CELLS
    cell, of, count = np.unique((xy // side).astype(int), axis=0, return_inverse=True, return_counts=True)
    mean = np.column_stack([np.bincount(of.ravel(), off[:, c], len(cell)) for c in range(2)]) / count[:, None]
    enough = count >= _FEW
    return LensResiduals(size=size, at=((cell + 0.5) * side)[enough], moved=mean[enough], observations=len(xy))
