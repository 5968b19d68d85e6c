"""Low-resolution previews: SIFT features and brightness of an image, and a cheap comparison of two images.

SIFT and not ORB: on ``canal`` (300 rendered images, repeated walls) a model of the survey made of 2554 SIFT previews of
400 px holds all images within 0.07 m, one of ORB previews is torn (11 m); a preview costs 6 instead of 3.5 ms.
The counts show which images may tie; the rotations of single pairs are coarse and serve only for votes.

A COLMAP database of previews: the input of a small model of the survey.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from tiegraph.features import matchers
from tiegraph.features.settings import PreviewSettings
from tiegraph.features.sift import contrast, evened, root_sift
from tiegraph.features.tuning import PreviewTuning, Tuning
from tiegraph.limits import need_room
from tiegraph.scene.colmaprows import DATABASE_BYTES, create_database, write_ties
from tiegraph.scene.pairs import PreviewMatches
from tiegraph.scene.rig import on_plane
from tiegraph.scene.scene import Scene

BINS = 16  # of the brightness histogram


@dataclass(frozen=True)
class Preview:
    """Features and brightness of one reduced image.

    xy (K, 2) f4 pixels of the full image, (0, 0) = corner of the first pixel (COLMAP); descriptors (K, 128) u1
    root-SIFT; scale: reduced pixels a full pixel; brightness: mean grey of the whole image without mask, 0..255;
    contrast: of the full image, grey levels (``contrast``); shares (16,) f4 histogram of the grey values, sum 1.
    """

    xy: np.ndarray
    descriptors: np.ndarray
    width: int
    height: int
    scale: float
    brightness: float
    contrast: float
    shares: np.ndarray

    def __len__(self) -> int:
        return len(self.xy)

    def to_npz(self) -> dict[str, np.ndarray]:
        """Arrays for ``np.savez``."""
        head = np.array([self.width, self.height, self.scale, self.brightness, self.contrast], np.float64)
        return {"xy": self.xy, "descriptors": self.descriptors, "head": head, "shares": self.shares}

    @staticmethod
    def from_npz(data: dict[str, np.ndarray]) -> Preview:
        """Inverse of ``to_npz``."""
        width, height, scale, brightness, contrast = (float(v) for v in data["head"])
        return Preview(
            xy=np.asarray(data["xy"], np.float32),
            descriptors=np.asarray(data["descriptors"], np.uint8),
            width=int(width),
            height=int(height),
            scale=scale,
            brightness=brightness,
            contrast=contrast,
            shares=np.asarray(data["shares"], np.float32),
        )


@dataclass(frozen=True)
class PreviewMatch:
    """Comparison of two previews: inliers of one essential matrix; cam_b_from_cam_a rotation (3, 3), None without
    inliers; shift (2,) median motion of the inliers from a to b as a share of the image width and height; matches
    (inliers, 2) u2 rows of a and of b."""

    inliers: int
    rotation: np.ndarray | None = None
    shift: np.ndarray | None = None
    matches: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.uint16))


def extract_preview(gray: np.ndarray, mask: np.ndarray | None, settings: PreviewSettings, tuning: Tuning) -> Preview:
    """Preview of a grey image (H, W) u1; ``mask`` (H, W) bool, True = use. Raises ValueError on bad shapes."""
    if gray.ndim != 2 or gray.dtype != np.uint8:
        raise ValueError(f"a preview needs a grey (H, W) uint8 image, got {gray.shape} {gray.dtype}")
    if mask is not None and mask.shape != gray.shape:
        raise ValueError(f"the mask {mask.shape} does not have the size of the image {gray.shape}")
    height, width = gray.shape
    # By area and not by the longest side: a narrow strip would leave so few rows that chance matches fit any geometry.
    scale = min(1.0, settings.size_px * float(np.sqrt(0.75 / (height * width))))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    shown = contrast(gray, tuning.contrast)
    small, lit = (g if scale == 1.0 else cv2.resize(g, size, interpolation=cv2.INTER_AREA)
                  for g in (gray, evened(gray, tuning.contrast, shown)))  # fmt: skip
    use = None
    if mask is not None:
        share = cv2.resize(mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
        use = np.where(share >= 255 * tuning.preview.min_used, 255, 0).astype(np.uint8)
    points, descriptors = _spread_sift(lit, use, settings, tuning)
    # OpenCV counts from the centre of the first pixel, COLMAP from its corner.
    xy = (points + 0.5) * np.array([width / size[0], height / size[1]])
    histogram = np.bincount(np.asarray(small).ravel() // (256 // BINS), minlength=BINS).astype(np.float32)
    shares = histogram / max(1, small.size)
    return Preview(
        xy=xy.astype(np.float32),
        descriptors=descriptors,
        width=width,
        height=height,
        scale=scale,
        brightness=float(small.mean()),
        contrast=shown,
        shares=shares,
    )


def _spread_sift(
    small: np.ndarray, use: np.ndarray | None, settings: PreviewSettings, tunings: Tuning
) -> tuple[np.ndarray, np.ndarray]:
    """Points (K, 2) and root-SIFT (K, 128) u1 of the strongest features of each grid cell, round robin."""
    tuning = tunings.preview
    sift = cv2.SIFT.create(
        nfeatures=0, contrastThreshold=tuning.contrast, edgeThreshold=tunings.sift.edges, enable_precise_upscale=True
    )
    # One call: describing only the kept ones would build the pyramid a second time, and costs more.
    found, descriptors = sift.detectAndCompute(small, use)
    if not found:
        return np.zeros((0, 2)), np.zeros((0, 128), np.uint8)
    points = np.array([k.pt for k in found])
    response = np.array([k.response for k in found])
    cell = np.floor(np.maximum(points, 0) / (max(small.shape) / tuning.cells)).astype(int)
    keep = spread(cell[:, 0] + cell[:, 1] * 2 * tuning.cells, response, settings.features)
    return points[keep], root_sift(descriptors[keep])


def spread(cell: np.ndarray, response: np.ndarray, count: int) -> np.ndarray:
    """Indices of at most ``count`` items: the strongest of every cell first, then the second of every cell, ..."""
    order = np.lexsort((-response, cell))
    rank = np.arange(len(order)) - np.searchsorted(cell[order], cell[order])
    chosen = np.lexsort((-response[order], rank))[:count]
    return np.sort(order[chosen])


def match_previews(
    a: Preview,
    b: Preview,
    camera_a: pycolmap.Camera,
    camera_b: pycolmap.Camera,
    settings: PreviewSettings,
    tuning: PreviewTuning,
) -> PreviewMatch:
    """Inliers of the essential matrix (five points, Nister 2004) of two previews.

    A camera with a guessed focal length serves too: a fundamental matrix needs a third more inliers for the same false
    alarms.
    """
    left, right = tentative(a, b, settings, tuning)
    if len(left) < tuning.least_matches:
        return PreviewMatch(0)
    rays_a = on_plane(camera_a, a.xy[left])
    rays_b = on_plane(camera_b, b.xy[right])
    good = np.isfinite(rays_a).all(axis=1) & np.isfinite(rays_b).all(axis=1)
    if good.sum() < tuning.least_matches:
        return PreviewMatch(0)
    focal = 0.5 * (camera_a.mean_focal_length() * a.scale + camera_b.mean_focal_length() * b.scale)
    inliers, rotation = _essential(rays_a[good], rays_b[good], settings.max_error_px / focal, tuning)
    if inliers.sum() < tuning.least_matches:
        return PreviewMatch(0)
    share_a = a.xy[left[good][inliers]] / (a.width, a.height)
    share_b = b.xy[right[good][inliers]] / (b.width, b.height)
    matches = np.stack([left[good][inliers], right[good][inliers]], axis=1).astype(np.uint16)
    return PreviewMatch(
        inliers=len(matches),
        rotation=rotation,
        shift=np.median(share_b - share_a, axis=0),
        matches=matches,
    )


def tentative(
    a: Preview, b: Preview, settings: PreviewSettings, tuning: PreviewTuning
) -> tuple[np.ndarray, np.ndarray]:
    """Indices (M,), (M,) of descriptors that are each other's nearest and pass the ratio test."""
    nothing = np.zeros(0, int)
    if len(a) < 2 or len(b) < 2:
        return nothing, nothing
    of_a, of_b = matchers.search(a.descriptors, b.descriptors)
    rows, partner = np.arange(len(a)), of_a[0]
    cosines = of_a[1:].astype(np.float32) / matchers.NORM**2
    best, second = np.sqrt(np.maximum(0, 2 - 2 * cosines))
    good = (of_b[0][partner] == rows) & (best <= settings.ratio * second) & (best <= tuning.max_distance)
    return rows[good], partner[good].astype(int)


