"""Which images of a model are registered: those that see and fit points of it. All counts use this module.

A pose alone proves nothing: COLMAP registers a frame with all the cameras of its rig, also with those that see no point
at all (27 images of a drone rig over forest). Such images have the pose given by their rig and are counted separately.

An image is *registered* if it sees at least 10 points with residuals below 4 px. An image that has a pose
but not these is *placed by the rig*, and is counted separately everywhere.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import RegisteredTuning

BY_RIG = "placed by the rig"  # the name of the others in tables
_ASKED = 100  # points of an image that are tested; of more, some that are spread evenly
LEFT_OUT = "left out: "  # begin of the reason for an image that had a wrong position


@dataclass(frozen=True)
class Registration:
    """For each image of a scene (N,): whether it has a pose in the model, how many points it sees with small
    residuals, and the least number of these."""

    placed: np.ndarray  # (N,) bool
    points: np.ndarray  # (N,) i8
    min_points: int

    @property
    def registered(self) -> np.ndarray:
        """(N,) bool: it has a pose confirmed by points."""
        return self.placed & (self.points >= self.min_points)

    @property
    def by_rig(self) -> np.ndarray:
        """(N,) bool: it has a pose, from the other cameras of its rig or from very few points."""
        return self.placed & (self.points < self.min_points)


def registration(model: Any, scene: Scene, tuning: RegisteredTuning) -> Registration:
    """Of the images of a scene in a ``pycolmap.Reconstruction``; images go by name."""
    found = agreeing_points(model, tuning)
    placed = np.array([name in found for name in scene.names], bool)
    return Registration(placed, np.array([found.get(name, 0) for name in scene.names], int), tuning.min_points)


def agreeing_points(model: Any, tuning: RegisteredTuning) -> dict[str, int]:
    """By name of each image with a pose in a ``pycolmap.Reconstruction``: its points with small residuals."""
    return {i.name: _agreeing(model, i, tuning) for i in model.images.values() if i.has_pose}


def _agreeing(model: Any, image: Any, tuning: RegisteredTuning) -> int:
    rows = image.get_observation_point2D_idxs()
    asked = [image.point2D(rows[k]) for k in np.linspace(0, len(rows) - 1, min(len(rows), _ASKED)).astype(int)]
    if not asked:
        return 0
    pose = image.cam_from_world().matrix()
    local = np.array([model.points3D[p.point3D_id].xyz for p in asked]) @ pose[:, :3].T + pose[:, 3]
    ahead = local[:, 2] > 0
    place = np.asarray(model.cameras[image.camera_id].img_from_cam(local[ahead]), float)
    off = np.linalg.norm(place - np.array([p.xy for p in asked])[ahead], axis=1)
    return round(float(np.sum(off < tuning.agree_px)) / len(asked) * len(rows))  # NaN counts as disagreement
