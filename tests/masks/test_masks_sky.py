"""What is sky: above the rest, as one region, without points in it; pale roads, walls and clouds are told from it."""

from functools import cache
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pycolmap
import pytest

from masks_world import SHAPE, smooth, write
from tiegraph.masks import SKY, USE, WATER
from tiegraph.masks.classification import _snapped, classes_of, pooled, textureless_regions
from tiegraph.masks.learnt import _like_sky, _wide, edges_of, learn, lowest_agreed, not_above
from tiegraph.masks.matchability import Matchability
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.skyline import border_sky, places, without_points
from tiegraph.masks.tuning import SkyPointsTuning, Tuning

TUNING = Tuning()
PALE_BGR = (196, 190, 186)
HORIZON = 90  # row
EVERYWHERE = np.ones(SHAPE, bool)


@cache
def _ground():
    return smooth(1, (1000, 1400), (250, 350))[..., None] * np.float32([0.7, 1.0, 0.8])


def _taken(scene, seed):
    rng = np.random.default_rng(seed)
    return np.clip(scene + rng.normal(0, 1.5, scene.shape), 0, 255).astype(np.uint8)


@cache
def _field():
    """The ground from above, (1000, 1400, 3) f4, with roads of one pale grey."""
    field = 20 + 130 * _ground()
    for x in range(100, 1400, 330):
        cv2.line(field, (x, 0), (x + 60, 1000), PALE_BGR, 70)
    return field


def from_above(k):
    """Image k of a flight that turns at each leg, (240, 320, 3) u1."""
    leg, step = divmod(k, 6)
    y, x = 60 + 170 * leg, 100 + 55 * (step if leg % 2 else 5 - step)
    return _taken(_field()[y : y + SHAPE[0], x : x + SHAPE[1]], k)


def straight_ahead(k):
    """Image k of a walk along a hedge, dark at its top, below an overcast sky, (240, 320, 3) u1; the sky (240, 320)."""
    x = 14 * k
    tops = HORIZON + (40 * (smooth(2, (1, 1400), (1, 9))[0][x : x + SHAPE[1]] - 0.5)).astype(int)
    below = np.arange(SHAPE[0])[:, None] - tops
    scene = 20 + 130 * _ground()[: SHAPE[0], x : x + SHAPE[1]] * np.clip(below / 25, 0, 1)[..., None]
    sky = below < 0
    scene[sky] = PALE_BGR
    return _taken(scene, k), sky


def _found(tmp_path, images):
    paths = [write(tmp_path / f"{k:02d}.png", image) for k, image in enumerate(images)]
    made = learn({0: paths}, MasksSettings(), TUNING)[0]
    return made, np.stack([classes_of(p, made, MasksSettings(), SHAPE, TUNING) for p in paths])


@pytest.mark.slow
def test_pale_roads_seen_from_above_are_used(tmp_path):
    made, found = _found(tmp_path, [from_above(k) for k in range(12)])
    assert made.no_sky and (found == USE).mean() > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("roll", [0, 25])
def test_an_overcast_sky_of_the_same_looks_is_masked(tmp_path, roll):
    turn = cv2.getRotationMatrix2D((SHAPE[1] / 2, SHAPE[0] / 2), roll, 1.5)
    taken = [straight_ahead(k) for k in range(12)]
    images = [cv2.warpAffine(image, turn, SHAPE[::-1]) for image, _ in taken]
    sky = np.stack([cv2.warpAffine(s.astype(np.uint8), turn, SHAPE[::-1]) for _, s in taken]) > 0
    made, found = _found(tmp_path, images)
    assert not made.no_sky
    assert (found[sky] == SKY).mean() > 0.9 and (found[~sky] == USE).mean() > 0.98


