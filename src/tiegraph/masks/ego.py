"""The platform in the picture: what stands still in a camera's images while everything else moves.

Measured on gradients, not on grey values: their direction does not change with the light. An edge of the platform has
the same direction at the same pixel in every frame, and does not even shake; a far skyline seen from a car has the
first but not the second. What lies between such edges and shows nothing that moves is the platform's inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks.frames import grey, read_frames

MIN_FRAMES = 6
"""Frames that differ from each other which a camera needs before anything is called platform."""
_MAX_FRAMES = 28  # more add time and no certainty
_MAX_READ = 160  # frames looked at when choosing those that differ
_CHOICE_PX = 320  # longer side at which they are compared
_MOVED_SHARE = 0.4  # of the textured area must have changed between two frames that count as different
_TEXTURE, _ALIKE = 0.03, 0.5  # contrast in log grey that counts as texture; correlation that counts as unchanged

# All sizes at a longer side of 640 pixels, gradients in grey levels times the Sobel gain of 8.
_NOISE = 14.0  # a gradient this strong counts half
_COHERENT, _VERY_COHERENT = 0.6, 0.75  # length of the mean gradient direction over the frames, 0..1
_STILL_PX, _STILL_COHERENT_PX = 0.35, 0.5  # how far an edge may shake: camera shake moves a far scene by more
_SHAKES_PX = 0.7
_SHAKE_FRAMES = 14  # enough for a median and for the 70 % of it
_MOVING = 0.45  # share of the textured frames in which the gradient has another direction
_MIN_EDGE_PX = 16  # shorter edges are chance
# Share of a region's outline that must be fixed edges; on scenes without platform 0 .. 0.14, dark roads 0.34.
_OUTLINE = 0.35
_RIM = 2 / 640  # of the longer side: the gradients are smoothed, and their kernel is three pixels wide
_MIN_AREA = 0.003  # of the image
_FEW_FRAMES, _FEW_AREA = 10, 0.03  # fewer frames agree by chance, at a pole straight ahead: up to 0.02 of the image
_MAX_ENCLOSED_AREA = 0.06  # of the image: a larger hole is a window on the scene
_STEADY_GREY = 14.0  # range of the grey value over the frames, whatever the light: black boxes, burnt-out decks
_BLACK_GREY, _SURROUND = 12.0, 4 / 640  # round the image of a fisheye lens nothing is ever seen; blur of its rim


@dataclass(frozen=True)
class Ego:
    """The platform in a camera's images: ``mask`` (h, w) bool, True = platform, None if none was found; and why."""

    mask: np.ndarray | None
    frames: int  # different frames it was learnt from
    note: str

    @property
    def share(self) -> float:
        """Share of the image, 0..1."""
        return 0.0 if self.mask is None else float(self.mask.mean())


def different_frames(images: Sequence[Path]) -> list[Path]:
    """Those images of a camera, in order, between which most of the texture has moved: none while the camera stands."""
    chosen: list[Path] = []
    last: tuple[np.ndarray, np.ndarray] | None = None
    for path, image in read_frames(_spread(images, _MAX_READ), _CHOICE_PX):
        detail = _detail(grey(image))
        if last is not None and (last[0].shape != detail[0].shape or not _moved(last, detail) >= _MOVED_SHARE):
            continue
        last = detail
        chosen.append(path)
    return chosen


def _spread(items: Sequence[Path], most: int) -> list[Path]:
    return [items[k] for k in np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).astype(int))]


def _detail(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    fine = np.log(image.astype(np.float32) + 10)
    fine -= _blur(fine, 4)
    contrast = np.sqrt(_blur(fine * fine, 3))
    return fine / (contrast + 0.01), contrast


def moved_share(a: np.ndarray, b: np.ndarray) -> float:
    """Share 0..1 of the texture of two images (h, w, 3) u1 BGR of one size that is not where it was; NaN if none."""
    return _moved(_detail(grey(a)), _detail(grey(b))) if a.shape == b.shape else float("nan")


def _moved(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> float:
    alike = _blur(a[0] * b[0], 3) / (np.sqrt(_blur(a[0] * a[0], 3) * _blur(b[0] * b[0], 3)) + 0.02)
    textured = (a[1] > _TEXTURE) & (b[1] > _TEXTURE)
    return float((alike[textured] < _ALIKE).mean()) if textured.any() else float("nan")


def _blur(image: np.ndarray, sigma: float) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), sigma)


