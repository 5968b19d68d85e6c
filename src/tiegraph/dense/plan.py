"""What one depth map needs to be made: small picklable objects, so that a worker never loads the whole model."""

from dataclasses import dataclass, field

import numpy as np
import pycolmap


@dataclass(frozen=True)
class CameraModel:
    """A COLMAP camera by value: model name, size in pixels, parameters in COLMAP's order."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    @staticmethod
    def of(camera: pycolmap.Camera) -> "CameraModel":
        """Of a pycolmap camera."""
        return CameraModel(
            model=camera.model_name,
            width=camera.width,
            height=camera.height,
            params=tuple(float(p) for p in camera.params),
        )

    def to_pycolmap(self) -> pycolmap.Camera:
        """As a pycolmap camera."""
        return pycolmap.Camera(model=self.model, width=self.width, height=self.height, params=list(self.params))


@dataclass(frozen=True, eq=False)
class ViewPlan:
    """An image of the model: name, camera, cam_from_world (4, 4)."""

    name: str
    camera: CameraModel
    cam_from_world: np.ndarray


@dataclass(frozen=True)
class DepthRange:
    """Depths along the optical axis between which a surface is sought, in world units, 0 < near < far."""

    near: float
    far: float


@dataclass(frozen=True, eq=False)
class Partner:
    """An image that may be matched with a reference image; ``reason`` is empty unless it was refused.

    shared = sparse points in both; angle_deg = median angle of intersection; scale = size of an object in the partner
    per its size in the reference (median).
    """

    view: ViewPlan
    shared: int
    angle_deg: float
    scale: float
    reason: str = ""

    @property
    def used(self) -> bool:
        """Whether the pair is matched."""
        return not self.reason


@dataclass(frozen=True, eq=False)
class ImagePlan:
    """One reference image: its partners to match with, and the further images whose depth maps can confirm it."""

    view: ViewPlan
    partners: tuple[ViewPlan, ...]
    witnesses: tuple[str, ...]  # names of images whose depth maps are compared with this one's
    depth_range: DepthRange


@dataclass(frozen=True, eq=False)
class DensePlan:
    """All reference images by name; those left out with the reason; remarks for people."""

    images: dict[str, ImagePlan]
    dropped: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    refused: dict[str, int] = field(default_factory=dict)  # reason -> number of refused pairs
