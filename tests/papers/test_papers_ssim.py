import numpy as np
import pytest

from masks_world import DECK, HORIZON, frame, sequence, share
from tiegraph.masks.frames import grey
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Tuning
from tiegraph.papers import meguro2025 as module
from tiegraph.papers.meguro2025 import initial_mask, prepare_ssim, ssim

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
