"""The platform in the picture: the parts of a camera's images that are fixed while everything else moves.

Measured on gradients, not on grey values: their direction does not change with the light. An edge of the platform has
the same direction at the same pixel in every frame, and does not even shake; a far skyline seen from a car has the
first but not the second. Areas between such edges without any motion are the platform's inside.

By the same comparison of two frames, images are flagged that are hardly worth keeping: the same as the one before, or
blurred compared with their neighbours.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from tiegraph.masks.frames import closed, dilated, eroded, full_size, grey, opened, read_frames, read_small, small_shape
from tiegraph.masks.tuning import Tuning

T = TypeVar("T")

_CLEAR, _STILL_PX = 0.75, 0.35  # coherence of the clearest edges; px that a fixed edge may shake
_FOR_MARKS = 12  # images of a camera; more add time and no certainty


def different_frames(images: Sequence[Path], tuning: Tuning) -> list[Path]:
    """Images of a camera, in order, between which most of the texture has moved: none while the camera stands."""
    # Frames tested when choosing those that differ
    return _different(read_frames(spread(images, 160), tuning.look_px), tuning)


def _different(images: Iterable[tuple[T, np.ndarray]], tuning: Tuning) -> list[T]:
    """The first of each pair with an image u1 BGR between which and the one chosen before most of the texture moved."""
    chosen: list[T] = []
    last: tuple[np.ndarray, np.ndarray] | None = None
    for item, image in images:
        detail = _detail(image, tuning)
        if last is not None and last[0].shape != detail[0].shape:
            continue
        if last is not None and not _moved(last, detail, tuning) >= tuning.platform.min_moved:
            continue
        last = detail
        chosen.append(item)
    return chosen


def spread(items: Sequence[Path], most: int) -> list[Path]:
    """At most so many items, spread evenly over all."""
    return [items[k] for k in np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).astype(int))]


def _detail(image: np.ndarray, tuning: Tuning) -> tuple[np.ndarray, np.ndarray]:
    """Detail (h, w) f4 of an image u1 BGR, of which the contrast is taken out, and that contrast."""
    fine = np.log(grey(image).astype(np.float32) + tuning.faint_grey)
    fine -= _blur(fine, 4.0)  # what is coarser is no detail
    contrast = np.sqrt(_blur(fine * fine, tuning.platform.window_sigma_px))
    return fine / (contrast + 0.01), contrast  # a contrast in log grey that counts half


def _moved(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray], tuning: Tuning) -> float:
    """Share 0..1 of the texture of two images, by their ``_detail``, that has moved; NaN if they have none."""
    both, own_a, own_b = (_blur(p, tuning.platform.window_sigma_px) for p in (a[0] * b[0], a[0] * a[0], b[0] * b[0]))
    alike = both / (np.sqrt(own_a * own_b) + 0.02)
    textured = np.minimum(a[1], b[1]) > tuning.platform.texture
    return float((alike[textured] < tuning.platform.alike).mean()) if textured.any() else float("nan")


def _blur(image: np.ndarray, sigma: float) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), sigma)


def learn_platform(images: Sequence[Path], tuning: Tuning) -> tuple[list[Path], np.ndarray | None, str]:
    """Of one camera's images in order: those between which the scene has moved, the platform (h, w) bool by them, None
    if none was found, and what it is, in words."""
    different, least = different_frames(images, tuning), tuning.platform.min_frames
    if len(different) < least:
        count = len(images)
        why = "one image" if count == 1 else f"{count} images, {len(different)} of them different: it hardly moves"
        return different, None, f"no platform learnt ({why}; {least} are needed)"
    # More add time and no certainty
    frames = _of_one_shape([grey(image) for _, image in read_frames(spread(different, 28), tuning.work_px)])
    mask, marks = platform_of_frames(frames, tuning)
    if len(frames) < 10:
        mask = _at_border(mask, 0.03)  # few frames agree by chance at 0.02 of the image, a pole straight ahead
    mask |= marks
    if not mask.any():
        return different, None, "no platform seen"
    return different, mask, f"platform {100 * mask.mean():.0f} %"


def learn_marks(images: Sequence[Path], tuning: Tuning) -> np.ndarray | None:
    """What stands still in all images of one camera between which the scene moves, (h, w) bool: burnt-in text, scales,
    cross hairs, dirt, the border of a rectified image. None if there is nothing, or too few images differ."""
    read = [image for _, image in read_frames(spread(images, _FOR_MARKS), tuning.work_px)]
    sizes = [small_shape(image.shape[:2], tuning.look_px)[::-1] for image in read]
    looks = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image, size in zip(read, sizes)]
    frames = _of_one_shape([grey(image) for image in _different(zip(read, looks), tuning)])
    if len(frames) < tuning.platform.min_frames:
        return None
    coherence, shake = _directions(frames, tuning)[0], _shake_px(frames, tuning)
    marks = _marks(coherence, shake, _median(frames))
    return marks if marks.any() else None


def _marks(coherence: np.ndarray, shake: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Clear edges (h, w) bool that stand still and have more than one direction, with what is between the letters of a
    word and what a feature beside them would describe: a long edge along which a camera moves stands still too."""
    still = _long((coherence > _CLEAR) & (shake < _STILL_PX))
    parts = dilated(closed(still, 15), 9)
    count, labels = cv2.connectedComponents(parts.astype(np.uint8), connectivity=8)
    x, y = (gradient[still] for gradient in _gradient(picture))
    xx, yy, xy = (np.bincount(labels[still], product, minlength=count) for product in (x * x, y * y, x * y))
    most = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)  # of the eigenvalues of the structure tensor, whose sum ...
    return ((xx + yy - most) > 0.1 * most)[labels] & parts  # ... is that of the squares


