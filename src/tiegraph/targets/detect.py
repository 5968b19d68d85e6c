"""Coded targets in one image: the refined corners of each, and their sigma."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np

from tiegraph.geometry.align import robust_sigma
from tiegraph.scene.rig import on_plane
from tiegraph.scene.targets import CENTRE, Target, dictionary, refined
from tiegraph.targets.tuning import Tuning

if TYPE_CHECKING:
    import pycolmap

_NOISE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)  # blind to edges and slopes (Immerkaer 1996)
_LEAST_SIGMA_PX = 0.06  # of a corner, however sharp and noiseless, as in rendered images (tests/targets)


@dataclass(frozen=True)
class Seen:
    """A target in an image: corners (4, 2) in COLMAP's pixels, sigma of one of them."""

    target: Target
    corners: np.ndarray
    sigma_px: float


def find_targets(pixels: np.ndarray, families: Sequence[str], tuning: Tuning) -> list[Seen]:
    """All targets of some families in an image (H, W) u1, in the order of families and numbers."""
    # Sigma of an image's noise, grey levels, from its quieter half
    high = cv2.filter2D(pixels, cv2.CV_32F, _NOISE) / 6.0  # root of the sum of its squares
    noise = max(robust_sigma(high), 0.5)  # grey levels: rounding alone has 0.29
    rate = 4 * tuning.least_side_px / max(pixels.shape)
    out = []
    for family in families:
        quads, numbers, _ = _detector(family, rate).detectMarkers(pixels)
        for number, quad in zip(np.zeros(0, int) if numbers is None else numbers.ravel(), quads):
            xy = quad.reshape(4, 2)
            side = float(np.linalg.norm(xy - np.roll(xy, 1, axis=0), axis=1).min())
            free = side / 8  # the border, one bit of an AprilTag 36h11 wide; others are near
            corners = refined(pixels, xy, free, tuning.refine_share, tuning.refine_px)
            half = int(np.clip(round(tuning.refine_share * free), *tuning.refine_px))
            sigma = float(np.hypot(np.median([_sigma(pixels, c, half, noise) for c in corners]), _LEAST_SIGMA_PX))
            out.append(Seen(Target(family, int(number)), corners.astype(float) + CENTRE, sigma))
    return sorted(out, key=lambda s: (s.target, *s.corners[0]))


def centre_of(corners: np.ndarray, camera: pycolmap.Camera | None) -> np.ndarray:
    """(2,) pixel of the middle of a square whose corners (4, 2) are seen: where its diagonals meet, free of distortion
    where the camera is known."""
    plane = corners if camera is None else on_plane(camera, corners)
    if camera is None or not np.isfinite(plane).all():
        return _crossing(corners)
    return np.asarray(camera.img_from_cam(np.append(_crossing(plane), 1.0))).ravel()


def _crossing(corners: np.ndarray) -> np.ndarray:
    a, b, c, d = corners
    shares = np.linalg.solve(np.column_stack([c - a, b - d]), b - a)
    return np.asarray(a + shares[0] * (c - a))


@lru_cache
def _detector(family: str, least_rate: float) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = least_rate
    parameters.errorCorrectionRate = 0.3  # OpenCV's 0.6 finds small families in gravel
    return cv2.aruco.ArucoDetector(dictionary(family), parameters)


def _sigma(pixels: np.ndarray, xy: np.ndarray, half: int, noise: float) -> float:
    """Sigma of a corner q, the zero of sum w g g^T (p - q) over the pixels p of its window, by the noise of g.

    Central differences have noise^2 / 2, which acts by the distance of p from q.
    """
    x, y = np.round(xy).astype(int)
    if min(x - half, y - half) < 1 or x + half + 2 > pixels.shape[1] or y + half + 2 > pixels.shape[0]:
        return np.inf
    gy, gx = np.gradient(pixels[y - half - 1 : y + half + 2, x - half - 1 : x + half + 2].astype(np.float32))
    g = np.stack([gx, gy], axis=-1)[1:-1, 1:-1].reshape(-1, 2)
    d = np.stack(np.meshgrid(*[np.arange(-half, half + 1)] * 2), axis=-1).reshape(-1, 2)
    squared = np.sum(d**2, axis=1)
    weight = np.exp(-squared / half**2)  # OpenCV's window
    normal = np.einsum("k,ki,kj->ij", weight, g, g)
    spread = np.einsum("k,ki,kj->ij", weight**2 * squared * noise**2 / 2, g, g)
    if np.linalg.det(normal) <= 0:
        return np.inf
    inverse = np.linalg.inv(normal)
    return float(np.sqrt(np.trace(inverse @ spread @ inverse) / 2))
