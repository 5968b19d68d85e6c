"""Settings of the dense stage."""

from typing import Annotated, Literal

from pydantic import Field

from tiegraph.plugins import or_plugin
from tiegraph.settings import Section

EngineName = Literal["tsgm", "sgbm"]


class DenseSettings(Section):
    """Depth maps by matching each image with a few well placed partners."""

    engine: Annotated[EngineName | str, or_plugin("dense", EngineName)] = "tsgm"
    """Dense matcher: tsgm = own hierarchical semi-global matching (paper 004); sgbm = OpenCV's."""
    paths: Literal[3, 5, 8] = 3
    """Directions in which sgbm gathers its costs: 5 takes a quarter, 8 twice more time, for little gain."""
    max_image_size: int = Field(3200, ge=64, le=20000)
    """Longer side of a depth map, in pixels; larger images are reduced to it. Half of it takes a third of the time:
    points have 1.4 to 2 times the sigma and twice the spacing, with fewer holes where poses or texture are poor."""
    max_fov_deg: float = Field(100.0, ge=20, le=140)
    """Field of view kept of wide-angle and fisheye images, in degrees across."""
    partners: int = Field(4, ge=1, le=8)
    """Images each image is matched with."""
    min_views: int = Field(3, ge=2, le=8)
    """Images that must agree on a depth, the image itself included; one more where its sigma exceeds 0.5 % of it."""
    min_angle_deg: float = Field(1.0, ge=0.05, le=20)
    """Smallest median angle of intersection with a partner, in degrees; below it the images count as one centre."""
    tolerance_px: float = Field(1.0, ge=0.25, le=5)
    """Largest disagreement between depths of different partners or depth maps, in pixels of disparity."""


class ShotsSettings(Section):
    """Clouds of single shots of a calibrated rig, without a sparse model (paper 004)."""

    near_m: float | None = Field(None, gt=0, le=1e6)
    """Nearest distance of the object in metres (default: 5 times the longest baseline)."""
    far_m: float | None = Field(None, gt=0, le=1e6)
    """Farthest distance of the object in metres (default: 100 times the longest baseline)."""