def _of_one_shape(frames: list[np.ndarray]) -> list[np.ndarray]:
    shapes = [f.shape for f in frames]
    return [f for f in frames if f.shape == max(set(shapes), key=shapes.count)]


def platform_of_frames(frames: Sequence[np.ndarray], tuning: Tuning) -> tuple[np.ndarray, np.ndarray]:
    """Platform and marks (h, w) bool in grey images (h, w) u1 of one camera between which the scene has moved."""
    own = tuning.platform
    coherence, departs, textured = _directions(frames, tuning)
    shake, picture = _shake_px(frames, tuning), _median(frames)
    # Px that an edge may shake, the clearest more: a far scene shakes more
    still = np.where(coherence > _CLEAR, 0.5, _STILL_PX)
    edges = coherence > own.coherent
    fixed = _long(edges & (shake < still))
    borders = fixed & ~_strokes(fixed, picture)
    shaking = edges & (shake > 0.7)  # a coherent edge that shakes by more px moves
    around = own.window_sigma_px
    departs, textured = (_blur(np.maximum(share, shaking).astype(np.float32), around) for share in (departs, textured))
    moving = departs / (textured + 0.06)  # where hardly any frame has texture, nothing moves
    # Darkest and brightest grey of each pixel over the frames, some left out at either end
    half = [_blur(cv2.resize(f, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), 1.0) for f in frames]
    extremes = np.quantile(np.stack(half), (own.left_out, 1 - own.left_out), axis=0).astype(np.float32)
    low, high = (cv2.resize(grey_level, frames[0].shape[::-1]) for grey_level in extremes)
    steady = high - low < tuning.faint_grey  # black boxes, burnt-out decks
    inside = _outlined((moving < own.moving) & ~fixed, borders, tuning)
    platform = inside | borders
    platform |= _outlined((steady | (moving < own.moving)) & ~platform, platform, tuning)
    platform = closed(platform, 7)  # gaps between edges and inside
    platform = _at_border(platform, tuning.small)
    platform = opened(platform | _enclosed(platform, moving), tuning.fine_px)
    platform = _at_border(platform, tuning.small)
    # Without the blurred rim of its edges; parts narrower than a railing stay
    platform = eroded(platform, tuning.window_px) | (platform & ~opened(platform, tuning.window_px + 2))
    # Round the image of a fisheye lens nothing is ever seen
    black = _outlined(high < tuning.faint_grey, borders, tuning)  # a black backdrop ends nowhere in particular
    black = _at_border(black, tuning.small)
    platform |= dilated(black, tuning.band_px)  # its rim blurs
    return platform, _marks(coherence, shake, picture)


