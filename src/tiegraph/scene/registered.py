"""Which images of a model are registered: they see points of it, and agree with them. Everything that counts asks here.

A pose alone proves nothing: COLMAP registers a frame with all the cameras of its rig, also with those that see no point
at all (27 images of a drone rig over forest). Such images stand where their rig puts them and are counted apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.scene.scene import Scene

MIN_POINTS = 10  # that an image must see: fewer may agree by chance
AGREE_PX = 4.0  # between a point's projection and where it is seen; COLMAP's own limit of an observation
BY_RIG = "placed by the rig"  # what the others are called in tables
_ASKED = 100  # points of an image that are looked at; of more, some that are spread evenly


@dataclass(frozen=True)
class Registration:
    """Of each image of a scene (N,): whether it has a pose in the model, and how many points it sees that agree."""

    placed: np.ndarray  # (N,) bool
    points: np.ndarray  # (N,) i8

    @property
    def registered(self) -> np.ndarray:
        """(N,) bool: it has a pose that points bear out."""
        return self.placed & (self.points >= MIN_POINTS)

    @property
    def by_rig(self) -> np.ndarray:
        """(N,) bool: it has a pose, from the other cameras of its rig or from very few points."""
        return self.placed & (self.points < MIN_POINTS)


def registration(model: Any, scene: Scene) -> Registration:
    """Of the images of a scene in a ``pycolmap.Reconstruction``; images go by name."""
    placed, points = np.zeros(len(scene), bool), np.zeros(len(scene), int)
    for name, count in agreeing_points(model).items():
        k = scene.image_index.get(name)
        if k is not None:
            placed[k], points[k] = True, count
    return Registration(placed, points)


def agreeing_points(model: Any) -> dict[str, int]:
    """By name of each image with a pose in a ``pycolmap.Reconstruction``: points it sees where they should be."""
    return {i.name: _agreeing(model, i) for i in model.images.values() if i.has_pose}


def _agreeing(model: Any, image: Any) -> int:
    rows = image.get_observation_point2D_idxs()
    asked = [image.point2D(rows[k]) for k in np.linspace(0, len(rows) - 1, min(len(rows), _ASKED)).astype(int)]
    if not asked:
        return 0
    pose = image.cam_from_world().matrix()
    local = np.array([model.points3D[p.point3D_id].xyz for p in asked]) @ pose[:, :3].T + pose[:, 3]
    ahead = local[:, 2] > 0
    place = np.asarray(model.cameras[image.camera_id].img_from_cam(local[ahead]), float)
    off = np.linalg.norm(place - np.array([p.xy for p in asked])[ahead], axis=1)
    return round(float(np.sum(off < AGREE_PX)) / len(asked) * len(rows))  # NaN agrees with nothing
