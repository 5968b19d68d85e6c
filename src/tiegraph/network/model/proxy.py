"""Points that stand for the surveyed surface: of a model, of a scan, or at an assumed range from poses alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.network.model.view import View

FAR_OBSERVERS = 2.0  # a point is not seen from further than this times its farthest observer
MIN_TRACK = 3  # observers a point needs, where enough points have so many
ASSUMED_GRID = (6, 5)  # rays across and down an image for a proxy at an assumed range
ASSUMED_RANGES = (0.25, 0.5, 1.0, 2.0)  # of the assumed range
ASSUMED_REACH = 3.0  # ranges from which such a point is still seen


@dataclass(frozen=True)
class Proxy:
    """P points that stand for the surface, with what is known of their observers.

    ``reach``: distance from which a point is still seen, inf = any; ``towards``: mean unit vector to its observers,
    zero = not known; ``image``/``point`` (O,): observations. ``assumed``: the points are not measured, each stands for
    the one image that observes it: they hide nothing, and an image votes with its own points only.
    """

    points: np.ndarray  # (P, 3)
    reach: np.ndarray  # (P,)
    towards: np.ndarray  # (P, 3)
    image: np.ndarray  # (O,)
    point: np.ndarray  # (O,)
    assumed: bool = False

    def __len__(self) -> int:
        return len(self.points)

    def keep(self, mask: np.ndarray) -> Proxy:
        """Only the points of a mask (P,)."""
        number = np.cumsum(mask) - 1
        seen = mask[self.point]
        return Proxy(
            self.points[mask],
            self.reach[mask],
            self.towards[mask],
            self.image[seen],
            number[self.point[seen]],
            self.assumed,
        )


def observed_proxy(points: np.ndarray, image: np.ndarray, point: np.ndarray, cam_from_world: np.ndarray) -> Proxy:
    """Proxy of model points (P, 3) and their observations: ``image`` (O,) sees ``point`` (O,).

    Points with fewer than MIN_TRACK observers are left out, unless that would take more than half of them.
    """
    centre = transforms.centre(cam_from_world)
    known = np.isfinite(centre[image]).all(axis=1)
    image, point = np.asarray(image)[known], np.asarray(point)[known]
    ray = centre[image] - points[point]
    distance = np.maximum(np.linalg.norm(ray, axis=1), 1e-12)
    towards = np.zeros((len(points), 3))
    np.add.at(towards, point, ray / distance[:, None])
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    reach = np.zeros(len(points))
    np.maximum.at(reach, point, FAR_OBSERVERS * distance)
    track = np.bincount(point, minlength=len(points))
    proxy = Proxy(points, np.where(track > 0, reach, np.inf), towards, image, point)
    good = track >= MIN_TRACK
    return proxy.keep(good) if good.sum() >= 0.5 * len(points) else proxy


def points_proxy(points: np.ndarray) -> Proxy:
    """Proxy of bare points (P, 3), such as a laser scan, of which no observer is known."""
    none = np.zeros(0, int)
    return Proxy(points, np.full(len(points), np.inf), np.zeros((len(points), 3)), none, none)


def assumed_proxy(
    cam_from_world: np.ndarray, cameras: Sequence[pycolmap.Camera | None], range_m: float | np.ndarray
) -> Proxy:
    """Proxy from poses alone (paper 003): points on a grid of rays of every image, about an assumed range.

    ``range_m`` one for all or (N,), in the unit of the poses.
    """
    known = np.flatnonzero(np.isfinite(cam_from_world[:, :3]).all(axis=(1, 2)))
    ranges = np.broadcast_to(np.asarray(range_m, float), (len(cam_from_world),))
    rays = {key: _grid_rays(c) for key, c in {id(c): c for c in cameras}.items()}
    steps = np.array(ASSUMED_RANGES)
    points, towards, reach, image = [], [], [], []
    for k in known:
        world = rays[id(cameras[int(k)])] @ cam_from_world[k, :3, :3]
        centre = transforms.centre(cam_from_world[k])
        points.append((centre + world[None] * (steps * ranges[k])[:, None, None]).reshape(-1, 3))
        towards.append(np.tile(-world, (len(steps), 1)))
        reach.append(np.full(len(world) * len(steps), ASSUMED_REACH * ranges[k]))
        image.append(np.full(len(world) * len(steps), k))
    if not points:
        return Proxy(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), np.zeros(0, int), np.zeros(0, int), True)
    count = len(points) * len(points[0])
    return Proxy(
        np.concatenate(points),
        np.concatenate(reach),
        np.concatenate(towards),
        np.concatenate(image),
        np.arange(count),
        True,
    )


def _grid_rays(camera: pycolmap.Camera | None) -> np.ndarray:
    """(G, 3) unit rays through the centres of a grid of the image; not those the camera model cannot invert."""
    u, v = (np.arange(n) + 0.5 for n in ASSUMED_GRID)
    grid = np.stack(np.meshgrid(u / ASSUMED_GRID[0], v / ASSUMED_GRID[1]), axis=-1).reshape(-1, 2)
    rays = View.of(camera).rays(grid)
    return rays[np.isfinite(rays).all(axis=1)]
