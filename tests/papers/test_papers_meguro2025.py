"""The masks of papers 000 and 001: background difference, structural similarity, sky and what is burnt out."""

import cv2
import numpy as np
import pytest

from masks_world import CLOUD_BGR, DECK, HORIZON, SHAPE, frame, sequence, share
from tiegraph.masks.frames import block_share, from_blocks, grey, masked_neighbours, opened_closed, without_small
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.sources import Camera
from tiegraph.masks.tuning import PapersTuning, Tuning
from tiegraph.papers import meguro2025 as module
from tiegraph.papers.meguro2024 import difference_mask, mask_of_camera, prepare, prepare_difference
from tiegraph.papers.meguro2025 import blue_sky, edge_sky, final_mask, initial_mask, prepare_ssim, ssim

TUNING = Tuning()
C1, C2 = 6.5025, 58.5225  # (0.01 * 255)^2, (0.03 * 255)^2


def test_ssim_at_a_pixel_equals_the_definition():
    rng = np.random.default_rng(3)
    a, b = rng.integers(0, 256, (2, 40, 50)).astype(np.uint8)
    y, x = 17, 23
    r = np.arange(-5, 6)
    w = np.exp(-(r[:, None] ** 2 + r[None] ** 2) / (2 * 1.5**2))
    w /= w.sum()
    p, q = (i[y - 5 : y + 6, x - 5 : x + 6].astype(float) for i in (a, b))
    mp, mq = (w * p).sum(), (w * q).sum()
    vp, vq, c = (w * (p - mp) ** 2).sum(), (w * (q - mq) ** 2).sum(), (w * (p - mp) * (q - mq)).sum()
    expected = (2 * mp * mq + C1) * (2 * c + C2) / ((mp**2 + mq**2 + C1) * (vp + vq + C2))
    assert ssim(a, b)[y, x] == pytest.approx(expected, abs=1e-4)


def test_ssim_of_equal_inverted_and_flat_images():
    a = grey(frame(0))
    assert np.allclose(ssim(a, a), 1, atol=1e-4)
    assert ssim(a, 255 - a)[HORIZON + 10 : DECK - 10].mean() < 0
    flat = ssim(np.full((30, 30), 100, np.uint8), np.full((30, 30), 140, np.uint8))
    assert np.allclose(flat, (2 * 100 * 140 + C1) / (100**2 + 140**2 + C1), atol=1e-3)
    dark = ssim(np.full((30, 30), 2, np.uint8), np.full((30, 30), 6, np.uint8))
    assert np.allclose(dark, (2 * 2 * 6 + C1) / (2**2 + 6**2 + C1), atol=1e-3)


def test_initial_mask_separates_the_platform_even_when_the_light_changes(tmp_path):
    settings = MasksSettings()
    for mask in (
        prepare_ssim(sequence(tmp_path), settings, TUNING),
        initial_mask(grey(frame(0)), grey(frame(1, gain=0.8)), settings.similarity, TUNING.papers),
    ):
        assert share(mask, slice(DECK + 8, None)) < 0.05
        assert share(mask, slice(HORIZON + 8, DECK - 8)) > 0.9


def test_steps_after_the_threshold(monkeypatch):
    similar = np.zeros((160, 160), np.float32)
    similar[:80] = 1  # a large region
    similar[40:48, 40:48] = 0  # with a hole of one block: four masked neighbours, filled
    similar[120:128, 120:128] = 1  # a region of one block: too small
    similar[80:83, :] = 1  # 3 of 8 rows of the next blocks: under half, excluded
    monkeypatch.setattr(module, "ssim", lambda a, b: similar)
    mask = initial_mask(np.zeros((160, 160), np.uint8), np.zeros((160, 160), np.uint8), 0.6, TUNING.papers)
    assert TUNING.papers.block_px == 8
    assert not mask[:80].any() and mask[80:].all()


def test_one_frame_has_no_initial_mask(tmp_path):
    assert prepare_ssim(sequence(tmp_path, 1), MasksSettings(), TUNING) is None


SETTINGS = MasksSettings()
PAPER = PapersTuning()


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
    assert blue_sky(np.uint8([[sky, wall, shade, grass]]), PAPER).tolist() == [[True, False, False, False]]
    assert not blue_sky(cv2.merge([grey(frame(0))] * 3), PAPER).any()


def test_final_mask_takes_sky_and_burnt_out_areas_and_leaves_the_scene():
    image = frame(0)
    image[20:40, 50:120] = CLOUD_BGR
    image[100:132, 200:232] = SETTINGS.overexposed
    mask = final_mask(image, None, SETTINGS, PAPER)
    assert mask.shape == SHAPE
    assert share(mask, slice(0, HORIZON - 8)) < 0.15
    assert not mask[104:128, 204:228].any()
    assert 0.9 < share(mask, slice(HORIZON + 8, None)) < 1.0


def test_a_sky_that_is_not_blue_is_masked_down_to_its_edge():
    image = np.full((*SHAPE, 3), 180, np.uint8)  # cloudy, and below what is burnt out
    image[HORIZON:] = frame(0)[HORIZON:]
    assert not blue_sky(image[:HORIZON], PAPER).any()
    mask = final_mask(image, None, SETTINGS, PAPER)
    assert share(mask, slice(0, HORIZON - 8)) == 0
    assert share(mask, slice(HORIZON + 8, None)) > 0.95