def _essential(
    rays_a: np.ndarray, rays_b: np.ndarray, max_error: float, tuning: PreviewTuning
) -> tuple[np.ndarray, np.ndarray | None]:
    """Inliers (M,) bool and rotation of rays (M, 2), normalised image coordinates."""
    eye = np.eye(3)
    matrix, found = cv2.findEssentialMat(
        rays_a, rays_b, eye, cv2.USAC_FAST, tuning.confidence, max_error, tuning.trials
    )
    if matrix is None or found is None or matrix.shape != (3, 3):
        return np.zeros(len(rays_a), bool), None
    inliers = found.ravel() > 0
    if inliers.sum() < tuning.least_matches:
        return inliers, None
    _, rotation, _, _ = cv2.recoverPose(matrix, rays_a, rays_b, eye, mask=found.copy())
    return inliers, rotation


# --- a COLMAP database of previews -----------------------------------------------------------------------------------


_POINT_BYTES = 24  # of a key point in the database
_MATCH_BYTES = 8  # of each end of a match: it is there twice, as a match and as an inlier


def write_preview_database(
    path: Path, scene: Scene, previews: Iterable[Preview], ties: PreviewMatches, min_matches: int
) -> np.ndarray:
    """Database of the scene with the previews' key points (full-resolution pixels) and their ties as verified matches.

    Ties of fewer than ``min_matches`` are left out; returns (T,) bool, which ties were written. Raises InputError for a
    sensor without a camera or a full disk.
    """
    create_database(path, scene)
    used = ties.counts() >= min_matches
    points = len(scene) * (1 + int(ties.matches.max(initial=0))) * _POINT_BYTES
    need_room(path, DATABASE_BYTES + 2 * (points + ties.matches.size * _MATCH_BYTES))
    write_ties(path, (preview.xy for preview in previews), ties, used)
    return used
