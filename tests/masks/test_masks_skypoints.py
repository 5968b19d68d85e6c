import numpy as np
import pycolmap
import pytest

from tiegraph.masks import SKY, USE, WATER
from tiegraph.masks.skyline import places, without_points
from tiegraph.masks.tuning import SkyPointsTuning

SHAPE = (360, 640)
TUNING = SkyPointsTuning()


@pytest.fixture
def street():
    """Classes with true sky at the left, and at the right a wall called sky, with two windows; points on the rest."""
    classes = np.full(SHAPE, USE, np.uint8)
    classes[:150, :300] = SKY
    classes[:200, 340:] = SKY
    classes[60:84, 400:424] = classes[60:84, 500:524] = USE
    classes[320:] = WATER
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (3000, 2)).astype(np.float32)
    row, column = (points[:, 1] * SHAPE[0]).astype(int), (points[:, 0] * SHAPE[1]).astype(int)
    return classes, points[classes[row, column] == USE], rng


def test_a_wall_called_sky_is_found_out_by_points_in_and_on_it(street):
    classes, seen, rng = street
    on_wall = np.stack([rng.uniform(0.55, 0.99, 120), rng.uniform(0.02, 0.53, 120)], axis=1).astype(np.float32)
    found = without_points(classes, np.concatenate([seen, on_wall]), TUNING)
    assert (found[:150, :300] == SKY).all() and not (found[:, 340:] == SKY).any()
    assert (found[320:] == WATER).all() and (classes[:200, 340:] == SKY).any(), "the argument stays as it is"


def test_points_at_the_skyline_and_single_false_ones_leave_the_sky(street):
    classes, seen, rng = street
    edge = np.stack([rng.uniform(0, 0.46, 200), np.full(200, 148 / 360)], axis=1).astype(np.float32)
    false = np.float32([[0.1, 0.1], [0.2, 0.2], [0.3, 0.05]])
    found = without_points(classes, np.concatenate([seen, edge, false]), TUNING)
    assert (found[:150, :300] == SKY).all()


def test_nothing_to_say():
    sky = np.full(SHAPE, SKY, np.uint8)
    assert without_points(sky, np.random.default_rng(0).uniform(0, 1, (50, 2)).astype(np.float32), TUNING) is sky
    use = np.full(SHAPE, USE, np.uint8)
    assert without_points(use, np.zeros((0, 2), np.float32), TUNING) is use


def test_places_of_points_in_an_image():
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=360, params=[320, 320, 320, 180], camera_id=1)
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.eye(3)), np.array([0, 0, 2.0]))

    class Image:
        def cam_from_world(self):
            return pose

    points = np.array([[0, 0, 0], [1, 0.5, 0], [0, 0, -3], [40, 0, 1]], float)  # two in view, behind, aside
    assert places(Image(), camera, points, TUNING) == pytest.approx(np.array([[0.5, 0.5], [0.75, 0.5 + 80 / 360]]))