def learn_ego(different: Sequence[Path], found: int) -> Ego:
    """The platform of one camera from images between which the scene has moved; ``found``: images it has in all."""
    if len(different) < MIN_FRAMES:
        why = "one image" if found == 1 else f"{found} images, {len(different)} of them different: it hardly moves"
        return Ego(None, len(different), f"no platform learnt ({why}; {MIN_FRAMES} are needed)")
    frames = [grey(image) for _, image in read_frames(_spread(different, _MAX_FRAMES))]
    shapes = [f.shape for f in frames]
    frames = [f for f in frames if f.shape == max(set(shapes), key=shapes.count)]
    mask = ego_of_frames(frames)
    if len(frames) < _FEW_FRAMES:
        mask = _at_border(mask, _FEW_AREA)
    if not mask.any():
        return Ego(None, len(frames), "no platform seen")
    return Ego(mask, len(frames), f"platform {100 * mask.mean():.0f} %")


def ego_of_frames(frames: Sequence[np.ndarray]) -> np.ndarray:
    """Platform (h, w) bool in grey images (h, w) u1 of one camera between which the scene has moved."""
    evidence = _Directions(frames)
    shake = _shake_px(frames)
    still = np.where(evidence.coherence > _VERY_COHERENT, _STILL_COHERENT_PX, _STILL_PX)
    edges = evidence.coherence > _COHERENT
    fixed = _long(edges & (shake < still))
    moving = evidence.moving(edges & (shake > _SHAKES_PX))
    low, high = _range(frames)
    steady = high - low < _STEADY_GREY
    inside = _outlined((moving < _MOVING) & ~fixed, fixed, _OUTLINE)
    platform = inside | fixed
    platform |= _outlined((steady | (moving < _MOVING)) & ~platform, platform, _OUTLINE)
    platform = _closed(platform, 7)
    platform = _at_border(platform)
    platform = _trimmed(_at_border(_opened(platform | _enclosed(platform, moving), 3)))
    black = _at_border(_outlined(high < _BLACK_GREY, fixed, _OUTLINE))  # a black backdrop ends nowhere in particular
    return platform | _grown(black, 2 * round(_SURROUND * max(black.shape)) + 1) if black.any() else platform


def _trimmed(platform: np.ndarray) -> np.ndarray:
    """The platform without the rim into which its edges blur; what is narrower than a railing stays."""
    side = 2 * round(_RIM * max(platform.shape)) + 1
    inner = cv2.erode(platform.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=1) > 0
    return inner | (platform & ~_opened(platform, side + 2))


class _Directions:
    """Mean direction of the gradients over the frames, and how often each frame's departs from it."""

    def __init__(self, frames: Sequence[np.ndarray]) -> None:
        unit = [_unit_gradient(f) for f in frames]
        self.sum_x, self.sum_y = sum(u[0] for u in unit), sum(u[1] for u in unit)
        count = len(frames)
        departs: np.ndarray = np.zeros(frames[0].shape, np.float32)
        textured: np.ndarray = np.zeros_like(departs)
        strength: np.ndarray = np.zeros_like(departs)
        for x, y in unit:
            size = np.sqrt(x * x + y * y)
            others_x, others_y = self.sum_x - x, self.sum_y - y  # a frame is no witness for itself
            others = np.sqrt(others_x * others_x + others_y * others_y) + 1e-6
            clear = size > 0.5
            departs += clear & ((x * others_x + y * others_y) < 0.5 * others)
            textured += clear
            strength += size
        self.departs, self.textured, strength = departs / count, textured / count, strength / count
        length = np.sqrt(self.sum_x**2 + self.sum_y**2) / count
        self.coherence = np.where(strength > 0.3, length / (strength + 0.15), 0)

    def moving(self, shaking: np.ndarray) -> np.ndarray:
        """Share (h, w) of the textured frames whose gradient departs, in the neighbourhood; shaking edges move."""
        departs = _blur(np.maximum(self.departs, shaking).astype(np.float32), 3)
        return departs / (_blur(np.maximum(self.textured, shaking).astype(np.float32), 3) + 0.06)


def _unit_gradient(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    smooth = _blur(frame.astype(np.float32), 0.8)
    x, y = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3)
    size = np.sqrt(x * x + y * y) + _NOISE
    return x / size, y / size


