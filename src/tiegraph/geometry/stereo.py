"""Rectification of any two posed pinhole images, and the relation of disparity and depth. Arrays only.

The rectified x axis is the baseline itself, from the reference to the partner, so a vertical, diagonal or reversed
baseline needs no case of its own: both rectified images are merely rolled, and disparities never change sign. Pixel
coordinates are COLMAP's: (0, 0) is the corner of the top-left pixel.
"""

from dataclasses import dataclass

import numpy as np

from tiegraph.geometry.transforms import centre, transformed

# A ray further than this from the rectified axis is not used: a plane would stretch it more than 1/cos(65)^2 = 5.6
# times. Rays within 25 degrees of the baseline (the surroundings of an epipole inside the image) fall away with it.
MAX_OFF_AXIS_DEG = 65.0
_TANGENT = float(np.tan(np.radians(MAX_OFF_AXIS_DEG)))
_GRID = 33  # samples a side that stand for an image when windows and ranges are sought
_MIN_AXIS_SINE = 0.2  # sine between the mean optical axis and the baseline: below 12 degrees the roll is arbitrary
_RANGE_STEPS = 32  # depths tried between near and far when the part common to both images is sought
_MAX_SHIFT = 0.85  # disparity / focal length: rays that meet at more than 40 degrees show too different a picture


