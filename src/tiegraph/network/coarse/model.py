"""The coarse model of a survey or of a block of it, made of previews: poses, cameras, points, and who sees them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.network.coarse.proxy import Proxy
from tiegraph.network.coarse.visible import Overlap, observed_proxy, shared_surface, visible_points
from tiegraph.network.tuning.coarse import CoarseTuning
from tiegraph.scene.matches import Visibility
from tiegraph.scene.rig import Rig, camera_from_dict, camera_to_dict, rig_from_dict, rig_to_dict


@dataclass(frozen=True)
class CoarseModel:
    """A model of the survey in its own frame and units.

    cam_from_world (N, 4, 4), NaN = not in the model; cameras: one an image; points (P, 3); image (M,), point (M,):
    which image sees which point; rigs: with the extrinsics and cameras of the model.
    """

    cam_from_world: np.ndarray
    cameras: tuple[pycolmap.Camera, ...]
    points: np.ndarray
    image: np.ndarray
    point: np.ndarray
    rigs: tuple[Rig, ...]

    def placed(self) -> np.ndarray:
        """(N,) bool: images in the model."""
        return np.all(np.isfinite(self.cam_from_world), axis=(1, 2))

    def reach(self) -> np.ndarray:
        """(N, 2) distances to the nearest and farthest points an image sees (percentiles); NaN without points."""
        centre = transforms.centre(self.cam_from_world)
        distance = np.linalg.norm(self.points[self.point] - centre[self.image], axis=1)
        out = np.full((len(self.cam_from_world), 2), np.nan)
        order = np.argsort(self.image, kind="stable")
        ends = np.searchsorted(self.image[order], np.arange(len(out) + 1))
        for k in np.flatnonzero(np.diff(ends) >= 10):
            own = order[ends[k] : ends[k + 1]]
            out[k] = np.percentile(distance[own], (5.0, 95.0))
        return out

    def proxy(self) -> Proxy:
        """Its points as the surface."""
        return observed_proxy(self.points, self.image, self.point, self.cam_from_world)

    def overlap(self, max_angle_deg: float, tuning: CoarseTuning) -> Overlap:
        """Predicted shared surface of every two images whose rays to it meet at no more than an angle."""
        proxy = self.proxy()
        return shared_surface(self.cam_from_world, self.cameras, proxy, tuning.visible, max_angle_deg)

    def visibility(self, tuning: CoarseTuning) -> Visibility:
        """The points each image should see."""
        return visible_points(self.cam_from_world, self.cameras, self.proxy(), tuning.visible)

    def to_npz(self) -> dict[str, np.ndarray]:
        """Arrays for ``np.savez``: all of it, exactly; cameras and rigs as JSON."""
        words = [json.dumps(camera_to_dict(c)) for c in self.cameras]
        kinds = list(dict.fromkeys(words))
        return {
            "cam_from_world": self.cam_from_world,
            "points": self.points,
            "image": self.image,
            "point": self.point,
            "cameras": np.array(kinds, str),
            "camera": np.array([kinds.index(w) for w in words], np.int32),
            "rigs": np.array([json.dumps(rig_to_dict(r)) for r in self.rigs], str),
        }

    @staticmethod
    def from_npz(data: Mapping[str, np.ndarray]) -> "CoarseModel":
        """Inverse of ``to_npz``."""
        kinds = [camera_from_dict(json.loads(str(c))) for c in data["cameras"]]
        rigs = tuple(rig_from_dict(json.loads(str(r))) for r in data["rigs"])
        cameras = tuple(kinds[k] for k in data["camera"])
        return CoarseModel(
            cam_from_world=data["cam_from_world"],
            cameras=cameras,
            points=data["points"],
            image=data["image"],
            point=data["point"],
            rigs=rigs,
        )
