"""A small model of the survey, made of previews: poses, cameras, points, and who sees them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.network.model.proxy import Proxy
from tiegraph.network.model.tuning import ModelTuning, ProxyTuning
from tiegraph.network.model.visible import Overlap, observed_proxy, shared_surface, visible_points
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.scene.ties import Sights, Ties
from tiegraph.scene.tuning import Tuning as SceneTuning


@dataclass(frozen=True)
class SurveyModel:
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
        return np.isfinite(self.cam_from_world).all(axis=(1, 2))

    def reach(self, tuning: ModelTuning) -> np.ndarray:
        """(N, 2) distances to the nearest and farthest points an image sees (percentiles); NaN without points."""
        centre = transforms.centre(self.cam_from_world)
        distance = np.linalg.norm(self.points[self.point] - centre[self.image], axis=1)
        out = np.full((len(self.cam_from_world), 2), np.nan)
        order = np.argsort(self.image, kind="stable")
        ends = np.searchsorted(self.image[order], np.arange(len(out) + 1))
        for k in np.flatnonzero(np.diff(ends) >= tuning.reach_points):
            out[k] = np.percentile(distance[order[ends[k] : ends[k + 1]]], tuning.reach_percentiles)
        return out

    def proxy(self, tuning: ProxyTuning) -> Proxy:
        """Its points as the surface."""
        return observed_proxy(self.points, self.image, self.point, self.cam_from_world, tuning)

    def overlap(self, max_angle_deg: float, tuning: ModelTuning) -> Overlap:
        """Predicted shared surface of every two images whose rays to it meet at no more than an angle."""
        proxy = self.proxy(tuning.proxy)
        return shared_surface(self.cam_from_world, self.cameras, proxy, tuning.visible, max_angle_deg)

    def sights(self, tuning: ModelTuning) -> Sights:
        """The points each image should see."""
        return visible_points(self.cam_from_world, self.cameras, self.proxy(tuning.proxy), tuning.visible)


# Scene and ties of the survey, or of a block of it; whether a rough model will do. None = none could be made.
ModelFunction = Callable[[Scene, Ties, bool], SurveyModel | None]


@dataclass(frozen=True)
class Maker:
    """Makes the models of a survey, whole or in blocks: ``model`` one of them, ``tuning`` by what it is cut and
    joined."""

    model: ModelFunction
    tuning: SceneTuning
