"""Images that show little contrast: measured, evened, and tied by what stands above their noise."""

import cv2
import numpy as np
import pytest

from tiegraph.features.preview import extract_preview
from tiegraph.features.settings import FeaturesSettings, PreviewSettings
from tiegraph.features.sift import contrast, evened, extract_sift
from tiegraph.features.tuning import Tuning

TUNING = Tuning()


def view(levels: float, shift: int = 0, noise: float = 0.7) -> np.ndarray:
    """(480, 640) u1 of a texture of many scales, moved by ``shift`` columns, that shows so much contrast, lit from the
    left; with noise of its own."""
    rng = np.random.default_rng(0)
    texture = sum(cv2.GaussianBlur(rng.normal(size=(480, 760)), (0, 0), s) * s for s in (1.5, 3, 6))
    seen = texture[:, 40 + shift : 680 + shift]
    lamp = np.linspace(90, 40, 640)[None]
    own = np.random.default_rng(100 + shift).normal(size=seen.shape) * noise
    return np.clip(np.rint(lamp + levels * seen / seen.std() + own), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("levels", [3.0, 6.0, 20.0])
def test_contrast_is_what_a_tenth_of_the_blocks_show(levels: float) -> None:
    assert 0.6 * levels < contrast(view(levels), TUNING.contrast) < 1.5 * levels
    assert contrast(np.full((480, 640), 77, np.uint8), TUNING.contrast) == 0


def test_only_what_shows_little_is_evened() -> None:
    clear, dim = view(20), view(4)
    assert evened(clear, TUNING.contrast) is clear
    assert contrast(evened(dim, TUNING.contrast), TUNING.contrast) > 2 * contrast(dim, TUNING.contrast)
    never = TUNING.contrast.model_copy(update={"enough": 0.0})
    assert evened(dim, never) is dim


def test_dim_images_are_tied_by_their_texture_and_not_by_their_noise() -> None:
    """As it is a dim view shows a handful of features; evened it has hundreds, and they move as the texture did."""
    asked = FeaturesSettings()
    plain = extract_sift(view(3), None, asked, TUNING.sift)[0]
    first, second = (extract_sift(evened(view(3, s), TUNING.contrast), None, asked, TUNING.sift) for s in (0, 24))
    assert len(first[0]) > 5 * max(len(plain), 20)
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(first[1].astype(np.float32), second[1].astype(np.float32), k=2)
    good = [a for a, b in pairs if a.distance < 0.8 * b.distance]
    moved = np.array([first[0][m.queryIdx, :2] - second[0][m.trainIdx, :2] for m in good])
    assert len(good) > 150 and np.mean(np.linalg.norm(moved - [24, 0], axis=1) < 1.5) > 0.8


def test_a_preview_of_a_dim_image_has_features_and_the_brightness_of_the_image_itself() -> None:
    dim = view(3)
    found = extract_preview(dim, None, PreviewSettings(), TUNING)
    never = TUNING.model_copy(update={"contrast": TUNING.contrast.model_copy(update={"enough": 0.0})})
    plain = extract_preview(dim, None, PreviewSettings(), never)
    assert len(found) > 5 * max(len(plain), 20)
    assert found.brightness == plain.brightness == pytest.approx(65, abs=2)
    np.testing.assert_array_equal(found.shares, plain.shares)
