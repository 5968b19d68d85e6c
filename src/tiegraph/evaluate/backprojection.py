"""Back-projection error of papers 000 and 001: a round trip through the images, named for what it is."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.results import Metric

MEANING = (
    "Back-projection error (paper 000, eq. 4-6): each point of the dense cloud is projected into the images, its "
    "position is rounded to the pixel, and the pixel is sent back into space with the depth of the same point. "
    "What is left is the rounding to whole pixels, about depth x 0.41 pixel / focal length. It is given because the "
    "papers give it. It says nothing about errors of the poses, drift, ghosts or completeness."
)
_ROUNDING_PX = (2 / 12) ** 0.5  # standard deviation of a uniform rounding to whole pixels in u and v together


@dataclass(frozen=True)
class Backprojection:
    """Over all images: rmse_m (eq. 6), points N counted, the error that rounding alone predicts."""

    rmse_m: float
    points: int
    rounding_m: float

    def metrics(self) -> list[Metric]:
        """The figures of merit."""
        return [
            Metric(name="backprojection_rmse", value=self.rmse_m, unit="m", better="low"),
            Metric(name="backprojection_rounding", value=self.rounding_m, unit="m", better="low"),
        ]


def round_trip(points: np.ndarray, camera: Any, cam_from_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differences X_true - R^T (X_est - t) (M, 3) and depths (M,) of the points (N, 3) that an image shows.

    A point counts when it lies in front of the camera and inside the frame. Occlusion is not looked at, as in the
    paper. ``camera``: pycolmap's, as a pinhole without distortion: the round trip needs only K and the pose; leaving
    the distortion out shifts which points fall into the frame.
    """
    K = camera.calibration_matrix()
    x_cam = transforms.apply(cam_from_world, points)
    front = np.flatnonzero(x_cam[:, 2] > 1e-6)
    uvw = x_cam[front] @ K.T  # p = K X_c in homogeneous coordinates (eq. 4-5)
    uv = uvw[:, :2] / uvw[:, 2:]
    inside = np.all((uv >= 0) & (uv < [camera.width, camera.height]), axis=1)
    seen, uv = front[inside], uv[inside]
    # pixel (0, 0) is a corner: the pixel a point falls into is floor(u), its centre floor(u) + 0.5
    pixel = np.column_stack([np.floor(uv) + 0.5, np.ones(len(uv))])
    x_est = x_cam[seen, 2:] * (pixel @ np.linalg.inv(K).T)  # X_c = z_c K^-1 [u v 1]^T (eq. 5 solved)
    world_from_cam = transforms.invert(cam_from_world)  # R^T (X - t)
    return points[seen] - transforms.apply(world_from_cam, x_est), x_cam[seen, 2]


def backprojection_rmse(points: np.ndarray, model: Any, points_tried: int) -> Backprojection:
    """Back-projection RMSE of a cloud (N, 3) over the images with a pose of a ``pycolmap.Reconstruction`` (paper 000,
    eq. 6): sqrt(1/N sum |X_true - R^T(X_est - t)|^2).

    See MEANING. N counts every point once for each image that shows it; of a large cloud every n-th point is tried in
    an image, about ``points_tried``, other ones in the next. NaN when no image shows a point.
    """
    squares, rounding, count = 0.0, 0.0, 0
    step = max(1, len(points) // points_tried)
    for turn, image in enumerate(sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)):
        camera = model.cameras[image.camera_id]
        difference, z = round_trip(points[turn % step :: step], camera, matrix(image.cam_from_world()))
        squares, count = squares + float(np.sum(difference**2)), count + len(z)
        rounding += float(z @ z) * _ROUNDING_PX**2 / (camera.focal_length_x * camera.focal_length_y)
    rmse, expected = (float(np.sqrt(s / count)) if count else float("nan") for s in (squares, rounding))
    return Backprojection(rmse_m=rmse, points=count, rounding_m=expected)
