"""Stereo pairs with truth: Middlebury pairs of the measuring data, and a rendered scene with exact disparities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np


@dataclass(frozen=True, eq=False)
class Pair:
    """left, right (h, w) u1; truth (h, w) f4 disparity, NaN = unknown; seen (h, w) bool: not occluded; disparities: the
    search range from 0; bars: width in pixels -> (h, w) bool of thin foreground bars."""

    name: str
    left: np.ndarray
    right: np.ndarray
    truth: np.ndarray
    seen: np.ndarray
    disparities: int
    bars: dict[int, np.ndarray] = field(default_factory=dict)

    @property
    def judged(self) -> np.ndarray:
        """Pixels on which all methods are compared: truth known, not occluded, match inside the right image."""
        return self.seen & np.isfinite(self.truth) & (np.arange(self.left.shape[1])[None, :] >= self.disparities)


def middlebury(root: Path) -> Iterator[Pair]:
    """All pairs of ``stereo_gt`` whose truth is known."""
    for name in ("Cloth3", "Reindeer", "Wood2"):
        folder = root / "sgm_data" / "Data" / name
        truth, other = (_disparity(folder / f"disp{k}.png", 2) for k in (1, 5))
        yield Pair(name, _grey(folder / "view1.png"), _grey(folder / "view5.png"), truth, _visible(truth, other), 128)
    for name, scale, count in (("cones", 4, 64), ("teddy", 4, 64), ("venus", 8, 32)):
        folder = root / "localexp" / "data" / "MiddV2" / name
        truth = _disparity(folder / "groundtruth.png", scale)
        seen = _grey(folder / "nonocc.png") == 255
        yield Pair(name, _grey(folder / "imL.png"), _grey(folder / "imR.png"), truth, seen, count)
    folder = root / "motorcycle"
    truth = np.load(folder / "motorcycle_disp.npz")["arr_0"].astype(np.float32)
    truth[~np.isfinite(truth)] = np.nan
    left, right = _grey(folder / "motorcycle_left.png"), _grey(folder / "motorcycle_right.png")
    yield Pair("MotorcycleQ", left, right, truth, np.isfinite(truth), 64)


def _grey(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SystemExit(f"{path} cannot be read: set TIEGRAPH_DATA to the folder with stereo_gt")
    return image


def _disparity(path: Path, scale: float) -> np.ndarray:
    disparity = _grey(path).astype(np.float32) / scale
    return np.where(disparity > 0, disparity, np.float32(np.nan))


def _visible(truth: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Pixels whose match in the other view has the same disparity."""
    column = np.arange(truth.shape[1])[None, :] - np.rint(np.nan_to_num(truth)).astype(int)
    there = np.take_along_axis(other, np.clip(column, 0, truth.shape[1] - 1), axis=1)
    return (column >= 0) & (np.abs(there - truth) <= 1.5)


@dataclass(frozen=True)
class _Plane:
    """Disparity a (x - x0) + b (y - y0) + c on a rectangle of the left image."""

    x0: float
    y0: float
    width: float
    height: float
    a: float
    b: float
    c: float


def rendered(root: Path, width: int, height: int, disparities: int, seed: int = 0) -> Pair:
    """A wavy background, slanted planes and thin bars before it, in textures of real photographs; noise of 2.5 grey
    values, other gain and offset in the right image, weakly textured blobs."""
    rng = np.random.default_rng(seed)
    photographs = [p.left for p in middlebury(root) if min(p.left.shape) > 380]
    f, s = width / 2448, disparities / 512
    planes = [
        _Plane(500 * f, 250 * f, 500 * f, 700 * f, 0.10, 0.05, 150 * s),
        _Plane(1300 * f, 900 * f, 600 * f, 500 * f, -0.12, 0.02, 330 * s),
        _Plane(1500 * f, 200 * f, 350 * f, 350 * f, 0, 0, 420 * s),
        _Plane(700 * f, 1300 * f, 450 * f, 500 * f, 0.2, -0.1, 300 * s),
    ]
    bars = {}
    for k, bar in enumerate((2, 3, 4, 6, 8, 10, 12, 16)):
        bars[bar] = len(planes) + 1
        planes.append(_Plane((1560 + 110 * k) * f, 100 * f, bar, 1800 * f, 0, 0, (260 + k * 12) * s))
    size = (height, width + disparities + 64)
    textures = [_texture(size, photographs, seed + k) for k in range(len(planes) + 1)]
    left, truth, label = _render(planes, textures, (height, width), s, right=False)
    right, other, _ = _render(planes, textures, (height, width), s, right=True)

    def photographed(image: np.ndarray, gain: float, offset: float) -> np.ndarray:
        soft = cv2.GaussianBlur(image, (0, 0), 0.6) * gain + offset + rng.normal(0, 2.5, image.shape)
        return np.clip(soft, 0, 255).astype(np.uint8)

    pair = photographed(left, 1, 0), photographed(right, 0.9, 8)
    masks = {bar: label == k for bar, k in bars.items()}
    name = f"rendered {width}x{height}"
    return Pair(name, *pair, truth, _visible(truth, other), disparities, masks)


def _texture(size: tuple[int, int], photographs: list[np.ndarray], seed: int, tile: int = 360) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = np.zeros(size, np.float32)
    for y in range(0, size[0], tile):
        for x in range(0, size[1], tile):
            photograph = photographs[rng.integers(len(photographs))]
            top, begin = (int(rng.integers(0, n - tile + 1)) for n in photograph.shape)
            h, w = min(tile, size[0] - y), min(tile, size[1] - x)
            out[y : y + h, x : x + w] = photograph[top : top + h, begin : begin + w]
    for octave in (2, 8, 32):
        noise = rng.normal(0, 1, (size[0] // octave + 1, size[1] // octave + 1)).astype(np.float32)
        out += 6 * cv2.resize(noise, size[::-1], interpolation=cv2.INTER_CUBIC)
    weak = cv2.resize(rng.random((6, 8)).astype(np.float32), size[::-1], interpolation=cv2.INTER_CUBIC)
    weak = np.clip((weak - 0.75) * 8, 0, 1)
    return np.clip(out * (1 - weak) + weak * (120 + 0.06 * (out - 120)), 0, 255)


def _render(
    planes: list[_Plane], textures: list[np.ndarray], size: tuple[int, int], scale: float, right: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Image, disparity (each at this image's pixels) and label (0 = background)."""
    yy, xx = np.mgrid[: size[0], : size[1]].astype(np.float32)

    def background(x: np.ndarray) -> np.ndarray:
        u, v = x / size[1], yy / size[0]
        waves = 60 + 70 * v + 25 * np.sin(7 * u) * np.cos(5 * v) + 10 * np.sin(31 * u + 17 * v)
        return (waves * scale).astype(np.float32)

    x = xx
    for _ in range(25 if right else 0):
        x = xx + background(x)
    depth, label = background(x), np.zeros(size, np.uint8)
    image = cv2.remap(textures[0], x, yy, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    for k, p in enumerate(planes, 1):
        x = (xx + p.b * (yy - p.y0) + p.c - p.a * p.x0) / (1 - p.a) if right else xx
        d = p.a * (x - p.x0) + p.b * (yy - p.y0) + p.c
        inside = (x >= p.x0) & (x < p.x0 + p.width) & (yy >= p.y0) & (yy < p.y0 + p.height) & (d > depth)
        texture = cv2.remap(textures[k], x.astype(np.float32), yy, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        image[inside], depth[inside], label[inside] = texture[inside], d[inside], k
    return image, depth, label
