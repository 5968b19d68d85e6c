"""The images of a finished survey as products take their colours from them: undistorted, at their own resolution."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tiegraph.dense.plan import CameraModel, ViewPlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.undistort import load_view, pinhole
from tiegraph.geometry.stereo import Pinhole
from tiegraph.pipeline.files import FINAL, load_model
from tiegraph.project.run import Run
from tiegraph.scene.colmapmodel import matrix

_SHARP = 20_000  # longest side of an undistorted image: as large as they come


def plans_of(run: Run) -> list[ViewPlan]:
    """The images of the model in the world, by name."""
    images = load_model(run.path("sparse", "world")).images.values()
    there = sorted((i for i in images if i.has_pose), key=lambda i: i.name)
    return [ViewPlan(i.name, CameraModel.of(i.camera), matrix(i.cam_from_world())) for i in there]


@dataclass(frozen=True, eq=False)
class Pictures:
    """Where the pixels of the images come from: at their own resolution, undistorted."""

    folder: Path
    plans: Sequence[ViewPlan]
    sharp: DenseSettings

    @staticmethod
    def of(run: Run, plans: Sequence[ViewPlan]) -> "Pictures":
        """Those of a run."""
        return Pictures(run.folder, plans, run.settings.dense.model_copy(update={"max_image_size": _SHARP}))

    def cameras(self) -> list[Pinhole]:
        """The undistorted cameras, without reading an image."""
        return [pinhole(p, self.sharp) for p in self.plans]

    def picture(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """RGB (H, W, 3) u1 of an image, and which of its pixels may be used (H, W) bool."""
        found = load_view(self.plans[k], self.folder / "images", self.folder / FINAL / "masks", self.sharp)
        return cv2.cvtColor(found.image_bgr, cv2.COLOR_BGR2RGB), found.mask