def test_a_block_is_masked_from_half_of_its_pixels_on():
    grain = np.random.default_rng(0).integers(0, 2, (32, 64)) * 100
    image = np.repeat(grain.astype(np.uint8)[..., None], 3, axis=2)  # edges everywhere: no sky
    image[8:16, 16:19] = 255  # three of a block's eight columns are burnt out
    image[8:16, 40:44] = 255  # four of them
    mask = final_mask(image, None, SETTINGS, PAPER)[8:]
    masked = np.zeros_like(mask)
    masked[:8, 40:48] = True
    assert (PAPER.block_px, PAPER.min_block) == (8, 0.5)
    np.testing.assert_array_equal(~mask, masked)


def test_final_mask_merges_the_initial_one():
    initial = np.ones(SHAPE, bool)
    initial[DECK:] = False
    mask = final_mask(frame(0), initial, SETTINGS, PAPER)
    assert share(mask, slice(DECK + 8, None)) == 0
    assert share(mask, slice(HORIZON + 8, DECK - 8)) > 0.9


def test_what_stays_is_masked_and_what_moves_is_used(tmp_path):
    mask = prepare_difference(sequence(tmp_path), MasksSettings(source="meguro2024"), TUNING)
    assert share(mask, slice(DECK + 8, None)) < 0.01
    assert share(mask, slice(0, HORIZON - 8)) < 0.01
    assert share(mask, slice(HORIZON + 8, DECK - 8)) > 0.9


def test_light_change_breaks_it_as_the_papers_method_does(tmp_path):
    a, b = grey(frame(0)), grey(frame(1, gain=0.8))
    assert share(difference_mask(a, b, 8, TUNING.papers), slice(DECK, None)) > 0.5


def test_nothing_of_a_camera_that_looks_up_is_used(tmp_path):
    """Paper 000: "the images from the five side cameras are used"."""
    images = tuple(sequence(tmp_path))
    both = prepare({0: Camera(images), 5: Camera(images, upward=True)}, MasksSettings(source="meguro2024"), TUNING)
    assert both[0].any() and not both[5].any() and both[0].shape == both[5].shape
    assert not mask_of_camera(images[0], both[5], MasksSettings(source="meguro2024"), TUNING, "").any()


def test_small_areas_of_both_colours_go():
    a = np.zeros((200, 200), np.uint8)
    b = a.copy()
    b[:, 100:] = 255  # right half differs
    b[50:62, 30:42] = 255  # a white island of 144 px, under 0.5 % of the image
    b[50:62, 150:162] = 0  # a black one
    mask = difference_mask(a, b, 20, TUNING.papers)
    assert not mask[:, :100].any() and mask[:, 100:].all()
    c = b.copy()
    c[20:50, 20:50] = 255  # 900 px stay
    assert difference_mask(a, c, 20, TUNING.papers)[35, 35]


def test_lines_thinner_than_the_square_go_however_long():
    a = np.zeros((200, 200), np.uint8)
    b = a.copy()
    b[:, 100:] = 255
    b[:, 40:45] = 255  # 1000 px of white, 5 px wide
    b[:, 150:155] = 0  # and of black
    mask = difference_mask(a, b, 20, TUNING.papers)
    assert TUNING.papers.square_px == 7
    assert not mask[:, :100].any() and mask[:, 100:].all()


def test_threshold_is_the_smallest_difference_used():
    a = np.full((64, 64), 100, np.uint8)
    assert difference_mask(a, a + np.uint8(20), 20, TUNING.papers).all()
    assert not difference_mask(a, a + np.uint8(19), 20, TUNING.papers).any()


def test_opening_before_closing():
    speck = np.zeros((40, 40), bool)
    speck[10:13, 10:13] = True
    assert not opened_closed(speck, 7).any()
    assert opened_closed(~speck, 7).all()
    stripes = np.tile(np.arange(40) % 4 == 0, (40, 1))  # closing first would join them
    assert not opened_closed(stripes, 7).any()


def test_without_small_counts_pixels_and_joins_corners():
    white = np.zeros((10, 10), bool)
    white[1, 1] = white[2, 2] = white[3, 3] = True
    assert without_small(white, 3).sum() == 3
    assert without_small(white, 4).sum() == 0
    assert without_small(np.zeros((5, 5), bool), 1).sum() == 0


def test_blocks_at_the_edges_are_counted_by_their_own_size():
    white = np.ones((20, 21), bool)
    white[:, 16:] = False
    shares = block_share(white, 8)
    assert shares.shape == (3, 3)
    assert (shares[:, :2] == 1).all() and (shares[:, 2] == 0).all()
    assert (from_blocks(shares > 0.5, 8, white.shape) == white).all()


def test_neighbours_share_a_side():
    blocks = np.array([[1, 1, 1], [1, 0, 0], [0, 0, 0]], bool)
    assert masked_neighbours(blocks).tolist() == [[2, 2, 1], [1, 2, 1], [1, 0, 0]]