def test_edges_of_a_sky_face_down_and_those_of_a_road_both_ways():
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    sky = edges_of(row < HORIZON, EVERYWHERE, TUNING.labels)
    assert sky[0] == pytest.approx(sky[1]) and sky[1] == pytest.approx(SHAPE[1], rel=0.02)
    tilted = edges_of(row < HORIZON + 0.5 * (column - 160), EVERYWHERE, TUNING.labels)
    assert tilted[0] / tilted[1] == pytest.approx(np.cos(np.arctan(0.5)), abs=0.02)
    road = edges_of(abs(column - 160 + 0.3 * row) < 30, EVERYWHERE, TUNING.labels)
    yard = edges_of((abs(column - 160) < 40) & (abs(row - 120) < 40), EVERYWHERE, TUNING.labels)
    assert abs(road[0]) < 0.02 * road[1] and abs(yard[0]) < 0.02 * yard[1]
    cut = edges_of(row < HORIZON, row < HORIZON, TUNING.labels)
    assert cut[1] < 0.03 * sky[1], "where the sky is no longer sought it has no edge"


def test_all_level_cameras_say_together_whether_the_sky_is_above():
    own = TUNING.labels
    assert not_above({0: [(40, 80), (10, 20)], 1: [(-5, 30)]}, own) == set()
    assert not_above({0: [(4, 80), (10, 20)], 1: [(9, 10)]}, own) == {0, 1}
    assert not_above({0: [(0.0, 0.0)], 1: []}, own) == set() == not_above({}, own), "nothing looks like sky"


WIDE = (360, 640)
POINTS = SkyPointsTuning()


@pytest.fixture
def street():
    """Classes with true sky at the left, and at the right a wall called sky, with two windows; points on the rest."""
    classes = np.full(WIDE, USE, np.uint8)
    classes[:150, :300] = SKY
    classes[:200, 340:] = SKY
    classes[60:84, 400:424] = classes[60:84, 500:524] = USE
    classes[320:] = WATER
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (3000, 2)).astype(np.float32)
    row, column = (points[:, 1] * WIDE[0]).astype(int), (points[:, 0] * WIDE[1]).astype(int)
    return classes, points[classes[row, column] == USE], rng


def test_a_wall_called_sky_is_found_out_by_points_in_and_on_it(street):
    classes, seen, rng = street
    on_wall = np.stack([rng.uniform(0.55, 0.99, 120), rng.uniform(0.02, 0.53, 120)], axis=1).astype(np.float32)
    found = without_points(classes, np.concatenate([seen, on_wall]), POINTS)
    assert (found[:150, :300] == SKY).all() and not (found[:, 340:] == SKY).any()
    assert (found[320:] == WATER).all() and (classes[:200, 340:] == SKY).any(), "the argument stays as it is"


def test_points_at_the_skyline_and_single_false_ones_leave_the_sky(street):
    classes, seen, rng = street
    edge = np.stack([rng.uniform(0, 0.46, 200), np.full(200, 148 / 360)], axis=1).astype(np.float32)
    false = np.float32([[0.1, 0.1], [0.2, 0.2], [0.3, 0.05]])
    found = without_points(classes, np.concatenate([seen, edge, false]), POINTS)
    assert (found[:150, :300] == SKY).all()
    sky = np.full(WIDE, SKY, np.uint8)
    assert without_points(sky, np.random.default_rng(0).uniform(0, 1, (50, 2)).astype(np.float32), POINTS) is sky
    use = np.full(WIDE, USE, np.uint8)
    assert without_points(use, np.zeros((0, 2), np.float32), POINTS) is use


def test_places_of_points_in_an_image():
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=360, params=[320, 320, 320, 180], camera_id=1)
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.eye(3)), np.array([0, 0, 2.0]))

    image = SimpleNamespace(cam_from_world=lambda: pose)
    points = np.array([[0, 0, 0], [1, 0.5, 0], [0, 0, -3], [40, 0, 1]], float)  # two in view, behind, aside
    assert places(image, camera, points, POINTS) == pytest.approx(np.array([[0.5, 0.5], [0.75, 0.5 + 80 / 360]]))


def test_regions_end_at_edges_and_hold_soft_clouds():
    image = np.full((200, 320), 180, np.float32)
    image[:90] += 25 * np.sin(np.linspace(0, 6, 320))[None]  # clouds: a few grey levels a pixel at most
    image[90:] = 100
    regions = textureless_regions(np.clip(image, 0, 255).astype(np.uint8), TUNING.classification)
    above, below = regions[5:85], regions[95:195]
    assert (above == above[0, 0]).all() and (below == below[0, 0]).all() and 0 < above[0, 0] != below[0, 0] > 0
    assert (regions[89:91] == 0).any(), "the edge itself is of no region"


