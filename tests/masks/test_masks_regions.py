import cv2
import numpy as np
import pytest

from tiegraph.masks.classes import SKY, USE
from tiegraph.masks.lookup import _snapped
from tiegraph.masks.regions import calm_regions, pooled
from tiegraph.masks.seeds import _wide


def test_regions_end_at_edges_and_hold_soft_clouds():
    image = np.full((200, 320), 180, np.float32)
    image[:90] += 25 * np.sin(np.linspace(0, 6, 320))[None]  # clouds: a few grey levels a pixel at most
    image[90:] = 100
    regions = calm_regions(np.clip(image, 0, 255).astype(np.uint8))
    above, below = regions[5:85], regions[95:195]
    assert (above == above[0, 0]).all() and (below == below[0, 0]).all() and 0 < above[0, 0] != below[0, 0] > 0
    assert (regions[89:91] == 0).any(), "the edge itself is of no region"


def test_a_region_is_judged_as_one():
    regions = np.zeros((10, 10), np.int32)
    regions[:, :5], regions[:, 6:] = 1, 2
    ratio = np.full((10, 10), 2.0, np.float32)
    ratio[:, 6:] = -9.0  # clipped: no single pixel outweighs all others
    mean = pooled(ratio, regions)
    assert mean[0, 0] == pytest.approx(2) and mean[0, 9] == pytest.approx(-3) and (mean[:, 5] == 0).all()


def test_the_edge_of_the_sky_snaps_to_the_brightness():
    light = np.full((240, 640), 90, np.uint8)
    light[:100] = 200
    light = cv2.GaussianBlur(light, (3, 3), 0)
    labels = np.full((240, 640), USE, np.uint8)
    labels[:98] = SKY  # two pixels short
    found = _snapped(labels, light)
    assert (found[:100] == SKY).all() and (found[101:] == USE).all()
    flat = _snapped(labels, np.full((240, 640), 128, np.uint8))
    assert (flat == labels).all(), "no brightness tells: the edge stays"


def test_narrow_strips_are_no_seeds():
    sky = np.zeros((100, 320), bool)
    sky[:30, :200] = True
    sky[30:90, 100:120] = True  # a border that ran down a pale wall
    wide = _wide(sky)
    assert (wide[:30, :200]).all() and not wide[30:].any()