def _directions(frames: Sequence[np.ndarray], tuning: Tuning) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Length (h, w) of the mean direction of the gradients over the frames; shares (h, w) of the frames whose gradient
    departs from that of the others, and which have texture."""
    unit = []
    for frame in frames:
        x, y = _gradient(_blur(frame.astype(np.float32), tuning.smooth_sigma_px))
        size = np.sqrt(x * x + y * y) + 14.0  # a gradient this strong counts half (Sobel gain 8)
        unit.append((x / size, y / size))
    sum_x, sum_y = sum(u[0] for u in unit), sum(u[1] for u in unit)
    departs, textured, strength = np.zeros((3, *frames[0].shape), np.float32)
    for x, y in unit:
        size = np.sqrt(x * x + y * y)
        others_x, others_y = sum_x - x, sum_y - y  # a frame is no witness for itself
        others = np.sqrt(others_x * others_x + others_y * others_y) + 1e-6
        clear = size > 0.5  # share of its full weight from which a gradient is texture
        departs += clear & ((x * others_x + y * others_y) < 0.5 * others)
        textured += clear
        strength += size
    count = len(frames)
    strength /= count
    length = np.sqrt(sum_x**2 + sum_y**2) / count
    coherence = np.where(strength > 0.3, length / (strength + 0.15), 0)  # weak edges are less coherent
    return coherence, departs / count, textured / count


def _shake_px(frames: Sequence[np.ndarray], tuning: Tuning) -> np.ndarray:
    """How far the texture around each pixel moves against its median, pixels (0.7 of the frames move less).

    One step of Lucas and Kanade along the gradient of the median, on detail of which the contrast is taken out.
    """
    detail = []
    for frame in frames[:: max(1, len(frames) // 14)]:  # frames that are enough for a median
        fine = _blur(frame.astype(np.float32), tuning.smooth_sigma_px)
        fine -= _blur(fine, 5.0)  # what is coarser is no detail that could shake
        contrast = np.sqrt(_blur(fine * fine, 7.0))
        detail.append(fine / (contrast + 3.0))  # less contrast is noise
    median = np.partition(np.stack(detail), len(detail) // 2, axis=0)[len(detail) // 2]
    x = cv2.Sobel(median, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    y = cv2.Sobel(median, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    around = 4.0  # px of a neighbourhood that shakes as one
    energy = _blur(x * x + y * y, around) + 1e-4  # where there is hardly any texture, nothing shakes
    steps = [np.hypot(_blur((d - median) * x, around), _blur((d - median) * y, around)) / energy for d in detail]
    rank = int(0.7 * (len(steps) - 1))
    return np.partition(np.stack(steps), rank, axis=0)[rank]


def _strokes(edges: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Of edges (h, w) bool those of a thin stroke, whose other side has the opposite gradient: letters and scales that
    are drawn into images. They bound nothing; the sky between them would be the inside of a platform."""
    x, y = (np.where(edges, gradient, 0) for gradient in _gradient(picture))
    around = 4.0  # px within which both sides of a stroke lie
    return edges & (np.hypot(_blur(x, around), _blur(y, around)) < 0.4 * _blur(np.hypot(x, y), around))


def _median(frames: Sequence[np.ndarray]) -> np.ndarray:
    return np.median(frames, axis=0).astype(np.float32)