def test_a_region_is_judged_as_one():
    regions = np.zeros((10, 10), np.int32)
    regions[:, :5], regions[:, 6:] = 1, 2
    ratio = np.full((10, 10), 2.0, np.float32)
    ratio[:, 6:] = -9.0  # clipped: no single pixel outweighs all others
    mean = pooled(ratio, regions, TUNING.classification)
    assert mean[0, 0] == pytest.approx(2) and mean[0, 9] == pytest.approx(-3) and (mean[:, 5] == 0).all()


def test_the_edge_of_the_sky_snaps_to_the_brightness():
    light = np.full((240, 640), 90, np.uint8)
    light[:100] = 200
    light = cv2.GaussianBlur(light, (3, 3), 0)
    labels = np.full((240, 640), USE, np.uint8)
    labels[:98] = SKY  # two pixels short
    found = _snapped(labels, light, TUNING.classification)
    assert (found[:100] == SKY).all() and (found[101:] == USE).all()
    flat = _snapped(labels, np.full((240, 640), 128, np.uint8), TUNING.classification)
    assert (flat == labels).all(), "no brightness tells: the edge stays"


def test_narrow_strips_are_no_seeds():
    sky = np.zeros((100, 320), bool)
    sky[:30, :200] = True
    sky[30:90, 100:120] = True  # a border that ran down a pale wall
    wide = _wide(sky, TUNING.labels)
    assert (wide[:30, :200]).all() and not wide[30:].any()


@pytest.mark.parametrize("bottom, cloud", [(100, True), (200, False)])
def test_a_pale_piece_that_matches_is_a_cloud_above_the_horizon_and_a_wall_below_it(bottom, cloud):
    image = np.full((240, 320, 3), 40, np.uint8)
    image[:90] = 180  # the sky, of which the right part is not known yet
    image[60:bottom, 200:] = 230
    sky = np.zeros((240, 320), bool)
    sky[:60] = True
    across, down = np.meshgrid(np.linspace(0.65, 0.95, 12), np.linspace(0.3, 0.4, 8))
    xy = np.stack([across.ravel(), down.ravel()], axis=1).astype(np.float32)
    seen = Matchability(Path("a.jpg"), xy, np.ones(len(xy), bool), np.ones(len(xy)))
    found = _like_sky(image, sky, seen, TUNING.labels, lowest=60 / 240)
    assert found[65:90, 210:310].all() == cloud
    assert not found[:60].any() and not _like_sky(image, sky & False, seen, TUNING.labels, 0.3).any()


def test_the_lowest_sky_is_what_several_images_agree_on():
    rows = [0.0] * 20 + [0.3, 0.31, 0.33, 0.42, 0.43, 0.46]
    assert lowest_agreed([*rows, 1.0], TUNING.labels) == pytest.approx(0.46), "a border found on a road is alone"
    assert lowest_agreed([*rows, 0.99, 1.0], TUNING.labels) == pytest.approx(1.0)
    assert lowest_agreed([0.0, 0.4], TUNING.labels) == pytest.approx(0.4)
    assert lowest_agreed([], TUNING.labels) == lowest_agreed([0.0], TUNING.labels) == 0


def _street(fisheye):
    image = np.full((240, 320, 3), (235, 200, 170), np.uint8)
    image[100:] = np.random.default_rng(0).uniform(20, 120, (140, 320, 3)).astype(np.uint8)
    if fisheye:
        image[(np.hypot(*np.meshgrid(np.arange(320) - 160, np.arange(240) - 120)) > 118)] = 0
    return image


def test_the_sky_begins_below_the_surround_of_a_fisheye_lens():
    image = _street(fisheye=True)
    surround = (image == 0).all(axis=2)
    assert border_sky(image, TUNING.skyline) is None
    sky = border_sky(image, TUNING.skyline, surround)
    assert sky[20:90, 130:190].all() and not sky[105:].any() and not (sky & surround).any()


def test_sand_is_no_sky():
    image = _street(fisheye=False)
    assert border_sky(image, TUNING.skyline) is not None
    image[:100] = (150, 200, 220)
    assert border_sky(image, TUNING.skyline) is None
