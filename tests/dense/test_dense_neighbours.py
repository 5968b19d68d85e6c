"""What a depth map is planned with: its partners and depths by the sparse model, images without their distortion."""

import cv2
import numpy as np
import pycolmap
import pytest
from dense_world import model_of

from tiegraph.dense import plan as planning
from tiegraph.dense.plan import EPIPOLE, ONE_CENTRE, SCALE, WIDE, CameraModel, ViewPlan, plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import load_view, pinhole_of
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.geometry import transforms

SETTINGS = DenseSettings()
TUNING = Tuning()
CAMERA = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240])


def model(positions, turns_deg=None, cameras=None, count=400, seed=0):
    """Cameras that look along +z (turned about y) at points between z = 9 and 11."""
    rng = np.random.default_rng(seed)
    world = np.c_[rng.uniform(-6, 6, count), rng.uniform(-4, 4, count), rng.uniform(9, 11, count)]
    turns = np.radians(turns_deg if turns_deg is not None else np.zeros(len(positions)))
    poses, seen = [], []
    cameras = cameras or [CAMERA] * len(positions)
    for position, turn, camera in zip(positions, turns, cameras, strict=True):
        c, s = np.cos(turn), np.sin(turn)
        rotation = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        pose = transforms.rigid(rotation, -rotation @ np.asarray(position, float))
        there = transforms.apply(pose, world)
        pixel = np.full((count, 2), np.nan)
        front = there[:, 2] > 0
        pixel[front] = camera.img_from_cam(there[front])
        inside = ((pixel >= 0) & (pixel <= (camera.width, camera.height))).all(axis=1)
        poses.append(pose)
        seen.append(np.where(inside[:, None], pixel, np.nan))
    return model_of([f"{k}.jpg" for k in range(len(positions))], cameras, poses, world, seen)


def considered(model, settings=SETTINGS):
    """The partners of the first image, those used first."""
    table = planning._table(model)
    return planning._candidates(table, planning._shared_counts(table), 0, settings, TUNING.partners)


def by_name(partners):
    return {p.view.name: p for p in partners}


def test_partners_at_good_angles_are_preferred():
    line = model([(x, 0, 0) for x in (0, 0.05, 0.3, 1.2, 2.0, 5.0)])
    partners = considered(line, DenseSettings(partners=2))
    used = [p.view.name for p in partners if p.used]
    assert used == ["3.jpg", "4.jpg"] and 5 < partners[0].angle_deg < 9
    assert by_name(partners)["1.jpg"].reason == ONE_CENTRE


def test_forward_motion_wide_angle_and_scale_are_refused():
    close = pycolmap.Camera(model="PINHOLE", width=2000, height=1500, params=[1500, 1500, 1000, 750])
    odd = model([(0, 0, 0), (0.05, 0, 2.5), (9.5, 0, 1), (1, 0, 0)], [0, 0, -45, 0], [CAMERA, CAMERA, CAMERA, close])
    partners = by_name(considered(odd))
    assert partners["1.jpg"].reason == EPIPOLE and partners["2.jpg"].reason == WIDE
    assert partners["3.jpg"].reason == SCALE


def test_points_that_no_partner_sees_do_not_set_the_depth_range():
    close = np.array([[0.01 * k, 0, 0.05] for k in range(30)])  # what moved while the camera stood
    rng = np.random.default_rng(0)
    world = np.concatenate([np.c_[rng.uniform(-6, 6, 400), rng.uniform(-4, 4, 400), rng.uniform(9, 11, 400)], close])
    poses = [transforms.rigid(np.eye(3), -np.array([x, 0.0, 0.0])) for x in (0, 0.001, 1)]
    seen = []
    for k, pose in enumerate(poses):
        pixel = CAMERA.img_from_cam(transforms.apply(pose, world))
        pixel[400:] = np.nan if k == 2 else 300.0
        seen.append(pixel)
    stood = model_of(["0.jpg", "1.jpg", "2.jpg"], [CAMERA] * 3, poses, world, seen)
    plan = plan_images(stood, SETTINGS, TUNING.partners)
    assert [v.name for v in plan.images["0.jpg"].partners] == ["2.jpg"]
    assert 3 < plan.images["0.jpg"].depth_range.near < 6


def test_refused_images_still_witness_and_the_depth_range_holds_the_points_with_margin():
    plan = plan_images(model([(0, 0, 0), (1, 0, 0), (0.05, 0, 2.5)]), SETTINGS, TUNING.partners)
    assert [v.name for v in plan.images["0.jpg"].partners] == ["1.jpg"]
    assert "2.jpg" in plan.images["0.jpg"].witnesses and plan.refused[EPIPOLE] >= 2
    assert any("one partner" in note for note in plan.notes)
    plan = plan_images(model([(x, 0, 0) for x in (0, 1, 2)]), SETTINGS, TUNING.partners)
    near, far = plan.images["1.jpg"].depth_range.near, plan.images["1.jpg"].depth_range.far
    assert 4 < near < 6 and 11 < far < 20


def test_an_image_without_partner_is_dropped_with_its_reason():
    plan = plan_images(model([(0, 0, 0), (1, 0, 0), (0, 0, -1)], [0, 0, 180]), SETTINGS, TUNING.partners)
    assert sorted(plan.images) == ["0.jpg", "1.jpg"] and plan.dropped[0][0] == "2.jpg"
    assert "sparse points" in plan.dropped[0][1]


def test_no_partner_at_all_is_an_error_with_a_remedy():
    with pytest.raises(ReconstructionError, match="different places"):
        plan_images(model([(0, 0, 0), (0.001, 0, 0)]), SETTINGS, TUNING.partners)
    with pytest.raises(ReconstructionError, match="no image.*partner"):
        plan_images(pycolmap.Reconstruction(), SETTINGS, TUNING.partners)


@pytest.mark.slow
def test_each_of_many_images_that_see_the_same_has_a_bounded_plan():
    plan = plan_images(model([(0.06 * k, 0, 0) for k in range(100)], count=400), SETTINGS, TUNING.partners)
    assert len(plan.images) == 100 and not plan.dropped
    assert {len(p.partners) for p in plan.images.values()} == {SETTINGS.partners}


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
