"""Coded targets in one image: the refined corners of each, and their sigma.

From targets seen in images to marks of the points of a control point file, and what is odd about them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import robust_sigma
from tiegraph.scene.control import TargetMark
from tiegraph.scene.rig import on_plane
from tiegraph.scene.targets import CENTRE, Target, count_of, dictionary, families, refined
from tiegraph.targets.tuning import Tuning
from tiegraph.text import some

_NOISE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)  # blind to edges and slopes (Immerkaer 1996)


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
            # 0.06 px: of a corner, however sharp and noiseless, as in rendered images (tests/targets)
            sigma = float(np.hypot(np.median([_sigma(pixels, c, half, noise) for c in corners]), 0.06))
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


OTHERS = (
    "apriltag_16h5", "apriltag_25h9", "apriltag_36h10", "apriltag_36h11",
    "4x4_1000", "5x5_1000", "6x6_1000", "7x7_1000", "aruco_original", "aruco_mip_36h12",
)  # fmt: skip
"""Families that hold all others."""


def marks_of(
    seen: Mapping[int, Sequence[Seen]],
    named: Mapping[str, Target],
    camera_of: Callable[[int], pycolmap.Camera | None],
    names: Sequence[str],
) -> tuple[tuple[TargetMark, ...], tuple[str, ...]]:
    """Marks of the targets ``named`` in a file, of those ``seen`` by scene index, and notes; ``names`` of the images.

    A target at two places of one image was printed twice: it is not used at all.
    """
    by_target: dict[Target, dict[int, list[Seen]]] = defaultdict(lambda: defaultdict(list))
    for image, found in seen.items():
        for one in found:
            by_target[one.target][image].append(one)
    marks, notes = [], []

    def apart(found: Sequence[Seen]) -> bool:
        """Whether a target is at two places, and not at one with two outlines."""
        first = found[0].corners
        side = float(np.linalg.norm(first[1] - first[0]))
        return any(np.linalg.norm((s.corners - first).mean(axis=0)) > side / 2 for s in found[1:])

    for name, target in named.items():
        places = by_target.pop(target, {})
        twice = [k for k, found in places.items() if apart(found)]
        if twice:
            images = names[twice[0]] + (f" and of {len(twice) - 1} more" if len(twice) > 1 else "")
            notes.append(f"target {name} is seen at two places of {images}: printed twice? It is not used")
            continue
        if not places:
            notes.append(f"target {name} is seen in none of {len(seen)} images")
        elif len(places) == 1:
            only = names[next(iter(places))]
            notes.append(f"target {name} is seen in one image only, {only}: two are needed for a place")
        for k, found in places.items():
            best = min(found, key=lambda s: s.sigma_px)
            x, y = centre_of(best.corners, camera_of(k))
            sigma = float(best.sigma_px / np.sqrt(2))
            if np.isfinite([x, y, sigma]).all():
                marks.append(TargetMark(name=name, image=k, xy=(float(x), float(y)), sigma_px=sigma))
    # Those that the file does not name, seen in two images at least: one may be gravel
    others = [f"{t.name} ({len(places)} images)" for t, places in sorted(by_target.items()) if len(places) > 1]
    if others:
        notes.append(f"targets that are seen and not named in the file: {some(others)}")
    return tuple(marks), tuple(notes)


def likely_family(seen: Sequence[Seen]) -> str:
    """What was seen of other families, in words; "" if nothing twice."""
    count = Counter(s.target.family for s in seen)
    family, number = count.most_common(1)[0] if count else ("", 0)
    if number < 2:
        return ""
    largest = max(s.target.number for s in seen if s.target.family == family)
    size = family.partition("_")[0]
    if family.endswith("_1000"):
        fits = [n for n in families() if n.startswith(f"{size}_") and count_of(n) > largest]
        family = min(fits, key=count_of)
    return f"{Target(family, largest).name.partition(':')[0]} (seen {number} times)"


def seen_in(
    views: Mapping[int, tuple[np.ndarray, pycolmap.Camera]], place: np.ndarray
) -> dict[int, tuple[float, float]]:
    """Pixels at which images, by index, see a place (3,), the most central first; what hides it is not asked for.

    ``views``: cam_from_world (4, 4) and camera of each.
    """
    found = {}
    for k, (pose, camera) in views.items():
        there = transforms.apply(pose, place[None])[0]
        if not np.isfinite(there).all() or there[2] <= 0:
            continue
        xy = camera.img_from_cam(there)
        if xy is None or not np.isfinite(xy).all():
            continue
        size = np.array([camera.width, camera.height])
        inside = ((np.ravel(xy) >= 0) & (np.ravel(xy) <= size)).all()
        # On the plane z = 1, between a ray and the way there and back: lenses fold beyond their images
        if inside and np.abs(on_plane(camera, np.ravel(xy)[None])[0] - there[:2] / there[2]).max() < 1e-3:
            found[k] = (float(xy[0]), float(xy[1]))
    middle = {k: np.linalg.norm(np.array(xy) / (views[k][1].width, views[k][1].height) - 0.5)
              for k, xy in found.items()}  # fmt: skip
    return dict(sorted(found.items(), key=lambda item: (round(float(middle[item[0]]), 6), item[0])))
