import cv2
import numpy as np
import pycolmap
import pytest

from tiegraph.dense.plan import CameraModel, ViewPlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.undistort import load_view, pinhole_of
from tiegraph.errors import InputError

SETTINGS = DenseSettings()
SIZE = (320, 240)
CAMERAS = {
    "PINHOLE": [200, 210, 158, 121],
    "SIMPLE_RADIAL": [200, 160, 120, -0.1],
    "OPENCV": [200, 202, 158, 121, -0.15, 0.03, 0.001, -0.001],
    "FULL_OPENCV": [200, 202, 158, 121, -0.1, 0.02, 0.001, 0, 0, 0, 0, 0],
    "OPENCV_FISHEYE": [110, 110, 160, 120, 0.01, -0.003, 0, 0],
    "SIMPLE_FISHEYE": [100, 160, 120],
}


def plan(model):
    return ViewPlan("a.png", CameraModel(model, *SIZE, tuple(map(float, CAMERAS[model]))), np.eye(4))


@pytest.mark.parametrize("model", CAMERAS)
def test_pixels_come_from_where_the_camera_saw_their_ray(model, tmp_path):
    u, v = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    coded = np.stack([u * 0.75, v * 0.75, np.zeros_like(u)], axis=-1)
    cv2.imwrite(str(tmp_path / "a.png"), np.rint(coded).astype(np.uint8))
    view = load_view(plan(model), tmp_path, None, SETTINGS)
    assert view.mask.mean() > 0.7
    row, column = np.nonzero(cv2.erode(view.mask.astype(np.uint8), np.ones((5, 5))))
    rays = np.c_[column + 0.5, row + 0.5, np.ones(len(row))] @ np.linalg.inv(view.K).T
    camera = pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=CAMERAS[model])
    expected = camera.img_from_cam(rays)
    found = view.image_bgr[row, column, :2] / 0.75
    assert np.median(np.abs(found - expected)) < 0.6
    assert np.percentile(np.abs(found - expected), 99) < 1.2


def test_field_of_view_is_kept_up_to_the_limit():
    K, size = pinhole_of(plan("OPENCV").camera, SETTINGS)
    # The borders of the image lie at 77 degrees, its corners, stretched by the barrel distortion, at 87.
    assert 77 < 2 * np.degrees(np.arctan(size[0] / 2 / K[0, 0])) < 88
    for limit in (60, 100):
        K, size = pinhole_of(plan("SIMPLE_FISHEYE").camera, DenseSettings(max_fov_deg=limit))
        left, right = -K[0, 2] / K[0, 0], (size[0] - K[0, 2]) / K[0, 0]
        assert np.degrees(np.arctan(right) - np.arctan(left)) == pytest.approx(limit, abs=0.5)


def test_size_is_limited_and_a_pinhole_unchanged():
    K, size = pinhole_of(plan("PINHOLE").camera, SETTINGS)
    np.testing.assert_allclose(K, [[200, 0, 158], [0, 200 * 240 / 229, 121], [0, 0, 1]], rtol=0.06)
    _, size = pinhole_of(plan("OPENCV").camera, DenseSettings(max_image_size=100))
    assert max(size) == 100


def test_masks_are_warped_and_missing_ones_use_all(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((240, 320, 3), np.uint8))
    mask = np.zeros((240, 320), np.uint8)
    mask[:, 160:] = 255
    cv2.imwrite(str(tmp_path / "a.png.png"), mask)
    whole = load_view(plan("OPENCV"), tmp_path, None, SETTINGS).mask
    half = load_view(plan("OPENCV"), tmp_path, tmp_path, SETTINGS).mask
    assert 0.45 < half.sum() / whole.sum() < 0.55 and not half[:, :100].any()
    assert (load_view(plan("OPENCV"), tmp_path, tmp_path / "none", SETTINGS).mask == whole).all()


def test_bad_files_are_named_and_a_camera_that_sees_all_round_is_refused(tmp_path):
    with pytest.raises(InputError, match="a.png"):
        load_view(plan("PINHOLE"), tmp_path, None, SETTINGS)
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((120, 160, 3), np.uint8))
    with pytest.raises(InputError, match="160 x 120"):
        load_view(plan("PINHOLE"), tmp_path, None, SETTINGS)
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((240, 320, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "a.png.png"), np.zeros((24, 32), np.uint8))
    with pytest.raises(InputError, match="a.png.png"):
        load_view(plan("PINHOLE"), tmp_path, tmp_path, SETTINGS)
    with pytest.raises(InputError, match="all round"):
        pinhole_of(CameraModel("EQUIRECTANGULAR", 400, 200, (400.0, 200.0)), SETTINGS)
