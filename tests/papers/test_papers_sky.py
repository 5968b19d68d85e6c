import cv2
import numpy as np

from masks_world import CLOUD_BGR, DECK, HORIZON, SHAPE, frame, share
from tiegraph.masks.frames import grey
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Meguro2025Tuning
from tiegraph.papers.meguro2025 import blue_sky, edge_sky, final_mask

SETTINGS = MasksSettings()
TUNING = Meguro2025Tuning()


def test_sky_goes_down_to_the_first_strong_edge_of_each_column():
    image = np.full((60, 40), 200, np.uint8)
    image[20:, :20] = 90
    image[35:, 20:] = 90
    sky = edge_sky(image, 8)
    assert (sky[:, :18].sum(axis=0) == 19).all() and (sky[:, 22:].sum(axis=0) == 34).all()


def test_edge_strength_is_in_grey_levels_a_pixel():
    ramp = np.repeat(np.arange(100, 200, 5, dtype=np.uint8)[:, None], 30, axis=1)
    assert edge_sky(ramp, 5.1)[:18].all()
    assert not edge_sky(ramp, 4.9)[1:].any()


def test_a_column_without_an_edge_is_sky():
    assert edge_sky(np.full((30, 30), 120, np.uint8), 8).all()


def test_blue_range():
    sky, wall, shade, grass = (220, 150, 90), (120, 160, 200), (210, 195, 180), (60, 180, 90)
    assert blue_sky(np.uint8([[sky, wall, shade, grass]]), TUNING).tolist() == [[True, False, False, False]]
    assert not blue_sky(cv2.merge([grey(frame(0))] * 3), TUNING).any()


def test_final_mask_takes_sky_and_burnt_out_areas_and_leaves_the_scene():
    image = frame(0)
    image[20:40, 50:120] = CLOUD_BGR
    image[100:132, 200:232] = SETTINGS.overexposed
    mask = final_mask(image, None, SETTINGS, TUNING)
    assert mask.shape == SHAPE
    assert share(mask, slice(0, HORIZON - 8)) < 0.15
    assert not mask[104:128, 204:228].any()
    assert 0.9 < share(mask, slice(HORIZON + 8, None)) < 1.0


def test_a_sky_that_is_not_blue_is_masked_down_to_its_edge():
    image = np.full((*SHAPE, 3), 180, np.uint8)  # cloudy, and below what is burnt out
    image[HORIZON:] = frame(0)[HORIZON:]
    assert not blue_sky(image[:HORIZON], TUNING).any()
    mask = final_mask(image, None, SETTINGS, TUNING)
    assert share(mask, slice(0, HORIZON - 8)) == 0
    assert share(mask, slice(HORIZON + 8, None)) > 0.95


def test_a_block_is_masked_from_half_of_its_pixels_on():
    grain = np.random.default_rng(0).integers(0, 2, (32, 64)) * 100
    image = np.repeat(grain.astype(np.uint8)[..., None], 3, axis=2)  # edges everywhere: no sky
    image[8:16, 16:19] = 255  # three of a block's eight columns are burnt out
    image[8:16, 40:44] = 255  # four of them
    mask = final_mask(image, None, SETTINGS, TUNING)[8:]
    masked = np.zeros_like(mask)
    masked[:8, 40:48] = True
    assert (TUNING.block_px, TUNING.min_block) == (8, 0.5)
    np.testing.assert_array_equal(~mask, masked)


def test_final_mask_merges_the_initial_one():
    initial = np.ones(SHAPE, bool)
    initial[DECK:] = False
    mask = final_mask(frame(0), initial, SETTINGS, TUNING)
    assert share(mask, slice(DECK + 8, None)) == 0
    assert share(mask, slice(HORIZON + 8, DECK - 8)) > 0.9


def test_result_is_made_of_whole_blocks():
    mask = final_mask(frame(0), None, SETTINGS, TUNING)
    blocks = mask.reshape(SHAPE[0] // 8, 8, SHAPE[1] // 8, 8).mean(axis=(1, 3))
    assert set(np.unique(blocks)) <= {0.0, 1.0}
