"""New frames take their place from ties to images with a pose; the plan is level and lies on the positions."""

from dataclasses import replace
from functools import partial

import numpy as np
import pycolmap
import pytest

from boat_world import photos
from tiegraph.geometry import transforms
from tiegraph.pipeline.watchmodel import resect_previews
from tiegraph.scene.matches import PreviewMatches
from tiegraph.watch.frames import Known, place_frames
from tiegraph.watch.tuning import FramesTuning
from tiegraph.watch.view import path_and_ties, plan_from_world

TUNING = FramesTuning()
IMAGES, POINTS = 5, 300
CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[500, 320, 240])


def world(noise_px=0.5, step=0.7):
    """A row of photographs of a wall: poses, key points of each (a feature a point), ties of all with all."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-3, 6, POINTS), rng.uniform(-2, 2, POINTS), rng.uniform(8, 12, POINTS)])
    poses = np.stack([transforms.rigid(np.eye(3), [-step * k, 0, 0]) for k in range(IMAGES)])
    seen = [np.asarray(CAMERA.img_from_cam(transforms.apply(p, points))) for p in poses]
    seen = [xy + rng.normal(0, noise_px, xy.shape) for xy in seen]
    i, j = np.triu_indices(IMAGES, 1)
    every = np.stack([np.arange(POINTS)] * 2, axis=1)
    return poses, seen, PreviewMatches.make(i, j, [every] * len(i))


def placed(poses, seen, ties, known):
    scene = photos(IMAGES)
    start = np.where(np.isin(np.arange(IMAGES), known)[:, None, None], poses, np.nan)
    rig = calibrated_rig(scene)
    state = Known(start, [CAMERA] * IMAGES, lambda k: seen[k], [rig])
    frames = [int(scene.frame[k]) for k in range(IMAGES) if k not in known]
    how = partial(resect_previews, size_px=400, tuning=TUNING)
    return place_frames(scene, ties, state, frames, how, TUNING)


def calibrated_rig(scene):
    (rig,) = scene.rigs
    return replace(rig, sensors=(replace(rig.sensors[0], camera=CAMERA, sensor_from_rig=np.eye(4)),))


def test_frames_are_placed_one_by_one_from_those_before():
    poses, seen, ties = world()
    found = placed(poses, seen, ties, known=[0, 1])
    off = np.linalg.norm(transforms.centre(found) - transforms.centre(poses), axis=1)
    assert np.all(off[:2] == 0) and 1e-6 < off[2:].max() < 0.15


def test_points_without_base_and_ties_of_another_wall_place_nothing():
    poses, seen, ties = world()
    assert np.isnan(placed(poses, seen, ties, known=[0])[1:]).all(), "one image tells no point"
    near, seen_near, _ = world(step=0.03)
    assert np.isnan(placed(near, seen_near, ties, known=[0, 1])[2:]).all(), "nor do two at one place"
    rng = np.random.default_rng(2)
    wrong = [xy if k < 2 else rng.uniform(0, 480, xy.shape) for k, xy in enumerate(seen)]
    assert np.isnan(placed(poses, wrong, ties, known=[0, 1])[2:]).all()


def test_positions_tell_what_is_up_where_cameras_look_down():
    poses = np.stack([transforms.rigid(np.diag([1.0, -1, -1]), [-x, y, 30]) for x in range(4) for y in (0, 5)])
    scene = photos(len(poses))
    there = np.tile(np.eye(4), (len(poses), 1, 1))
    there[:, :3, 3] = 2 * transforms.centre(poses)
    known = scene.with_(world_from_rig=there, position_sigma_m=np.full((len(poses), 3), 0.1), prior="exif")
    plan, scale = plan_from_world(poses, known)
    assert scale == pytest.approx(2) and plan[2, :3] == pytest.approx([0, 0, 2], abs=1e-6)


def test_positions_turn_and_scale_the_plan():
    poses, _, ties = world()
    scene, scale, turn = photos(IMAGES), 7.0, np.radians(30)
    there = np.zeros((scene.frames, 4, 4))
    there[:, :3, :3] = np.eye(3)
    along = scale * 0.7 * np.arange(IMAGES)
    bend = 0.5 * (np.arange(IMAGES) == 2)
    poses[:, 2, 3] -= bend / scale
    local = along + 1j * bend
    world_xy = local * np.exp(1j * turn)
    there[scene.frame, 0, 3], there[scene.frame, 1, 3] = 100 + world_xy.real, 200 + world_xy.imag
    sigma = np.full((scene.frames, 3), 0.1)
    placed_scene = scene.with_(world_from_rig=there, position_sigma_m=sigma, prior="exif")
    plan, found = plan_from_world(poses, placed_scene)
    assert found == pytest.approx(scale, rel=1e-3)
    xyz = transforms.apply(plan, transforms.centre(poses))
    assert xyz[:, 0] == pytest.approx(there[scene.frame, 0, 3], abs=0.05)
    shown = path_and_ties(placed_scene, ties, xyz, np.ones(IMAGES, bool), least=12, most=4)
    assert len(shown["frames"]) == IMAGES and len(shown["ties"]) == 4 and shown["untied"] == []
    none = path_and_ties(placed_scene, PreviewMatches.empty(), xyz, np.ones(IMAGES, bool), least=12, most=4)
    assert none["untied"] == list(scene.names)
