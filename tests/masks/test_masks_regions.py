from pathlib import Path

import cv2
import numpy as np
import pytest

from tiegraph.masks import SKY, USE
from tiegraph.masks.classification import _snapped, pooled, textureless_regions
from tiegraph.masks.labels import _like_sky, _wide
from tiegraph.masks.learnt import lowest_agreed
from tiegraph.masks.matchability import Matchability
from tiegraph.masks.skyline import border_sky
from tiegraph.masks.tuning import Tuning

TUNING = Tuning()


def test_regions_end_at_edges_and_hold_soft_clouds():
    image = np.full((200, 320), 180, np.float32)
    image[:90] += 25 * np.sin(np.linspace(0, 6, 320))[None]  # clouds: a few grey levels a pixel at most
    image[90:] = 100
    regions = textureless_regions(np.clip(image, 0, 255).astype(np.uint8), TUNING.regions)
    above, below = regions[5:85], regions[95:195]
    assert (above == above[0, 0]).all() and (below == below[0, 0]).all() and 0 < above[0, 0] != below[0, 0] > 0
    assert (regions[89:91] == 0).any(), "the edge itself is of no region"


def test_a_region_is_judged_as_one():
    regions = np.zeros((10, 10), np.int32)
    regions[:, :5], regions[:, 6:] = 1, 2
    ratio = np.full((10, 10), 2.0, np.float32)
    ratio[:, 6:] = -9.0  # clipped: no single pixel outweighs all others
    mean = pooled(ratio, regions, TUNING.regions)
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
    seen = Matchability(Path("a.jpg"), xy, np.ones(len(xy), bool))
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
