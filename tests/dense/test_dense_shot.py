"""One shot of a calibrated rig: partners by geometry alone, depths without a sparse model, and what is refused."""

import cv2
import numpy as np
import pytest
from dense_world import render

from tiegraph.dense.depth import confirmed_map, depth_map
from tiegraph.dense.neighbours import EPIPOLE, ONE_CENTRE
from tiegraph.dense.plan import CameraModel, DepthRange, ViewPlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.shot import NO_OVERLAP, depth_range, plan_shot
from tiegraph.dense.tuning import Tuning
from tiegraph.errors import InputError
from tiegraph.geometry.transforms import rigid

SETTINGS = DenseSettings()
TUNING = Tuning()
CAMERA = CameraModel("PINHOLE", 320, 240, (300.0, 300.0, 160.0, 120.0))
RANGE = DepthRange(0.5, 1.2)


def view(name, position, rotation=None):
    rotation = np.eye(3) if rotation is None else rotation
    return ViewPlan(name, CAMERA, rigid(rotation, -rotation @ np.asarray(position, float)))


SQUARE = [view(f"{k}.png", (0.075 * x, 0.075 * y, 0)) for k, (x, y) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1)))]


def wave(x, y):
    return 0.7 + 0.02 * np.sin(20 * x + 5 * y) + 0.01 * np.sin(31 * y)


def photograph(folder, plan, seed=0):
    """Image and depth of a textured relief in front of a camera that looks along z."""
    position = -plan.cam_from_world[:3, 3]
    u, v = np.meshgrid(np.arange(320) + 0.5, np.arange(240) + 0.5)
    rx, ry = (u - 160) / 300, (v - 120) / 300
    z = np.full(u.shape, 0.7)
    for _ in range(20):
        z = wave(position[0] + rx * z, position[1] + ry * z)
    rng = np.random.default_rng(7)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (900, 900)).astype(np.float32), (0, 0), 1.5)
    texture = cv2.normalize(texture, None, 20, 235, cv2.NORM_MINMAX)
    at = [((p + r * z + 0.6) / 0.0015).astype(np.float32) for p, r in zip(position[:2], (rx, ry), strict=True)]
    image = cv2.remap(texture, at[0], at[1], cv2.INTER_CUBIC) + np.random.default_rng(seed).normal(0, 1.5, z.shape)
    cv2.imwrite(str(folder / plan.name), np.clip(image, 0, 255).astype(np.uint8))
    return z


@pytest.mark.slow
def test_a_shot_gives_depths_with_their_sigma(tmp_path):
    truth = {v.name: photograph(tmp_path, v, k) for k, v in enumerate(SQUARE)}
    plan = plan_shot(SQUARE, RANGE, SETTINGS, TUNING)
    assert set(plan.images) == set(truth) and not plan.dropped
    assert all(len(p.partners) == 3 for p in plan.images.values())
    first = {n: depth_map(p, tmp_path, None, SETTINGS, TUNING) for n, p in plan.images.items()}
    depth, _ = confirmed_map(plan.images["0.png"], first["0.png"], first.get, SETTINGS, TUNING)
    known = np.isfinite(depth.depth_m)
    assert known.mean() > 0.75
    error = np.abs(depth.depth_m - truth["0.png"])[known]
    actual = 1.4826 * np.median(error)
    assert 0.0001 < actual < 0.7**2 / (300 * 0.075) * 0.25  # a quarter of a pixel of one pair
    assert 0.5 < np.median(depth.sigma_m[known]) / actual < 2
    assert np.mean(error > 0.02) < 0.01


@pytest.mark.slow
def test_the_rig_of_a_rendered_survey_needs_no_model(tmp_path):
    survey = render(tmp_path)
    views = [
        ViewPlan(f"up/{s.name}/000002.jpg", CameraModel.of(s.camera), s.sensor_from_rig) for s in survey.rig.sensors
    ]
    sought = depth_range(views, 3.0, 40.0)
    try:
        plan = plan_shot(views, sought, SETTINGS, TUNING)
    except InputError as error:  # cameras of this rig look apart
        assert NO_OVERLAP in str(error) or EPIPOLE in str(error) or ONE_CENTRE in str(error)
    else:
        assert plan.images


def test_the_range_follows_from_the_rig_where_none_is_given():
    found = depth_range(SQUARE, None, None)
    assert found.near == pytest.approx(5 * 0.075 * np.sqrt(2)) and found.far == pytest.approx(20 * found.near)
    assert depth_range(SQUARE, 0.5, None).near == 0.5


@pytest.mark.parametrize("near, far", [(-1.0, 2.0), (2.0, 1.0), (0.0, 1.0), (np.nan, 2.0), (1.0, np.inf)])
def test_a_range_that_is_none_is_refused(near, far):
    with pytest.raises(InputError, match="near"):
        depth_range(SQUARE, near, far)


def test_cameras_in_one_place_are_refused():
    with pytest.raises(InputError, match="two calibrated cameras"):
        depth_range(SQUARE[:1], None, None)
    with pytest.raises(InputError, match="two calibrated cameras"):
        depth_range([SQUARE[0], view("again.png", (0, 0, 0))], None, None)


def test_no_pair_to_match_says_why():
    away = np.diag([-1.0, 1.0, -1.0])  # looks back
    with pytest.raises(InputError, match=NO_OVERLAP):
        plan_shot([SQUARE[0], view("b.png", (0.075, 0, 0), away)], RANGE, SETTINGS, TUNING)
    with pytest.raises(InputError, match=EPIPOLE.split(":")[0]):
        plan_shot([SQUARE[0], view("b.png", (0, 0, 0.2))], RANGE, SETTINGS, TUNING)
    with pytest.raises(InputError, match=ONE_CENTRE.split(":")[0]):
        plan_shot([SQUARE[0], view("b.png", (0.001, 0, 0))], RANGE, SETTINGS, TUNING)