@dataclass(frozen=True, eq=False)
class Pinhole:
    """An undistorted camera: K (3, 3) px, cam_from_world (4, 4), size (width, height) px; name of its image."""

    K: np.ndarray
    cam_from_world: np.ndarray
    size: tuple[int, int]
    name: str = ""

    @property
    def focal(self) -> float:
        """Pixels per unit of tangent."""
        return float(np.sqrt(self.K[0, 0] * self.K[1, 1]))

    def project(self, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixel coordinates (..., 2) of world points (..., 3), and their depths (...); NaN behind the camera."""
        seen = transformed(self.K @ self.cam_from_world[:3], xyz)
        z = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        xy = np.empty((*z.shape, 2))
        for k in (0, 1):
            np.divide(seen[..., k], z, out=xy[..., k])
        return xy, z

    def inside(self, xy: np.ndarray) -> np.ndarray:
        """Whether pixel coordinates (..., 2) lie in the image, NaN never: (...) bool."""
        x, y = np.moveaxis(xy, -1, 0)
        return (x >= 0) & (y >= 0) & (x <= self.size[0]) & (y <= self.size[1])


@dataclass(frozen=True, eq=False)
class Rectification:
    """Two rectified images in which a point lies on the same row, disparity d = x_reference - x_partner >= 0.

    rect_from_reference, rect_from_partner (3, 3): homographies between pixel coordinates, scaled so that the third
    coordinate of a pixel in front is positive. size (width, height) of the reference window; the partner's window
    continues ``disparities`` px to the left of it. Inverse depth along the reference's own axis at its pixel (u, v) is
    ``inverse_depth_per_px(u, v) * (d + offset)``.
    """

    rect_from_reference: np.ndarray
    rect_from_partner: np.ndarray
    size: tuple[int, int]
    disparities: int
    offset: float
    focal: float
    baseline: float
    axis: np.ndarray  # (3,) so that axis @ (u, v, 1) = rectified depth / depth of a reference pixel
    pixel_scale: np.ndarray  # (2,) fx, fy of the reference

    def depth_ratio(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Depth along the rectified axis per depth along the reference's axis, at reference pixels (u, v)."""
        return self.axis[0] * u + self.axis[1] * v + self.axis[2]

    def inverse_depth_per_px(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Inverse depth of one pixel of disparity at reference pixels (u, v); the unit of the pair's precision."""
        return self.depth_ratio(u, v) / (self.focal * self.baseline)

    def stretch(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Rectified pixels per reference pixel (square root of the area scale) at reference pixels (u, v)."""
        ratio = np.maximum(self.depth_ratio(u, v), _MIN_AXIS_SINE)
        return self.focal / np.sqrt(self.pixel_scale[0] * self.pixel_scale[1] * ratio**3)


def rectifying_rotation(reference_from_world: np.ndarray, partner_from_world: np.ndarray) -> tuple | None:
    """(rect_from_reference (3, 3), rect_from_partner (3, 3), baseline) of two poses (4, 4).

    x = baseline, z = mean of the two optical axes made perpendicular to it (Fusiello, Trucco & Verri 2000, with the
    mean axis in place of the reference's, which shares the distortion between the two). None where that is undefined:
    no baseline, or both axes along it.
    """
    step = centre(partner_from_world) - centre(reference_from_world)
    baseline = float(np.linalg.norm(step))
    if not 0 < baseline < np.inf:  # NaN too
        return None
    x = step / baseline
    forward = reference_from_world[2, :3] + partner_from_world[2, :3]
    z = forward - (forward @ x) * x
    length = np.linalg.norm(z)
    if length / 2 < _MIN_AXIS_SINE:
        return None
    z = z / length
    rect_from_world = np.stack([x, np.cross(z, x), z])
    return rect_from_world @ reference_from_world[:3, :3].T, rect_from_world @ partner_from_world[:3, :3].T, baseline


def usable_rays(rays: np.ndarray) -> np.ndarray:
    """Which rays (..., 3) of a rectified frame lie in front and within MAX_OFF_AXIS_DEG on both axes: (...) bool."""
    z = rays[..., 2]
    return (z > 0) & (np.abs(rays[..., 0]) < _TANGENT * z) & (np.abs(rays[..., 1]) < _TANGENT * z)


def rectify(
    reference: Pinhole,
    partner: Pinhole,
    depth_range: tuple[float, float],
    max_pixels: float,
    max_disparities: int,
) -> Rectification | None:
    """Rectify a pair for the reference's depths (near, far); None where the images share no usable part.

    The window is the part of the reference that the partner can see within the depth range; its scale keeps the
    reference's resolution at the median pixel, unless ``max_pixels`` or ``max_disparities`` make it coarser.
    """
    rotations = rectifying_rotation(reference.cam_from_world, partner.cam_from_world)
    if rotations is None:
        return None
    from_reference, from_partner, baseline = rotations
    seen = _common(_grid_rays(reference, from_reference), _grid_rays(partner, from_partner), baseline, depth_range)
    if seen is None:
        return None
    low, high, shift = seen.low, seen.high, seen.shift
    focal = float(np.sqrt(reference.K[0, 0] * reference.K[1, 1] * np.median(seen.ratio**3)))
    focal = min(focal, float(np.sqrt(max_pixels / max(np.prod(high - low), 1e-12))))
    focal = min(focal, (max_disparities - 3) / max(shift[1] - shift[0], 1e-12))
    size = np.ceil(focal * (high - low)).astype(int)
    if size.min() < 16:
        return None
    offset = focal * shift[0] - 1.0
    to_pixel = np.array([[focal, 0, -focal * low[0]], [0, focal, -focal * low[1]], [0, 0, 1.0]])
    to_pixel_partner = to_pixel + np.array([[0, 0, offset], [0, 0, 0], [0, 0, 0]])
    return Rectification(
        rect_from_reference=to_pixel @ from_reference @ np.linalg.inv(reference.K),
        rect_from_partner=to_pixel_partner @ from_partner @ np.linalg.inv(partner.K),
        size=(int(size[0]), int(size[1])),
        disparities=int(np.ceil(focal * (shift[1] - shift[0]) + 2.0)),
        offset=float(offset),
        focal=focal,
        baseline=baseline,
        axis=(from_reference @ np.linalg.inv(reference.K))[2],
        pixel_scale=np.array([reference.K[0, 0], reference.K[1, 1]]),
    )


def _grid_rays(camera: Pinhole, rect_from_cam: np.ndarray) -> np.ndarray:
    """Rays (n, 3) of a grid of pixels, borders included, in the rectified frame; only usable ones."""
    u, v = np.meshgrid(np.linspace(0, camera.size[0], _GRID), np.linspace(0, camera.size[1], _GRID))
    pixels = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1)
    rays = pixels @ (rect_from_cam @ np.linalg.inv(camera.K)).T
    return rays[usable_rays(rays)]


@dataclass(frozen=True)
class _Common:
    """The part of the reference's grid rays that the partner can see: its corners (2,) on the plane z = 1, the depth
    ratios (n,), and the extremes of the disparity in units of the focal length."""

    low: np.ndarray
    high: np.ndarray
    ratio: np.ndarray
    shift: tuple[float, float]


def _common(
    rays: np.ndarray, partner_rays: np.ndarray, baseline: float, depth_range: tuple[float, float]
) -> _Common | None:
    """What both images see within the depths; None for next to nothing."""
    if len(rays) == 0 or len(partner_rays) == 0:
        return None
    xy, partner_xy = rays[:, :2] / rays[:, 2:], partner_rays[:, :2] / partner_rays[:, 2:]
    low, high = partner_xy.min(axis=0), partner_xy.max(axis=0)
    inverse = np.linspace(1 / depth_range[1], 1 / depth_range[0], _RANGE_STEPS)
    shift = baseline * inverse / rays[:, 2:]  # (n, steps)
    at = xy[:, :1] - shift
    inside = (at >= low[0]) & (at <= high[0]) & ((xy[:, 1:] >= low[1]) & (xy[:, 1:] <= high[1])) & (shift <= _MAX_SHIFT)
    kept = inside.any(axis=1)
    if np.count_nonzero(kept) < 4:
        return None
    step = shift[:, 1:2] - shift[:, :1]  # what is seen may begin up to a step beyond the depths tried
    least = max(float((shift - step)[inside].min()), float(shift.min()))
    most = min(float((shift + step)[inside].max()), float(shift.max()))
    cell = (xy.max(axis=0) - xy.min(axis=0)) / (_GRID - 1)  # the true border lies within one cell of the kept samples
    low = np.maximum(xy[kept].min(axis=0) - cell, xy.min(axis=0))
    high = np.minimum(xy[kept].max(axis=0) + cell, xy.max(axis=0))
    return _Common(low=low, high=high, ratio=rays[kept, 2], shift=(least, most))