def _shake_px(frames: Sequence[np.ndarray]) -> np.ndarray:
    """How far the texture around each pixel moves against its median, pixels (70 % of the frames move less).

    One step of Lucas and Kanade along the gradient of the median, on detail of which the contrast is taken out.
    """
    detail = []
    for frame in frames[:: max(1, len(frames) // _SHAKE_FRAMES)]:
        fine = _blur(frame.astype(np.float32), 0.8)
        fine -= _blur(fine, 5)
        detail.append(fine / (np.sqrt(_blur(fine * fine, 7)) + 3))
    median = np.partition(np.stack(detail), len(detail) // 2, axis=0)[len(detail) // 2]
    x = cv2.Sobel(median, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    y = cv2.Sobel(median, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    energy = _blur(x * x + y * y, 4) + 1e-4
    steps = [np.hypot(_blur((d - median) * x, 4), _blur((d - median) * y, 4)) / energy for d in detail]
    return np.partition(np.stack(steps), int(0.7 * (len(steps) - 1)), axis=0)[int(0.7 * (len(steps) - 1))]


def _range(frames: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Darkest and brightest grey (h, w) f4 of each pixel over the frames, a tenth of them left out at either end."""
    half = [cv2.resize(f, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for f in frames]
    low, high = np.percentile(np.stack([cv2.GaussianBlur(h, (0, 0), 1) for h in half]), (10, 90), axis=0)
    shape = frames[0].shape[::-1]
    return cv2.resize(low.astype(np.float32), shape), cv2.resize(high.astype(np.float32), shape)


def _long(edges: np.ndarray) -> np.ndarray:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(_grown(edges, 3).astype(np.uint8), connectivity=8)
    long = np.maximum(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]) >= _MIN_EDGE_PX
    long[0] = False
    return long[labels]


def _outlined(region: np.ndarray, fixed: np.ndarray, share: float) -> np.ndarray:
    """The parts of a region (h, w) whose outline follows fixed edges; the image border says nothing either way."""
    region = _opened(region, 3).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(region, connectivity=4)
    outline = (region > 0) & ~(cv2.erode(region, np.ones((3, 3), np.uint8), borderValue=1) > 0)
    outline[[0, -1]] = outline[:, [0, -1]] = False
    around = np.bincount(labels[outline], minlength=count)
    held = np.bincount(labels[outline & _grown(fixed, 7)], minlength=count)
    accepted = (held > share * around) & (stats[:, cv2.CC_STAT_AREA] >= 40)
    accepted[0] = False
    return accepted[labels]


def _at_border(platform: np.ndarray, min_area: float = _MIN_AREA) -> np.ndarray:
    """Parts that are large enough and reach the border of the image, as whatever carries a camera does."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(platform.astype(np.uint8), connectivity=8)
    accepted = _touches(stats, platform.shape) & (stats[:, cv2.CC_STAT_AREA] >= min_area * platform.size)
    accepted[0] = False
    return accepted[labels]


def _touches(stats: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    left, top = stats[:, cv2.CC_STAT_LEFT], stats[:, cv2.CC_STAT_TOP]
    right, bottom = left + stats[:, cv2.CC_STAT_WIDTH], top + stats[:, cv2.CC_STAT_HEIGHT]
    return (left == 0) | (top == 0) | (right == shape[1]) | (bottom == shape[0])


def _enclosed(platform: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Holes of the platform that show less movement than a scene would; the view through a railing stays."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((~platform).astype(np.uint8), connectivity=4)
    area = np.maximum(np.bincount(labels.ravel(), minlength=count), 1)
    mean = np.bincount(labels.ravel(), moving.ravel(), minlength=count) / area
    accepted = ~_touches(stats, platform.shape) & (area < _MAX_ENCLOSED_AREA * platform.size) & (mean < 0.58)
    accepted |= area < 0.0005 * platform.size
    accepted[0] = False
    return accepted[labels]


def _grown(mask: np.ndarray, size_px: int) -> np.ndarray:
    return cv2.dilate(mask.astype(np.uint8), np.ones((size_px, size_px), np.uint8)) > 0


def _closed(mask: np.ndarray, size_px: int) -> np.ndarray:
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((size_px, size_px), np.uint8)) > 0


def _opened(mask: np.ndarray, size_px: int) -> np.ndarray:
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((size_px, size_px), np.uint8)) > 0
