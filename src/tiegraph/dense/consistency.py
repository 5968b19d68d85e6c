"""Depth maps compared with each other: a depth stands if enough images say the same (paper 004, section 5.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tiegraph.dense.combine import MAX_RELATIVE, SIGMA_DISPARITY_PX
from tiegraph.dense.settings import DenseSettings
from tiegraph.geometry.transforms import invert
from tiegraph.scene.results import DepthMap

LoadDepth = Callable[[str], "DepthMap | None"]

_MIN_ALONG = 0.3  # cosine-like: a witness looking across our ray does not move our depth by more than 1 / 0.3
_MIN_RELATIVE = 0.002  # agreement is never asked closer than this share of the depth: poses are not perfect
_THROUGH = 1.5  # a witness sees through a point when its surface lies this many tolerances behind


@dataclass(frozen=True)
class Consistency:
    """What the comparison did to a depth map: pixels before, kept, and dropped for two reasons."""

    before: int
    kept: int
    few_views: int
    seen_through: int


def check(
    depth: DepthMap, partners: Sequence[str], witnesses: Sequence[str], load: LoadDepth, settings: DenseSettings
) -> tuple[DepthMap, Consistency]:
    """The depth map with witnesses counted and averaged in, pixels with fewer than ``min_views`` agreeing images
    dropped, as well as those that more witnesses see through than confirm.

    ``partners`` in the order of the bits of ``depth.support``; ``load`` returns a depth map by name or None where there
    is none. An image that has fewer witnesses than ``min_views`` asks for all of them.
    """
    shape = depth.depth_m.shape
    known = np.isfinite(depth.depth_m)
    support = np.zeros(shape, np.uint8) if depth.support is None else depth.support
    inverse = np.where(known, 1 / depth.depth_m, 0).astype(np.float64)
    variance = np.square(np.where(known, depth.sigma_m * inverse**2, 1.0))
    none, one = np.zeros(shape, np.int16), np.ones(shape, np.int16)
    tally = _Tally(depth.views.astype(np.int16), none, one, inverse / variance, 1 / variance)
    images = set(partners)
    for name in witnesses:
        other = load(name)
        if other is None:
            continue
        images.add(name)
        counted = (support >> np.uint8(partners.index(name))) & 1 > 0 if name in partners else np.zeros(shape, bool)
        tally = tally.heard(*_compare(depth, other, settings.tolerance_px), counted)
    few = known & (tally.views < min(settings.min_views, 1 + len(images)))
    floating = known & ~few & (tally.against >= tally.views)
    kept = known & ~few & ~floating
    result = _replaced(depth, kept, tally)
    return result, Consistency(int(known.sum()), int(kept.sum()), int(few.sum()), int(floating.sum()))


@dataclass(frozen=True, eq=False)
class _Tally:
    """What the images say of each pixel (H, W): how many agree, how many see through it, how many depth maps are in the
    mean, and the sums of inverse depth by precision and of precision."""

    views: np.ndarray
    against: np.ndarray
    maps: np.ndarray
    weighted: np.ndarray
    weight: np.ndarray

    def heard(
        self, agrees: np.ndarray, through: np.ndarray, said: np.ndarray, variance: np.ndarray, counted: np.ndarray
    ) -> _Tally:
        """With one more witness; ``counted`` = its image is in ``views`` already."""
        return _Tally(
            self.views + (agrees & ~counted),
            self.against + through,
            self.maps + agrees,
            self.weighted + np.where(agrees, said / variance, 0),
            self.weight + np.where(agrees, 1 / variance, 0),
        )


def _replaced(depth: DepthMap, kept: np.ndarray, tally: _Tally) -> DepthMap:
    # Depth maps of neighbours come from the same image pairs: the mean has the variance of one of them, less only by
    # what the images add that are new.
    gain = np.maximum(depth.views.astype(float) - 1, 1) / np.maximum(tally.views - 1, 1)
    sigma = np.sqrt(tally.maps / tally.weight * gain)
    safe = np.where(kept, tally.weighted / tally.weight, 1.0)
    nan = np.float32(np.nan)
    return replace(
        depth,
        depth_m=np.where(kept, 1 / safe, nan).astype(np.float32),
        sigma_m=np.where(kept, sigma / safe**2, nan).astype(np.float32),
        views=np.where(kept, np.minimum(tally.views, 255), 0).astype(np.uint8),
        support=None,
    )


def _compare(
    depth: DepthMap, other: DepthMap, tolerance_px: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(agrees, sees through) (H, W) bool, and what the other says at agreeing pixels: inverse depth, its variance."""
    other_from_depth = other.cam_from_world @ invert(depth.cam_from_world)
    along = _rays(depth) @ other_from_depth[:3, :3].T  # our rays in the other's frame, per unit of our depth
    z = depth.depth_m.astype(float)
    there = along * z[..., None] + other_from_depth[:3, 3]
    front = there[..., 2] > 0
    their_z = np.where(front, there[..., 2], np.nan)
    column = other.K[0, 0] * there[..., 0] / their_z + other.K[0, 2]
    row = other.K[1, 1] * there[..., 1] / their_z + other.K[1, 2]
    inverse, sigma = _sample(other, column, row)
    relative = 1 / (inverse * their_z) - 1  # their surface behind our point, as a share of its depth; NaN = not seen
    spread = np.hypot(depth.sigma_m / z, sigma / inverse) / SIGMA_DISPARITY_PX
    tolerance = np.clip(tolerance_px * spread, _MIN_RELATIVE, MAX_RELATIVE)
    agrees = np.abs(relative) <= tolerance
    through = relative > _THROUGH * tolerance
    # Our ray meets their surface, taken as parallel to their image, a little further on; oblique rays are held back.
    said = z + np.where(agrees, relative * their_z, 0) / np.maximum(along[..., 2], _MIN_ALONG)
    said = np.where(agrees, 1 / np.where(agrees, said, 1), 0)
    variance = np.where(agrees, np.square(sigma / inverse * said), 1)
    return agrees, through, said, variance


def _rays(depth: DepthMap) -> np.ndarray:
    """(H, W, 3) rays with z = 1 through the pixel centres."""
    height, width = depth.depth_m.shape
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([(u - depth.K[0, 2]) / depth.K[0, 0], (v - depth.K[1, 2]) / depth.K[1, 1], np.ones_like(u)], -1)


def _sample(other: DepthMap, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth (linear between pixels of one surface, which is exact on planes; else the nearest pixel's) and its
    sigma at positions of another depth map; NaN = nothing there."""
    x = np.where(np.isfinite(column), column - 0.5, -9).astype(np.float32)
    y = np.where(np.isfinite(row), row - 0.5, -9).astype(np.float32)
    x, y = np.clip(x, -9, 32000), np.clip(y, -9, 32000)

    def remap(values: np.ndarray, how: int, outside: float) -> np.ndarray:
        return cv2.remap(values, x, y, how, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)

    inverse = (1 / other.depth_m).astype(np.float32)
    known = np.isfinite(inverse).astype(np.float32)
    nearest = remap(inverse, cv2.INTER_NEAREST, np.nan)
    linear = remap(np.where(known > 0, inverse, np.float32(0)), cv2.INTER_LINEAR, 0.0)
    smooth = (remap(known, cv2.INTER_LINEAR, 0.0) > 0.999) & (np.abs(linear - nearest) < MAX_RELATIVE * nearest)
    relative_sigma = remap((other.sigma_m / other.depth_m).astype(np.float32), cv2.INTER_NEAREST, np.nan)
    inverse = np.where(smooth, linear, nearest)
    return inverse, relative_sigma * inverse
