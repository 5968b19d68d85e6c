"""Input nobody should give: an error that names it, or a depth map without depths; never a crash, never nonsense."""

from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
from dense_world import model_of, render, true_model

from tiegraph.dense.depth import depth_map
from tiegraph.dense.engine import DenseView, rectified_engine
from tiegraph.dense.neighbours import plan_images
from tiegraph.dense.plan import DepthRange
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tsgm import match_tsgm
from tiegraph.dense.tuning import Tuning
from tiegraph.errors import ReconstructionError
from tiegraph.geometry.transforms import rigid

pytestmark = pytest.mark.slow  # the world they share

SETTINGS = DenseSettings()
TUNING = Tuning()
NAME = "up/cam0/000002.jpg"


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return render(tmp_path_factory.mktemp("bad"))


@pytest.fixture(scope="module")
def plan(survey):
    return plan_images(true_model(survey), SETTINGS, TUNING.partners).images[NAME]


def picture(size=(160, 120), position=(0.0, 0, 0), rotation=None, seed=0):
    width, height = size
    grey = cv2.GaussianBlur(np.random.default_rng(seed).uniform(0, 255, (height, width)).astype(np.float32), (0, 0), 1)
    rotation = np.eye(3) if rotation is None else rotation
    K = np.array([[200.0, 0, width / 2], [0, 200, height / 2], [0, 0, 1]])
    pose = rigid(rotation, -rotation @ np.asarray(position, float))
    bgr = cv2.cvtColor(grey.astype(np.uint8), cv2.COLOR_GRAY2BGR)
    return DenseView("x", bgr, np.ones((height, width), bool), K, pose)


def matched(reference, *partners, near=2.0, far=50.0):
    return rectified_engine(reference, partners, DepthRange(near, far), SETTINGS, TUNING, match_tsgm)


def test_images_without_overlap_give_no_depth():
    behind = np.diag([-1.0, 1.0, -1.0])
    for other in (picture(position=(1, 0, 0), rotation=behind), picture(position=(5000.0, 0, 0))):
        assert np.isnan(matched(picture(), other).depth_m).all()


def test_images_of_different_things_give_almost_no_depth():
    found = matched(picture(seed=1), picture(position=(0.5, 0, 0), seed=2), picture(position=(-0.5, 0, 0), seed=3))
    assert np.mean(found.views >= 3) < 0.05


@pytest.mark.parametrize("size", [(1, 1), (160, 1), (1, 120), (3, 3), (17, 16)])
def test_tiny_images_give_no_depth_and_no_crash(size):
    found = matched(picture(size), picture(size, (0.5, 0, 0)))
    assert found.depth_m.shape == (size[1], size[0])
    assert np.isfinite(found.depth_m).mean() < 1


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_poses_that_are_no_numbers_give_no_depth(value):
    broken = replace(picture(position=(0.5, 0, 0)), cam_from_world=np.full((4, 4), value))
    assert np.isnan(matched(picture(), broken).depth_m).all()
    assert np.isnan(matched(broken, picture()).depth_m).all()


def test_a_model_with_a_broken_pose_leaves_that_image_out(survey):
    model = true_model(survey)
    names = sorted(survey.cam_from_world)
    sensors = {s.name: s.camera for s in survey.rig.sensors}
    poses = [survey.cam_from_world[n] for n in names]
    poses[names.index(NAME)] = np.full((4, 4), np.nan)
    world = np.array([p.xyz for p in model.points3D.values()])
    seen = [np.full((len(world), 2), np.nan) for _ in names]
    for row, point in enumerate(model.points3D.values()):
        for e in point.track.elements:
            seen[e.image_id - 1][row] = model.images[e.image_id].points2D[e.point2D_idx].xy
    broken = model_of(names, [sensors[n.split("/")[1]] for n in names], poses, world, seen)
    found = plan_images(broken, SETTINGS, TUNING.partners)
    assert NAME not in found.images
    assert all(NAME != v.name for p in found.images.values() for v in p.partners)


def test_a_wrong_calibration_costs_depths_and_does_not_make_false_ones(survey, plan):
    right = depth_map(plan, survey.images, None, SETTINGS, TUNING)
    camera = plan.view.camera
    wrong = replace(camera, params=(camera.params[0] * 1.3, *camera.params[1:]))
    partners = tuple(replace(v, camera=wrong) if v.camera == camera else v for v in plan.partners)
    bad = depth_map(replace(plan, partners=partners), survey.images, None, SETTINGS, TUNING)
    assert np.mean(bad.views >= 3) < 0.6 * np.mean(right.views >= 3)


def test_disparities_beyond_the_kernels_are_refused_or_coarser():
    left, right = np.zeros((40, 60), np.uint8), np.zeros((40, 60 + 5000), np.uint8)
    try:
        found = match_tsgm(left, right, 5000, SETTINGS, TUNING)
    except ValueError as error:
        assert "disparities" in str(error)
    else:
        assert found.shape == (40, 60)
    # The engine never asks for them: a range to nearly the camera is matched at a coarser resolution.
    found = matched(picture(), picture(position=(0.5, 0, 0), seed=0), near=1e-4, far=1e6)
    assert found.depth_m.shape == (120, 160)


def test_an_empty_model_is_refused():
    with pytest.raises(ReconstructionError, match="partner"):
        plan_images(pycolmap.Reconstruction(), SETTINGS, TUNING.partners)
