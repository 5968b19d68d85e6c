"""Points that represent the surveyed surface: of a model, of a scan, or at an assumed range from poses alone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms
from tiegraph.geometry.rays import unit_rays
from tiegraph.network.tuning import CoarseTuning
from tiegraph.scene.rig import on_plane

_LEAF = 64  # points of a box that is tested as a whole


@dataclass(frozen=True)
class View:
    """A camera: projection to image shares 0..1 and the half angle of a cone around it."""

    camera: pycolmap.Camera | None
    half: float  # radians, to the corners
    slope: float  # tangent of half the field of view across and down that is taken where there is no camera

    @staticmethod
    def of(camera: pycolmap.Camera | None, guessed_view_deg: float) -> "View":
        slope = float(np.tan(np.radians(guessed_view_deg / 2)))
        if camera is None:
            return View(None, float(np.arctan(np.sqrt(2) * slope)), slope)
        rim = np.array([(x, y) for x in (0, 0.5, 1) for y in (0, 0.5, 1)])
        rays = View(camera, 0.0, slope).rays(rim)
        half = np.nanmax(np.arccos(np.clip(rays[:, 2], -1, 1)), initial=0.0)
        return View(camera, float(half) if half > 0 else np.radians(89), slope)

    def rays(self, shares: np.ndarray) -> np.ndarray:
        """(K, 3) unit rays of positions given as shares of the image (K, 2); NaN where the camera model has no
        inverse."""
        if self.camera is None:
            xy = (2 * shares - 1) * self.slope
        else:
            xy = on_plane(self.camera, shares * (self.camera.width, self.camera.height))
        return unit_rays(xy)

    def project(self, local: np.ndarray, slack: float = 0.0) -> np.ndarray:
        """(K, 2) shares of the image 0..1, NaN = outside, of points (K, 3) in the camera frame with z > 0.

        Points up to ``slack`` radians outside count as on the border.
        """
        if self.camera is None:
            shares = (local[:, :2] / local[:, 2:] / self.slope + 1) / 2
        else:
            shares = np.asarray(self.camera.img_from_cam(local), float) / (self.camera.width, self.camera.height)
        with np.errstate(invalid="ignore"):
            rim = slack / max(self.half, 1e-3)
            inside = np.all((shares >= -rim) & (shares < 1 + rim), axis=1)
        return np.where(inside[:, None], np.clip(shares, 0, 1 - 1e-9), np.nan)


def views_of(cameras: Sequence[pycolmap.Camera | None], guessed_view_deg: float) -> dict[int, View]:
    """The view of each different camera by its ``id``."""
    return {key: View.of(c, guessed_view_deg) for key, c in {id(c): c for c in cameras}.items()}


@dataclass(frozen=True)
class Proxy:
    """P points that represent the surface, with information on their observers.

    ``reach``: distance up to which a point is seen, inf = any; ``towards``: mean unit vector to its observers, zero =
    unknown; ``image``/``point`` (O,): observations. ``assumed``: the points are not measured, each represents the one
    image that observes it: they occlude nothing, and an image votes with its own points only.
    """

    points: np.ndarray  # (P, 3)
    reach: np.ndarray  # (P,)
    towards: np.ndarray  # (P, 3)
    image: np.ndarray  # (O,)
    point: np.ndarray  # (O,)
    assumed: bool = False

    def __len__(self) -> int:
        return len(self.points)

    def keep(self, mask: np.ndarray) -> "Proxy":
        """Only the points of a mask (P,)."""
        number = np.cumsum(mask) - 1
        seen = mask[self.point]
        return Proxy(
            points=self.points[mask],
            reach=self.reach[mask],
            towards=self.towards[mask],
            image=self.image[seen],
            point=number[self.point[seen]],
            assumed=self.assumed,
        )


def observed_proxy(points: np.ndarray, image: np.ndarray, point: np.ndarray, cam_from_world: np.ndarray) -> Proxy:
    """Proxy of model points (P, 3) and their observations: ``image`` (O,) sees ``point`` (O,)."""
    centre = transforms.centre(cam_from_world)
    known = np.isfinite(centre[image]).all(axis=1)
    image, point = np.asarray(image)[known], np.asarray(point)[known]
    ray = centre[image] - points[point]
    distance = np.maximum(np.linalg.norm(ray, axis=1), 1e-12)
    towards = np.zeros((len(points), 3))
    np.add.at(towards, point, ray / distance[:, None])
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    reach = np.zeros(len(points))
    np.maximum.at(reach, point, 2.0 * distance)  # seen up to twice the distance of its farthest observer
    observers = np.bincount(point, minlength=len(points))
    reach = np.where(observers > 0, reach, np.inf)
    return Proxy(points=points, reach=reach, towards=towards, image=image, point=point)


def assumed_proxy(
    cam_from_world: np.ndarray,
    cameras: Sequence[pycolmap.Camera | None],
    range_m: float | np.ndarray,
    tuning: CoarseTuning,
) -> Proxy:
    """Proxy from poses alone (paper 003): points on a grid of rays of every image, around an assumed range.

    ``range_m``: one for all or (N,), in the unit of the poses.
    """
    known = np.flatnonzero(np.isfinite(cam_from_world[:, :3]).all(axis=(1, 2)))
    ranges = np.broadcast_to(np.asarray(range_m, float), (len(cam_from_world),))
    views = views_of(cameras, tuning.visible.guessed_view_deg)
    rays = {key: _grid_rays(view) for key, view in views.items()}
    steps = np.array((0.25, 0.5, 1.0, 2.0))  # in assumed ranges
    centres = transforms.centre(cam_from_world[known])
    points, towards, count = [np.zeros((0, 3))], [np.zeros((0, 3))], []
    for k, centre in zip(known, centres):
        world = rays[id(cameras[int(k)])] @ cam_from_world[k, :3, :3]
        points.append((centre + world[None] * (steps * ranges[k])[:, None, None]).reshape(-1, 3))
        towards += [-world] * len(steps)
        count.append(len(points[-1]))
    number = np.array(count, int)
    return Proxy(
        points=np.concatenate(points),
        reach=np.repeat(3.0 * ranges[known], number),  # seen up to three ranges away
        towards=np.concatenate(towards),
        image=np.repeat(known, number),
        point=np.arange(number.sum()),
        assumed=True,
    )


def _grid_rays(view: View) -> np.ndarray:
    """(G, 3) unit rays through the centres of 6 x 5 cells of the image, without those that the camera model cannot
    invert."""
    u, v = (np.arange(6) + 0.5) / 6, (np.arange(5) + 0.5) / 5
    rays = view.rays(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    return rays[np.isfinite(rays).all(axis=1)]


class Boxes:
    """The points of a proxy in groups, so that an image tests only those near its field of view."""

    def __init__(self, proxy: Proxy) -> None:
        self.order = np.asarray(cKDTree(proxy.points, leafsize=_LEAF).indices)
        starts = np.arange(0, len(proxy), _LEAF)
        points = proxy.points[self.order]
        low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
        self.middle, self.radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
        self.reach = np.maximum.reduceat(proxy.reach[self.order], starts)

    def near(self, centre: np.ndarray, axis: np.ndarray, half: float) -> np.ndarray:
        """Indices of the points whose group touches a cone of half angle ``half`` and is within reach."""
        way = self.middle - centre
        distance = np.linalg.norm(way, axis=1)
        touches = distance - self.radius < self.reach
        if half < np.pi / 2:
            along = way @ axis
            across = np.sqrt(np.maximum(distance**2 - along**2, 0))
            touches &= across * np.cos(half) - along * np.sin(half) < self.radius
        rows = (np.flatnonzero(touches)[:, None] * _LEAF + np.arange(_LEAF)).ravel()
        return self.order[rows[rows < len(self.order)]]
