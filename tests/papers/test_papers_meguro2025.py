"""Paper 001: the initial mask by structural similarity, then sky and what is burnt out."""

import cv2
import numpy as np
import pytest

from masks_world import CLOUD_BGR, DECK, HORIZON, SHAPE, frame, sequence, share
from tiegraph.masks.frames import grey
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Meguro2025Tuning, Tuning
from tiegraph.papers import meguro2025 as module
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
        initial_mask(grey(frame(0)), grey(frame(1, gain=0.8)), settings.similarity, TUNING.meguro2025),
    ):
        assert share(mask, slice(DECK + 8, None)) < 0.05
        assert share(mask, slice(HORIZON + 8, DECK - 8)) > 0.9


def test_steps_after_the_threshold(monkeypatch):
    similar = np.zeros((160, 160), np.float32)
    similar[:80] = 1  # a large region
    similar[40:48, 40:48] = 0  # with a hole of one block: four masked neighbours, filled
    similar[120:136, 120:136] = 1  # a region of four blocks: too small
    similar[80:83, :] = 1  # 3 of 8 rows of the next blocks: under half, excluded
    monkeypatch.setattr(module, "ssim", lambda a, b: similar)
    mask = initial_mask(np.zeros((160, 160), np.uint8), np.zeros((160, 160), np.uint8), 0.6, TUNING.meguro2025)
    assert TUNING.meguro2025.block_px == 8
    assert not mask[:80].any() and mask[80:].all()


def test_one_frame_has_no_initial_mask(tmp_path):
    assert prepare_ssim(sequence(tmp_path, 1), MasksSettings(), TUNING) is None


SETTINGS = MasksSettings()
PAPER = Meguro2025Tuning()


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


def test_result_is_made_of_whole_blocks():
    mask = final_mask(frame(0), None, SETTINGS, PAPER)
    blocks = mask.reshape(SHAPE[0] // 8, 8, SHAPE[1] // 8, 8).mean(axis=(1, 3))
    assert set(np.unique(blocks)) <= {0.0, 1.0}
