"""Images cut into pinhole views: fisheye images, by the image circles of their lenses, one or two in a file, and
equirectangular panoramas, by their part of the sphere.

The tags of panoramas are those of Google's photo sphere XMP metadata (namespace GPano).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import pycolmap
from PIL import Image

from tiegraph.geometry.transforms import unit_rays
from tiegraph.scene.cells import number
from tiegraph.scene.exif import xmp_text, xmp_value
from tiegraph.scene.rig import Circle, LensView, Sensor

_LOOK_PX = 480  # longer side of a lens' image at which its circle is searched: a pixel is 0.4 % of its radius
_DARK_GREY = 24.0  # brightest channel of unlit pixels, with JPEG's noise; kerry_park's surround has 0 .. 12
_PLAY_PX = 1.5  # from the circle: a pixel and its blur; places this near to the border are not used
_RIM = 360  # corners of the rim of a cone, drawn as a polygon
_STEP = 4  # pixels between those whose places in a fisheye image are computed
_NOWHERE = -8.0  # farther from the image than the interpolation reaches
_RAYS, _STEP_PX, _BLUR_PX = 240, 0.5, 0.8  # rays from the middle and steps along them to find the end of the circle


def image_circles(image: Image.Image) -> tuple[Circle, ...]:
    """The circles that lenses light in a decoded image: one, two side by side of equal size, or () in any other."""
    width, height = image.size
    if width == 2 * height and (halves := _circles(image, 2)):
        return halves
    return _circles(image, 1)


def _circles(image: Image.Image, count: int) -> tuple[Circle, ...]:
    side = image.width // count
    halves = [(k * side, 0, (k + 1) * side, image.height) for k in range(count)]
    parts = [image] if count == 1 else [image.crop(half) for half in halves]
    if not all(_dark_corners(part) for part in parts):
        return ()
    found: list[Circle] = []
    scale = min(1.0, _LOOK_PX / max(parts[0].size))
    size = max(1, round(side * scale)), max(1, round(image.height * scale))
    for k, part in enumerate(parts):
        brightest = np.asarray(part.convert("RGB").resize(size, Image.Resampling.BOX)).max(axis=2)
        circle = lit_circle(brightest)
        if circle is None:
            return ()
        x, y, radius = (v * side / size[0] for v in circle)
        found.append((k * side + x, y, radius))
    radii = [radius for _, _, radius in found]
    return tuple(found) if max(radii) - min(radii) <= 0.03 * max(radii) else ()


def _dark_corners(part: Image.Image) -> bool:
    """Whether the corners of a picture are black: of nearly every photograph, they are not."""
    side = max(2, round(0.02 * min(part.size)))  # a circle as wide as the image leaves 0.1
    places = [(x, y) for x in (0, part.width - side) for y in (0, part.height - side)]
    corners = (np.asarray(part.crop((x, y, x + side, y + side)).convert("RGB")) for x, y in places)
    return all(np.median(corner.max(axis=2)) <= _DARK_GREY for corner in corners)


def lit_circle(brightness: np.ndarray) -> Circle | None:
    """The image circle of a lens in an image (h, w) u1 with dark corners, pixels; None if the lit area is no circle.

    Along rays from the middle the last bright pixel is found. Of the circles through three such places, a quarter
    turn apart (images cut their circles at up to four sides), the one with the most places on it is chosen and fitted
    to these again: a dark tree ends before its lens does, and a flare beyond.
    """
    height, width = brightness.shape
    ends = _ends(cv2.GaussianBlur(brightness.astype(np.float32), (0, 0), _BLUR_PX))
    inside = np.all((ends > _PLAY_PX) & (ends < (width - _PLAY_PX, height - _PLAY_PX)), axis=1)
    on = np.zeros(len(ends), bool)
    for k in range(_RAYS):
        three = (k + np.arange(3) * (_RAYS // 4)) % _RAYS
        if inside[three].all():
            x, y, radius = _fit(ends[three])
            off = np.abs(np.hypot(ends[:, 0] - x, ends[:, 1] - y) - radius)
            close = inside & (off <= max(_PLAY_PX, 0.01 * radius))  # the rim of a lens is no exact circle
            on = close if close.sum() > on.sum() else on
    # The image may cut it on two or four sides, and dark scenes end early
    if on.sum() < 0.4 * _RAYS:
        return None
    x, y, radius = _fit(ends[on])
    shorter = min(height, width)
    central = np.hypot(x - width / 2, y - height / 2) <= 0.1 * shorter
    # A smaller circle is a spot of light in a dark picture
    return (x, y, radius) if central and radius >= 0.3 * shorter else None


def _ends(brightness: np.ndarray) -> np.ndarray:
    """(K, 2) the outermost bright place on each ray from the middle; the middle if a ray is all dark."""
    height, width = brightness.shape
    angle = np.arange(_RAYS) * 2 * np.pi / _RAYS
    reach = np.arange(0.0, np.hypot(height, width) / 2, _STEP_PX)
    x = width / 2 + np.outer(np.cos(angle), reach)
    y = height / 2 + np.outer(np.sin(angle), reach)
    seen = cv2.remap(brightness, (x - 0.5).astype(np.float32), (y - 0.5).astype(np.float32), cv2.INTER_LINEAR)
    inside = (x > 0) & (x < width) & (y > 0) & (y < height)
    lit = (seen > _DARK_GREY) & inside
    last = np.where(lit.any(axis=1), lit.shape[1] - 1 - lit[:, ::-1].argmax(axis=1), 0)
    rows = np.arange(_RAYS)
    return np.stack([x[rows, last], y[rows, last]], axis=1)


def _fit(points: np.ndarray) -> Circle:
    """Circle of least squares on points (K, 2): x2 + y2 = 2 a x + 2 b y + c (Kasa 1976)."""
    system = np.column_stack([2 * points, np.ones(len(points))])
    a, b, c = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    return float(a), float(b), float(np.sqrt(max(c + a * a + b * b, 0.0)))


def is_fisheye(camera: pycolmap.Camera | None) -> bool:
    """Whether a camera has a fisheye model, which may see the half space before it."""
    return camera is not None and "FISHEYE" in camera.model.name


def seen_half_deg(camera: pycolmap.Camera) -> float:
    """Largest field angle off the axis of a camera, degrees, at most 90: along the sides of its image."""
    angle = np.linspace(0, _grows_until(camera), 181)[:-1]
    seen = 0.0
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        rays = np.column_stack([x * np.sin(angle), y * np.sin(angle), np.cos(angle)])
        at = np.asarray(camera.img_from_cam(rays), float)
        inside = (at > 0).all(axis=1) & (at < (camera.width, camera.height)).all(axis=1)
        seen = max(seen, float(angle[inside].max(initial=0.0)))
    return float(np.degrees(seen))


def render_lens_view(pixels: np.ndarray, view: LensView, camera: pycolmap.Camera) -> np.ndarray:
    """Pixels (H, W[, 3]) of the pinhole ``camera`` for a view of a fisheye image (h, w[, 3]); black beyond it."""
    x, y = _lens_map(frozen(view.lens), view.rotation, frozen(camera))
    return cv2.remap(pixels, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)


def lit(sensor: Sensor, half_deg: float) -> np.ndarray | None:
    """(H, W) bool: the lit part of a sensor's images, and, for a whole fisheye image, the part less than ``half_deg``
    off its axis; None if that is all."""
    source, camera = sensor.source, sensor.camera
    if source is None or camera is None or (source.view is None and source.circle_px is None):
        return None
    if source.view is not None:
        lens = source.view.lens
        x, y = (m + 0.5 for m in _lens_map(frozen(lens), source.view.rotation, frozen(camera)))
        seen = (x > 0) & (x < lens.width) & (y > 0) & (y < lens.height)
    else:
        x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        seen = _within(camera, half_deg)
    if source.circle_px is not None:
        at_x, at_y, radius = source.circle_px
        seen &= (x - at_x) ** 2 + (y - at_y) ** 2 <= radius * radius
    return None if seen.all() else seen


def _within(camera: pycolmap.Camera, half_deg: float) -> np.ndarray:
    """(H, W) bool: pixels less than an angle off the axis of a fisheye camera, by the rim of that cone in its image."""
    around = np.linspace(0, 2 * np.pi, _RIM, endpoint=False)
    off = np.sin(np.radians(half_deg))
    cone = np.column_stack([off * np.cos(around), off * np.sin(around), np.full(_RIM, np.cos(np.radians(half_deg)))])
    rim = np.asarray(camera.img_from_cam(cone), float)
    seen = np.zeros((camera.height, camera.width), np.uint8)
    if not is_fisheye(camera) or not np.isfinite(rim).all():
        return seen == 0
    cv2.fillPoly(seen, [np.round(rim - 0.5).astype(np.int32)], 1)
    return seen > 0


def frozen(camera: pycolmap.Camera) -> tuple:
    """A camera as the key of a cache."""
    return camera.model.name, camera.width, camera.height, tuple(camera.params)


@lru_cache(maxsize=2)
def _lens_map(lens: tuple, rotation: tuple[float, ...], pinhole: tuple) -> tuple[np.ndarray, np.ndarray]:
    """x, y (H, W) f4 of a view's pixels in the fisheye image in OpenCV's convention; _NOWHERE outside the lens' view.

    Of every ``_STEP``-th pixel, with linear interpolation between, whose error is 2 / focal length of a pixel: large
    views would take seconds each and a gigabyte to keep.
    """
    model, columns, rows, params = pinhole
    view = pycolmap.Camera(model=model, width=columns, height=rows, params=params)
    fx, fy, cx, cy = view.calibration_matrix()[[0, 1, 0, 1], [0, 1, 2, 2]]
    across, down = (_STEP * (np.arange(-1, -(-n // _STEP) + 1) + 0.5) for n in (columns, rows))
    plane = np.stack(np.meshgrid((across - cx) / fx, (down - cy) / fy), axis=-1)
    camera = pycolmap.Camera(model=lens[0], width=lens[1], height=lens[2], params=lens[3])
    rays = unit_rays(plane.reshape(-1, 2)) @ np.reshape(rotation, (3, 3))
    rays[rays[:, 2] < np.cos(_grows_until(camera))] = np.nan
    found = np.asarray(camera.img_from_cam(rays), np.float32).reshape(*plane.shape) - 0.5
    size = plane.shape[1] * _STEP, plane.shape[0] * _STEP
    maps = cv2.resize(found, size, interpolation=cv2.INTER_LINEAR)[_STEP : _STEP + rows, _STEP : _STEP + columns]
    maps = np.where(np.isfinite(maps), maps, _NOWHERE).astype(np.float32)
    return np.ascontiguousarray(maps[..., 0]), np.ascontiguousarray(maps[..., 1])


def _grows_until(camera: pycolmap.Camera) -> float:
    """The angle off the axis, radians, up to which a fisheye camera's image grows: beyond it, its polynomial folds."""
    angle = np.linspace(0, np.pi / 2, 181)[:-1]  # at 90 degrees and beyond COLMAP gives no pixel
    rays = np.column_stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)])
    x = np.asarray(camera.img_from_cam(rays), float)[:, 0]
    falls = np.flatnonzero(~(np.diff(x) > 0))
    return float(angle[falls[0]]) if len(falls) else float(np.pi / 2)


