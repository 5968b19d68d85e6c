"""Back-projection error of papers 000 and 001: a round trip through the images, named for what it is."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.scene.results import Cloud, DepthMap, Metric

MEANING = (
    "Back-projection error (paper 000, eq. 4-6): each point of the dense cloud is projected into the images, its "
    "position is rounded to the pixel, and the pixel is sent back into space with the depth of the same point. "
    "What is left is the rounding to whole pixels, about depth x 0.41 pixel / focal length. It is given because the "
    "papers give it. It says nothing about errors of the poses, drift, ghosts or completeness."
)
_ROUNDING_PX = (2 / 12) ** 0.5  # standard deviation of a uniform rounding to whole pixels in u and v together


@dataclass(frozen=True)
class View:
    """A pinhole image: K (3, 3), cam_from_world (4, 4), size in pixels."""

    name: str
    K: np.ndarray
    cam_from_world: np.ndarray
    width: int
    height: int

    @staticmethod
    def of(depth: DepthMap) -> "View":
        """The image of a depth map."""
        height, width = depth.depth_m.shape
        return View(name=depth.image, K=depth.K, cam_from_world=depth.cam_from_world, width=width, height=height)


@dataclass(frozen=True)
class Backprojection:
    """Result over all images: rmse_m (eq. 6), points N counted over all images, the error that rounding alone predicts,
    and (image, points, rmse_m) per image."""

    rmse_m: float
    points: int
    rounding_m: float
    images: tuple[tuple[str, int, float], ...]

    def metrics(self) -> list[Metric]:
        """The figures of merit."""
        return [
            Metric(name="backprojection_rmse", value=self.rmse_m, unit="m", better="low"),
            Metric(name="backprojection_rounding", value=self.rounding_m, unit="m", better="low"),
        ]


def project(points_cam: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of camera points (N, 3): p = K X_c in homogeneous coordinates (paper 000, eq. 4-5)."""
    p = points_cam @ np.asarray(K, float).T
    return p[:, :2] / p[:, 2:]


def backproject(pixels: np.ndarray, depth: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Camera points (N, 3) of pixels (N, 2) at known depth z_c (N,): X_c = z_c K^-1 [u v 1]^T (eq. 5 solved)."""
    homogeneous = np.column_stack([pixels, np.ones(len(pixels))])
    return depth[:, None] * (homogeneous @ np.linalg.inv(K).T)


def round_trip(points: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Differences X_true - R^T (X_est - t) (M, 3) and depths (M,) of the points (N, 3) that an image shows.

    A point counts when it lies in front of the camera and inside the frame. Occlusion is not looked at, as in the
    paper.
    """
    x_cam = transforms.apply(view.cam_from_world, points)
    front = np.flatnonzero(x_cam[:, 2] > 1e-6)
    uv = project(x_cam[front], view.K)
    inside = np.all((uv >= 0) & (uv < [view.width, view.height]), axis=1)
    seen, uv = front[inside], uv[inside]
    # pixel (0, 0) is a corner: the pixel a point falls into is floor(u), its centre floor(u) + 0.5
    x_est = backproject(np.floor(uv) + 0.5, x_cam[seen, 2], view.K)
    world_from_cam = transforms.invert(view.cam_from_world)  # R^T (X - t)
    return points[seen] - transforms.apply(world_from_cam, x_est), x_cam[seen, 2]


def backprojection_rmse(
    points: np.ndarray | Cloud, views: Iterable[View | DepthMap], points_tried: int
) -> Backprojection:
    """Back-projection RMSE of a cloud (N, 3) over images (paper 000, eq. 6): sqrt(1/N sum |X_true - R^T(X_est - t)|^2).

    See MEANING. N counts every point once for each image that shows it; of a large cloud every n-th point is tried in
    an image, about ``points_tried``, other ones in the next. NaN when no image shows a point.
    """
    xyz = np.asarray(points.xyz_m if isinstance(points, Cloud) else points, float).reshape(-1, 3)
    rows: list[tuple[str, int, float]] = []
    squares = rounding = 0.0
    count = 0
    step = max(1, len(xyz) // points_tried)
    for turn, item in enumerate(views):
        view = View.of(item) if isinstance(item, DepthMap) else item
        difference, z = round_trip(xyz[turn % step :: step], view)
        if not len(z):
            rows.append((view.name, 0, float("nan")))
            continue
        square = float(np.sum(difference**2))
        focal = float(np.sqrt(view.K[0, 0] * view.K[1, 1]))
        squares, count = squares + square, count + len(z)
        rounding += float(z @ z) * (_ROUNDING_PX / focal) ** 2
        rows.append((view.name, len(z), float(np.sqrt(square / len(z)))))
    if not count:
        return Backprojection(rmse_m=float("nan"), points=0, rounding_m=float("nan"), images=tuple(rows))
    rmse, expected = (float(np.sqrt(s / count)) for s in (squares, rounding))
    return Backprojection(rmse_m=rmse, points=count, rounding_m=expected, images=tuple(rows))
