"""Points of all tracks of a coarse model: where their rays meet, and not where they do not."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from tiegraph.geometry import transforms
from tiegraph.network.coarse.model import CoarseModel
from tiegraph.network.coarse.surface import with_surface
from tiegraph.network.tuning.coarse import TracksTuning
from tiegraph.scene.matches import PreviewMatches

CAMERA = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 500.0, 640, 480)
IMAGES, POINTS = 5, 40
TUNING = TracksTuning()


@pytest.fixture
def world():
    """Five images a metre apart before a wall at ten metres: model without points, ties, pixels, true points."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-2, 6, POINTS), rng.uniform(-3, 3, POINTS), rng.uniform(9, 11, POINTS)])
    centres = np.column_stack([np.arange(IMAGES), np.zeros(IMAGES), np.zeros(IMAGES)])
    poses = transforms.rigid(np.repeat(np.eye(3)[None], IMAGES, axis=0), -centres)
    pixels = [CAMERA.img_from_cam(points - c) for c in centres]
    none = np.zeros(0, int)
    model = CoarseModel(poses, (CAMERA,) * IMAGES, np.zeros((0, 3)), none, none, ())
    i, j = np.triu_indices(IMAGES, 1)
    own = np.column_stack([np.arange(POINTS)] * 2)
    return model, PreviewMatches.make(i, j, [own] * len(i)), pixels, points


def made(world, tuning=TUNING):
    model, ties, pixels, _ = world
    return with_surface(model, ties, lambda k: pixels[k], tuning)


def test_points_stand_where_the_rays_meet(world):
    found = made(world)
    assert len(found.points) == POINTS and len(found.image) == POINTS * IMAGES
    nearest = np.linalg.norm(found.points[:, None] - world[3][None], axis=2).min(axis=0)
    assert 0 <= nearest.max() < 1e-5
    assert np.all(np.bincount(found.point) == IMAGES)


def test_a_ray_that_misses_is_left_out_and_the_point_stays(world):
    world[2][2][7] += 60  # 7 degrees
    found = made(world)
    assert len(found.points) == POINTS and len(found.image) == POINTS * IMAGES - 1
    assert np.linalg.norm(found.points[:, None] - world[3][None], axis=2).min(axis=0).max() < 1e-5


@pytest.mark.parametrize(("tuning", "kept"), [({"images": 5}, POINTS), ({"images": 6}, 0), ({"angle_deg": 40.0}, 0)])
def test_a_point_needs_rays_that_are_enough_and_apart(world, tuning, kept):
    assert len(made(world, TUNING.model_copy(update=tuning)).points) == kept


def test_tracks_that_hold_an_image_twice_are_no_points(world):
    model, ties, pixels, _ = world
    wrong = ties.matches.copy()
    wrong[0] = 0, 1  # joins the tracks of two points
    joined = PreviewMatches(i=ties.i, j=ties.j, start=ties.start, matches=wrong)
    found = with_surface(model, joined, lambda k: pixels[k], TUNING)
    assert len(found.points) == POINTS - 2


def test_what_lies_behind_and_images_that_are_not_placed_make_no_points(world):
    model, ties, pixels, points = world
    poses = model.cam_from_world.copy()
    poses[:2] = np.nan
    found = with_surface(replace(model, cam_from_world=poses), ties, lambda k: pixels[k], TUNING)
    assert set(found.image) == {2, 3, 4} and len(found.points) == POINTS
    turned = poses @ np.diag([1.0, 1, 1, 1])
    turned[2:, :3, 3] *= -1  # rays meet behind the cameras
    assert not len(with_surface(replace(model, cam_from_world=turned), ties, lambda k: pixels[k], TUNING).points)


def test_nothing_to_tie_is_no_surface(world):
    model, _, pixels, _ = world
    assert not len(with_surface(model, PreviewMatches.empty(), lambda k: pixels[k], TUNING).points)
