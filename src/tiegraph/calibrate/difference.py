"""Two calibrations of the same cameras side by side: by a board and by a survey, or of two days."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.scene.rig import pixel_rays

_GRID = 21  # rays along each side of an image


@dataclass(frozen=True)
class Calibration:
    """One camera: COLMAP's, sensor_from_rig (4, 4), None = unknown; sigmas of the focal length (px), of each axis of
    the turn (degrees) and each coordinate of the place (m), None = not said."""

    name: str
    camera: pycolmap.Camera | None
    sensor_from_rig: np.ndarray | None = None
    focal_sigma_px: float | None = None
    sigma_deg: float | None = None
    sigma_m: float | None = None


@dataclass(frozen=True)
class Difference:
    """How a camera differs in two calibrations; NaN = cannot be told.

    ``focal``: second over first minus 1. ``lens_px``: RMS distance between the images of the same ray over the image of
    the first, after the turn that makes it least: what turning cannot undo. ``turn_deg``, ``place_m``: of its mounting
    against the first camera that both have. The three ``_sigmas``: differences in standard deviations of both.
    """

    name: str
    focal: float
    lens_px: float
    turn_deg: float
    place_m: float
    focal_sigmas: float
    turn_sigmas: float
    place_sigmas: float

    def worst_sigmas(self) -> float:
        """The largest of what can be told; NaN = nothing."""
        told = [s for s in (self.focal_sigmas, self.turn_sigmas, self.place_sigmas) if np.isfinite(s)]
        return max(told, default=float("nan"))


def differences(first: Sequence[Calibration], second: Sequence[Calibration]) -> tuple[Difference, ...]:
    """Of the cameras that both have, by name, in the order of the first. Raises InputError if there is none, or if a
    camera has images of another shape."""
    of = {c.name: c for c in second}
    both = [(a, of[a.name]) for a in first if a.name in of]
    if len(first) == len(second) == 1:
        both = [(first[0], second[0])]
    if not both:
        names = (", ".join(c.name for c in cameras) for cameras in (first, second))
        raise InputError("no camera is in both calibrations: {} and {}: give them the same names".format(*names))
    return tuple(_difference(a, b, both[0]) for a, b in both)


def _difference(a: Calibration, b: Calibration, base: tuple[Calibration, Calibration]) -> Difference:
    nan = float("nan")
    focal = lens = focal_sigmas = turn = place = turn_sigmas = place_sigmas = nan
    if a.camera is not None and b.camera is not None:
        like, other = a.camera, copy.copy(b.camera)
        if abs(other.width * like.height - other.height * like.width) > max(like.width, like.height):
            raise InputError(
                f"{a.name}: one calibration is of {like.width} x {like.height} pixels, the other of {other.width} x "
                f"{other.height}, another shape: they are not of the same images"
            )
        if other.width != like.width:
            other.rescale(like.width, like.height)
        focal = other.mean_focal_length() / a.camera.mean_focal_length() - 1
        lens = _lens_px(a.camera, other)
        sigma = _both(a.focal_sigma_px, b.focal_sigma_px)
        focal_sigmas = abs(focal) * a.camera.mean_focal_length() / sigma if sigma else nan
    one, two = _from_first(a, base[0]), _from_first(b, base[1])
    if a.name != base[0].name and one is not None and two is not None:
        turn = float(transforms.angle_deg(one[:3, :3], two[:3, :3]))
        place = float(np.linalg.norm(transforms.centre(one) - transforms.centre(two)))
        turns, places = _both(a.sigma_deg, b.sigma_deg), _both(a.sigma_m, b.sigma_m)
        turn_sigmas = turn / (np.sqrt(3) * turns) if turns else nan
        place_sigmas = place / (np.sqrt(3) * places) if places else nan
    return Difference(
        name=a.name,
        focal=focal,
        lens_px=lens,
        turn_deg=turn,
        place_m=place,
        focal_sigmas=focal_sigmas,
        turn_sigmas=turn_sigmas,
        place_sigmas=place_sigmas,
    )


def _from_first(camera: Calibration, first: Calibration) -> np.ndarray | None:
    if camera.sensor_from_rig is None or first.sensor_from_rig is None:
        return None
    return np.asarray(camera.sensor_from_rig @ transforms.invert(first.sensor_from_rig))


def _both(a: float | None, b: float | None) -> float:
    return float(np.hypot(a or 0.0, b or 0.0))


def _lens_px(a: pycolmap.Camera, b: pycolmap.Camera) -> float:
    x, y = ((np.arange(_GRID) + 0.5) / _GRID * side for side in (a.width, a.height))
    grid = np.array([[u, v] for u in x for v in y])
    rays = [pixel_rays(camera, grid) for camera in (a, b)]
    known = np.isfinite(rays[0]).all(axis=1) & np.isfinite(rays[1]).all(axis=1)
    rays = [r[known] / np.linalg.norm(r[known], axis=1, keepdims=True) for r in rays]
    u, _, vt = np.linalg.svd(rays[0].T @ rays[1])
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt  # takes rays of b to those of a
    seen = np.asarray(a.img_from_cam(rays[1] @ turn.T), float)
    off = np.linalg.norm(seen - grid[known], axis=1)
    return float(np.sqrt(np.nanmean(off**2)))