def _gradient(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return cv2.Sobel(picture, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(picture, cv2.CV_32F, 0, 1, ksize=3)


def _long(edges: np.ndarray) -> np.ndarray:
    joined = dilated(edges, 3).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    long = np.maximum(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]) >= 16  # shorter ones are chance
    long[0] = False
    return long[labels]


def _outlined(region: np.ndarray, fixed: np.ndarray, tuning: Tuning) -> np.ndarray:
    """The parts of a region (h, w) whose outline follows fixed edges; the image border does not count."""
    region = opened(region, tuning.fine_px).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(region, connectivity=4)
    outline = (region > 0) & ~eroded(region, 3)
    outline[[0, -1]] = outline[:, [0, -1]] = False
    around = np.bincount(labels[outline], minlength=count)
    held = np.bincount(labels[outline & dilated(fixed, 7)], minlength=count)
    # Px of a region that its outline may judge
    accepted = (held > tuning.platform.outline * around) & (stats[:, cv2.CC_STAT_AREA] >= 40)
    accepted[0] = False
    return accepted[labels]


def _at_border(platform: np.ndarray, min_area: float) -> np.ndarray:
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
    # A larger hole is a window on the scene
    accepted = ~_touches(stats, platform.shape) & (area < 0.06 * platform.size)
    accepted &= mean < 0.58  # the view through a railing moves more
    accepted |= area < 0.0005 * platform.size
    accepted[0] = False
    return accepted[labels]


def image_quality(image: Path, before: Path | None, use: np.ndarray, tuning: Tuning) -> tuple[float, float]:
    """Sharpness of an image, the share of its detail that is fine, and the share of its texture that moved since the
    one ``before``; on the pixels (h, w) bool that its mask uses, at any size. NaN where there is nothing to measure."""
    here = read_small(image, tuning.work_px)
    sharp = _sharpness(grey(here), full_size(use, here.shape[:2]), tuning)
    if before is None:
        return sharp, float("nan")
    other = read_small(before, tuning.look_px)
    same = cv2.resize(here, other.shape[1::-1], interpolation=cv2.INTER_AREA)
    return sharp, _moved(_detail(other, tuning), _detail(same, tuning), tuning)


def _sharpness(brightness: np.ndarray, use: np.ndarray, tuning: Tuning) -> float:
    # Detail of one pixel against detail of four: blur takes the first away, darkness and haze take both.
    if use.mean() < tuning.part:
        return float("nan")
    fine = cv2.GaussianBlur(brightness.astype(np.float32), (0, 0), tuning.smooth_sigma_px)
    medium, coarse = (cv2.GaussianBlur(fine, (0, 0), s) for s in (1.4, 5.6))
    inner = eroded(use, tuning.band_px)
    if not inner.any():
        return float("nan")
    energy = float(np.mean(np.square(medium - coarse)[inner]))
    return float(np.sqrt(np.mean(np.square(fine - medium)[inner]) / energy)) if energy > 0 else float("nan")


def flags(quality: Sequence[tuple[float, float]], tuning: Tuning) -> list[str]:
    """By ``image_quality`` of the images of a camera in order: why one is hardly worth keeping, with its figure; "" if
    it is."""
    sharp = np.array([sharpness for sharpness, _ in quality])
    found, reach = [], tuning.quality.neighbours
    for k, (sharpness, moved) in enumerate(quality):
        around = np.delete(sharp[max(0, k - reach) : k + reach + 1], min(k, reach))
        around = around[np.isfinite(around)]
        relative = sharpness / np.median(around) if len(around) >= reach / 2 else float("nan")
        if relative < tuning.quality.blurred:
            found.append(f"blurred: {relative:.2f} of its neighbours' sharpness")
        elif moved < tuning.quality.similar:
            found.append(f"similar: {100 * moved:.0f} % of its texture moved since the image before")
        else:
            found.append("")
    return found
