import numpy as np
import pytest

from tiegraph.masks import EGO, SKY, USE, WATER
from tiegraph.masks.tuning import WaterlineTuning
from tiegraph.masks.waterline import Lines, View, columns, final_classes, find_water, first_line, lines_of

TUNING = WaterlineTuning()
SHAPE, FOCAL = (240, 320), 200.0
DEPTH, BANK = 2.0, 10.0  # water below the cameras, banks to both sides; up = z, the boat goes along y


def view(y, yaw_deg):
    across, down = np.meshgrid(columns(SHAPE[1], TUNING) + 0.5 - SHAPE[1] / 2, np.arange(SHAPE[0]) + 0.5 - SHAPE[0] / 2)
    rays = np.stack([across, down, np.full(across.shape, FOCAL)], axis=-1)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    world_from_camera = np.array([[c, 0, s], [-s, 0, c], [0, -1, 0]])  # right, down, forward -> east, north, up
    return View(rays @ world_from_camera.T, np.array([0.0, y, 0.0]))


def true_line(v):
    """Row of the water's edge at each column, NaN where it is too far."""
    flat = np.abs(v.rays[SHAPE[0] // 2, :, 0]) / np.linalg.norm(v.rays[SHAPE[0] // 2, :, :2], axis=1)
    distance = BANK / flat
    slope = v.slopes(np.array([0, 0, 1.0]))
    row = (slope < -DEPTH / distance).argmax(axis=0).astype(float)
    return np.where(distance < 40, row, np.nan)


@pytest.fixture(scope="module")
def survey():
    rng = np.random.default_rng(0)
    walls = [np.c_[np.full(4000, x), rng.uniform(-40, 60, 4000), rng.uniform(-DEPTH, 3, 4000)] for x in (-BANK, BANK)]
    points = np.concatenate(walls) + rng.normal(0, 0.02, (8000, 3))
    return [view(y, yaw) for y in np.arange(0, 20, 2.0) for yaw in (60, 90, -90, -60)], points


UP = np.array([0, 0, 1.0])


def test_level_of_the_water_in_spite_of_wrong_first_masks(survey):
    views, points = survey
    rng = np.random.default_rng(1)
    lines = [true_line(v) + rng.normal(0, 5, len(true_line(v))) for v in views]
    water = find_water(views, lines, points, UP, TUNING)
    assert water is not None and 0 < abs(water.depth - DEPTH) < 0.1 and water.rays > 500
    errors = np.concatenate([lines_of(v, UP, water).water - true_line(v) for v in views])
    assert 0 < np.nanpercentile(np.abs(errors), 90) < 4


def test_no_level_without_agreement(survey):
    views, points = survey
    rng = np.random.default_rng(1)
    nothing = [np.full(len(true_line(v)), np.nan) for v in views]
    wild = [rng.uniform(125, 239, len(line)) for line in nothing]
    assert find_water(views, nothing, points, UP, TUNING) is None
    assert find_water(views, wild, points, UP, TUNING) is None
    assert find_water([], [], points, UP, TUNING) is None
    assert find_water(views, wild, np.zeros((0, 3)), UP, TUNING) is None
    assert find_water(views, wild, points + [0, 0, 50], UP, TUNING) is None


def test_final_classes(survey):
    views, points = survey
    water = find_water(views, [true_line(v) for v in views], points, UP, TUNING)
    first = np.full(SHAPE, USE, np.uint8)
    first[:60] = SKY
    first[190:] = WATER
    first[200:210, :50] = SKY
    first[220:] = EGO
    lines = lines_of(views[1], UP, water)
    found = final_classes(first, lines, TUNING)
    row = int(np.nanmedian(true_line(views[1])))
    assert (found[:60] == SKY).all() and (found[220:] == EGO).all()
    assert (found[row + 4 : 220] == WATER).all() and (found[60 : row - 4] == USE).all()
    dry = final_classes(first, lines_of(views[1], UP, None), TUNING)
    assert (dry[190:200] == WATER).all() and not (dry[130:] == SKY).any()


def test_first_line_ignores_what_the_platform_hides():
    classes = np.full((40, 32), USE, np.uint8)
    classes[20:] = WATER
    classes[10:20, :16] = EGO
    line = first_line(classes, TUNING)
    assert np.isnan(line[:2]).all() and (line[2:] == 20).all()
    assert np.isnan(first_line(np.zeros((40, 32), np.uint8), TUNING)).all()


def test_gaps_in_the_banks_are_bridged_and_their_ends_are_not():
    first = np.full((60, 320), USE, np.uint8)
    line = np.full(40, 30.0)
    line[10:16] = np.nan  # a pier without points
    line[:4] = np.nan  # nothing is known there
    found = final_classes(first, Lines(line, np.zeros(40)), TUNING)
    assert (found[35:, 80:130] == WATER).all() and (found[:28] == USE).all()
    assert (found[:, :16] == USE).all()
    open_water = np.full(40, np.nan)
    open_water[[0, 39]] = 30.0  # too wide to bridge
    assert (final_classes(first, Lines(open_water, np.zeros(40)), TUNING)[:, 80:240] == USE).all()