_EQUIRECTANGULAR = "equirectangular"
_TAGS = ("FullPanoWidthPixels", "FullPanoHeightPixels", "CroppedAreaImageWidthPixels", "CroppedAreaImageHeightPixels",
         "CroppedAreaLeftPixels", "CroppedAreaTopPixels")  # fmt: skip
_ROUNDED_PX = 2  # tolerance between sizes in tags
# Software fills missing parts with black, with JPEG's noise, in all pixels of a row but this share.
_BLACK_GREY, _LIT = 24, 0.01
MIN_WIDTH_PX = 1024  # smaller panoramas have views of less than 290 px
_POLE_GREY = 6.0  # largest variation of a row that is one point of the sphere (JPEG noise); the image has more
_WIDTH_PX, _BESIDE = 512, 9  # width at which poles and seam are looked at, columns beside the seam that tell its steps


Box = tuple[int, int, int, int]
"""Of a file's pixels: left, top, right, bottom."""


@dataclass(frozen=True)
class Sphere:
    """The part of a sphere in a file: the sphere is ``width`` pixels around and half as high; the first column and
    row of the file there, and the part of the file that is a picture. ``sure``: by the file's
    tags; else it is only twice as wide as high."""

    width: int
    left: int
    top: int
    sure: bool
    lit: Box = (0, 0, 0, 0)

    def holds(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether places on the whole sphere, from the centre of its first pixel, are in the picture."""
        left, top, right, bottom = self.lit
        column, row = (np.floor(x + 0.5) - self.left) % self.width, np.floor(y + 0.5) - self.top
        return (column >= left) & (column < right) & (row >= top) & (row < bottom)

    @property
    def part(self) -> bool:
        """Whether part of the sphere is not in the picture."""
        left, top, right, bottom = self.lit
        return right - left < self.width or bottom - top < self.width // 2

    def unfolded(self, pixels: np.ndarray) -> np.ndarray:
        """The whole sphere (width / 2, width[, 3 | 4]) u1 of a file's pixels; of a partial one RGBA, the missing part
        with the nearest pixels and alpha 0."""
        if not self.part:
            return pixels
        if pixels.ndim == 2:
            pixels = np.stack([pixels] * 3, axis=2)
        left, top, right, bottom = self.lit
        rows = np.arange(self.width // 2)
        across = (np.arange(self.width) - self.left) % self.width
        nearest = np.where(across > (left + right + self.width) / 2, left, np.clip(across, left, right - 1))
        filled = pixels[np.clip(rows - self.top, top, bottom - 1)][:, nearest]
        alpha = np.where(self.holds(np.arange(self.width), rows[:, None]), 255, 0).astype(np.uint8)
        return np.dstack([filled[..., :3], np.minimum(alpha, filled[..., 3]) if filled.shape[2] == 4 else alpha])


def sphere_of(image: Image.Image | None, size: tuple[int, int], pixels: Callable[[], np.ndarray]) -> Sphere | None:
    """The part of the sphere of a file, its header, its width and height and its pixels (H, W[, C]) u1: by its tags,
    else all around if it is twice as wide as high; None if neither. Black from a pole or the seam on is no picture."""
    width, height = size
    text = "" if image is None else xmp_text(image)
    found = _by_tags(text, width, height)
    if found is None and width == 2 * height:
        found = Sphere(width=width, left=0, top=0, sure=_EQUIRECTANGULAR in text and not has_crop(text))
    return found and replace(found, lit=_lit(pixels()))


def has_crop(xmp: str) -> bool:
    """Whether tags give the part of a sphere."""
    return _TAGS[0] in xmp


def _by_tags(text: str, width: int, height: int) -> Sphere | None:
    """None without tags, or if they contradict each other or the size of the file."""
    if xmp_value(text, "ProjectionType", "GPano") != _EQUIRECTANGULAR:
        return None
    full_width, full_height, wide, high, left, top = (number(xmp_value(text, tag, "GPano")) for tag in _TAGS)
    scale = width / wide if wide > 0 else float("nan")  # of a file that was made smaller since
    fits = abs(full_width - 2 * full_height) <= _ROUNDED_PX and abs(scale * high - height) <= _ROUNDED_PX
    inside = wide <= full_width + _ROUNDED_PX and 0 <= top <= full_height - high + _ROUNDED_PX
    if not (fits and inside and np.isfinite(left)):
        return None
    around = 2 * round(scale * full_width / 2)
    return Sphere(width=around, left=round(scale * left) % around, top=round(scale * top), sure=True)


def _lit(pixels: np.ndarray) -> Box:
    bright = (pixels[..., :3].max(axis=2) if pixels.ndim == 3 else pixels) > _BLACK_GREY
    columns, rows = (np.flatnonzero(bright.mean(axis=axis) > _LIT) for axis in (0, 1))
    if not (len(columns) and len(rows)):
        return 0, 0, pixels.shape[1], pixels.shape[0]
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def is_equirectangular(image: Image.Image) -> bool:
    """Whether a decoded image of 8 bits is a full panorama, by its poles and its seam.

    The first and the last row of an equirectangular panorama are one point each, and its left border continues at the
    right one.
    """
    if image.width != 2 * image.height or image.width < MIN_WIDTH_PX:
        return False
    size = _WIDTH_PX, _WIDTH_PX // 2
    grey = np.asarray(image.convert("L").resize(size, Image.Resampling.BOX), float)
    poles = max(grey[0].std(), grey[-1].std())
    borders = grey[:, :_BESIDE], grey[:, -_BESIDE:]
    beside = np.abs(np.diff(borders[0], axis=1)).mean() + np.abs(np.diff(borders[1], axis=1)).mean()
    seam = np.abs(grey[:, 0] - grey[:, -1]).mean()
    step = max(beside / 2, 0.5)  # a clear sky has none
    return bool(poles < _POLE_GREY and grey.std() > _POLE_GREY and seam < 3 * step)


def render_view(panorama: np.ndarray, camera: pycolmap.Camera, view_from_panorama: np.ndarray) -> np.ndarray:
    """Pixels (H, W[, 3 | 4]) of a pinhole view of a panorama (h, 2 h[, 3 | 4]), rotated by (3, 3). Alpha is 0
    wherever a transparent pixel contributes.

    The middle of the panorama is straight ahead (z), its upper border the zenith (-y).
    """
    x, y = _map(frozen(camera), tuple(np.ravel(view_from_panorama)), panorama.shape[1], panorama.shape[0])
    out = cv2.remap(panorama, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)
    if out.shape[2:] == (4,):
        out[..., 3] = np.where(out[..., 3] == 255, 255, 0)
    return out


def seen(sphere: Sphere, camera: pycolmap.Camera, view_from_panorama: np.ndarray) -> float:
    """Share of a view within a picture, by 65 x 65 of its pixels."""
    small = pycolmap.Camera(camera.todict())
    small.rescale(65, 65)  # a degree and a half
    places = _map(frozen(small), tuple(np.ravel(view_from_panorama)), sphere.width, sphere.width // 2)
    return float(sphere.holds(*places).mean())


@lru_cache(maxsize=6)  # the views of one panorama are made one after another
def _map(pinhole: tuple, rotation: tuple[float, ...], width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """x, y (H, W) f4 of a view's pixels in a panorama of a size, in OpenCV's convention."""
    model, columns, rows, params = pinhole
    view = pycolmap.Camera(model=model, width=columns, height=rows, params=params)
    fx, fy, cx, cy = view.calibration_matrix()[[0, 1, 0, 1], [0, 1, 2, 2]]
    u = (np.arange(columns) + 0.5 - cx) / fx
    v = (np.arange(rows) + 0.5 - cy) / fy
    rays = np.stack([*np.meshgrid(u, v), np.ones((rows, columns))], axis=-1) @ np.reshape(rotation, (3, 3))
    longitude = np.arctan2(rays[..., 0], rays[..., 2])
    latitude = np.arctan2(-rays[..., 1], np.hypot(rays[..., 0], rays[..., 2]))
    x = (longitude / (2 * np.pi) + 0.5) * width - 0.5  # OpenCV counts from the centre of the first pixel
    y = (0.5 - latitude / np.pi) * height - 0.5
    return x.astype(np.float32), y.astype(np.float32)
