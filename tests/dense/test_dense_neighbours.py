"""Partners of an image and the range of its depths, by the points of the sparse model."""

import time

import numpy as np
import pycolmap
import pytest
from dense_world import model_of

from tiegraph.dense import neighbours
from tiegraph.dense.neighbours import EPIPOLE, ONE_CENTRE, SCALE, WIDE, plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.errors import ReconstructionError
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
    table = neighbours._table(model)
    return neighbours._candidates(table, neighbours._shared_counts(table), 0, settings, TUNING.partners)


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
def test_many_images_take_seconds_not_minutes():
    big = model([(0.02 * k, 0, 0) for k in range(300)], count=600)
    start = time.process_time()
    plan = plan_images(big, SETTINGS, TUNING.partners)
    assert len(plan.images) == 300 and time.process_time() - start < 10
