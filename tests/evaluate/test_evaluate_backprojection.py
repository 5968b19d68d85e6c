"""The round trip of paper 000, eq. 4-6: rounding to the pixel is all that is left."""

import numpy as np
import pycolmap
import pytest

from tiegraph.evaluate.backprojection import Backprojection, backprojection_rmse
from tiegraph.evaluate.tuning import Tuning
from tiegraph.geometry import transforms

TRIED = Tuning().points_tried


def looking(angle_deg: float, at: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    a = np.radians(angle_deg)
    rotation = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return transforms.invert(transforms.rigid(rotation, np.array(at, float)))


def wall(depth: float, points: int = 20000) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(-20, 20, points), rng.uniform(-8, 8, points), np.full(points, depth)])


def found(points: np.ndarray, *poses: np.ndarray) -> Backprojection:
    """Of images with these cam_from_world and K = [[500, 0, 320], [0, 510, 240], [0, 0, 1]]; one more has no pose."""
    model = pycolmap.Reconstruction()
    params = [500.0, 510, 320, 240]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="PINHOLE", width=640, height=480, params=params, camera_id=1)
    )
    for k, pose in enumerate(poses):
        image = pycolmap.Image(name=f"{k}.jpg", camera_id=1, image_id=k + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    model.add_image_with_trivial_frame(pycolmap.Image(name="z.jpg", camera_id=1, image_id=9))
    return backprojection_rmse(points, model, TRIED)


@pytest.mark.parametrize("depth", [5.0, 20.0])
def test_error_is_the_rounding_alone(depth: float) -> None:
    poses = looking(0), looking(8, (1, 0, 0))
    result = found(wall(depth), *poses)
    expected = depth * np.sqrt(2 / 12) / 505
    assert 0.95 * expected < result.rmse_m < 1.05 * expected
    assert 0.95 < result.rmse_m / result.rounding_m < 1.05
    alone = [found(wall(depth), pose) for pose in poses]
    assert all(0.9 * expected < one.rmse_m < 1.2 * expected for one in alone)
    assert result.points == sum(one.points for one in alone) > 1000


def test_a_wrong_pose_does_not_show_and_nothing_seen_is_nan_not_zero() -> None:
    """The reason the figure proves nothing: a view a metre off has the same error."""
    right, wrong = (found(wall(20.0), looking(0, (x, 0, 0))) for x in (0, 1))
    assert abs(wrong.rmse_m / right.rmse_m - 1) < 0.05
    behind = found(wall(10.0, 100), looking(180))
    assert behind.points == 0 and np.isnan(behind.rmse_m)
