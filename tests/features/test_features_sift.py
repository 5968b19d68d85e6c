"""SIFT: place, scale, normalisation, masks, limits, order, and images of little contrast."""

import cv2
import numpy as np
import pytest

from tiegraph.errors import InputError
from tiegraph.features import sift
from tiegraph.features.preview import extract_preview
from tiegraph.features.settings import FeaturesSettings, PreviewSettings
from tiegraph.features.sift import (
    contrast,
    evened,
    extract_image,
    extract_sift,
    read_mask,
    root_sift,
)
from tiegraph.features.tuning import SiftTuning, Tuning

SETTINGS, TUNING = FeaturesSettings(), SiftTuning()


def blobs(size=(360, 400), seed=0):
    """Image (H, W) u1 of Gaussian blobs at known places (N, 2), corner convention, with known sigmas (N,)."""
    rng = np.random.default_rng(seed)
    height, width = size
    y, x = np.mgrid[:height, :width] + 0.5
    image, places, sigmas = np.full(size, 60.0), [], []
    for v in range(30, height - 25, 40):
        for u in range(30, width - 25, 40):
            place, sigma = (u + rng.random(), v + rng.random()), rng.uniform(2, 5)
            image += 120 * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / 2 / sigma**2)
            places.append(place)
            sigmas.append(sigma)
    return np.clip(image, 0, 255).round().astype(np.uint8), np.array(places), np.array(sigmas)


def nearest(keypoints, places):
    distance = np.linalg.norm(keypoints[:, None, :2] - places[None], axis=2)
    found = distance.min(axis=0) < 1.5
    return distance.argmin(axis=0)[found], found


def texture(height=240, width=320, seed=1):
    noise = np.random.default_rng(seed).random((height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


@pytest.mark.slow
def test_blobs_are_found_where_they_are_in_the_corner_convention():
    image, places, sigmas = blobs()
    keypoints, descriptors = extract_sift(image, None, SETTINGS, TUNING)
    at, found = nearest(keypoints, places)
    error_px = keypoints[at, :2] - places[found]
    assert found.mean() > 0.9
    assert np.abs(error_px.mean(axis=0)).max() < 0.02  # OpenCV's own default: 0.25
    assert 0 < error_px.std() < 0.05
    assert 0.8 < np.median(keypoints[at, 2] / sigmas[found]) < 1.0  # a blob peaks at sigma less the assumed blur
    assert descriptors.shape == (len(keypoints), 128)


@pytest.mark.slow
def test_shrunk_images_give_positions_of_the_full_image():
    image, places, _ = blobs((360, 401))
    big = cv2.resize(image, (802, 720), interpolation=cv2.INTER_CUBIC)
    keypoints, _ = extract_sift(big, None, FeaturesSettings(max_image_size=401), TUNING)
    at, found = nearest(keypoints / 2, places)
    assert found.mean() > 0.8
    assert np.abs((keypoints[at, :2] / 2 - places[found]).mean(axis=0)).max() < 0.03


def test_root_sift_has_colmaps_length_and_survives_zeros():
    vectors = np.random.default_rng(0).gamma(0.5, 40, (50, 128))
    assert np.abs(np.linalg.norm(root_sift(vectors).astype(float), axis=1) - 512).max() < 3
    assert root_sift(np.zeros((1, 128))).sum() == 0


@pytest.mark.slow
def test_no_support_reaches_into_the_mask():
    image = texture(360, 480)
    mask = np.zeros(image.shape, bool)
    mask[:220, 50:] = True
    free, _ = extract_sift(image, None, SETTINGS, TUNING)
    keypoints, descriptors = extract_sift(image, mask, SETTINGS, TUNING)
    inside = (free[:, 1] < 220) & (free[:, 0] >= 50)
    whole = np.minimum(220 - free[:, 1], free[:, 0] - 50) > TUNING.support_sigmas * free[:, 2] + 1
    assert whole.sum() > TUNING.enough_free
    assert whole.sum() <= len(keypoints) == len(descriptors) < inside.sum()
    margin = np.minimum(220 - keypoints[:, 1], keypoints[:, 0] - 50)
    assert np.all(margin > TUNING.support_sigmas * keypoints[:, 2] - 1)


@pytest.mark.slow
def test_few_features_are_all_kept_that_lie_on_free_pixels():
    image = texture()
    mask = np.zeros(image.shape, bool)
    mask[:100, 50:] = True
    free, _ = extract_sift(image, None, SETTINGS, TUNING)
    keypoints, descriptors = extract_sift(image, mask, SETTINGS, TUNING)
    inside = (free[:, 1] < 100) & (free[:, 0] >= 50)
    assert len(keypoints) == len(descriptors) == inside.sum() > 20


@pytest.mark.slow
def test_masked_features_do_not_use_up_the_limit():
    image = texture()
    mask = np.zeros(image.shape, bool)
    mask[:120] = True
    keypoints, _ = extract_sift(image, mask, FeaturesSettings(max_features=192), TUNING)
    assert len(keypoints) == 64  # a third of what a large image keeps
    assert keypoints[:, 1].max() < 120


@pytest.mark.slow
def test_the_features_under_a_mask_are_those_of_the_whole_image_cut_to_the_limit_last():
    image, limit = texture(480, 640), FeaturesSettings(max_features=192)
    tuning = SiftTuning(enough_free=20, enough_found=1e9)  # always doubled
    half, corner, strip = np.zeros((3, *image.shape), bool)
    half[:, 320:], corner[100:200, 100:200], strip[:, :150] = True, True, True
    image[:, :150] = 100 + image[:, :150] // 8  # faint: few of the clearest lie there
    everything, described = extract_sift(image, None, FeaturesSettings(max_features=65536), tuning)
    assert len(everything) > 500
    for mask in (None, np.ones_like(half), half, corner, strip):
        keypoints, descriptors = extract_sift(image, mask, limit, tuning)
        kept = np.flatnonzero(sift.on_mask(everything, mask, tuning))[:64]
        assert np.array_equal(keypoints, everything[kept]) and np.array_equal(descriptors, described[kept])


def found_again(one, other):
    """Share of the key points (K, 2) of one image that another has within a pixel and a half."""
    matches = cv2.BFMatcher().match(one.astype(np.float32), other.astype(np.float32))
    return np.mean([m.distance < 1.5 for m in matches])


@pytest.mark.slow
def test_what_is_kept_of_a_noisy_image_is_the_scene_and_not_its_noise():
    """Two photographs of a soft scene, each with its own noise."""
    scene = 100 + cv2.resize(texture(150, 200), (1600, 1200), interpolation=cv2.INTER_CUBIC) / 4
    rng = np.random.default_rng(3)
    images = [np.clip(scene + rng.normal(0, 8, scene.shape), 0, 255).astype(np.uint8) for _ in range(2)]
    ours = [extract_sift(x, None, FeaturesSettings(max_features=700), TUNING)[0][:, :2] for x in images]
    detector = cv2.SIFT.create(nfeatures=len(ours[0]), contrastThreshold=SETTINGS.contrast)
    strongest = [np.array([k.pt for k in detector.detect(x)]) for x in images]
    assert found_again(*ours) > 0.6 and found_again(*strongest) < 0.3


def test_images_keep_features_in_proportion_to_their_pixels():
    most = sift.most_features(np.array([0.3, 1.5, 3.0, 4.5, 48.0]), 12288, TUNING)
    assert most.tolist() == [4096, 4096, 8192, 12288, 12288]


@pytest.mark.slow
def test_blank_or_fully_masked_images_give_none():
    for image, mask in ((np.full((90, 120), 7, np.uint8), None), (texture(), np.zeros((240, 320), bool))):
        keypoints, descriptors = extract_sift(image, mask, SETTINGS, TUNING)
        assert keypoints.shape == (0, 4) and keypoints.dtype == np.float32
        assert descriptors.shape == (0, 128) and descriptors.dtype == np.uint8


@pytest.mark.slow
def test_threads_do_not_change_the_order():
    before, found = cv2.getNumThreads(), []
    try:
        for threads in (1, 4):
            cv2.setNumThreads(threads)
            found.append(extract_sift(texture(), None, SETTINGS, TUNING))
    finally:
        cv2.setNumThreads(before)
    assert all(np.array_equal(one, four) for one, four in zip(*found))


def test_wrong_arrays_are_refused():
    with pytest.raises(ValueError, match="grey 8-bit"):
        extract_sift(np.zeros((10, 10, 3), np.uint8), None, SETTINGS, TUNING)
    with pytest.raises(ValueError, match="mask"):
        extract_sift(np.zeros((10, 12), np.uint8), np.ones((12, 10), bool), SETTINGS, TUNING)


def test_files_are_read_with_their_mask(tmp_path):
    image = texture()
    mask = np.zeros(image.shape, np.uint8)
    mask[:, :100] = 1  # any value but 0 counts as use, as in COLMAP
    cv2.imwrite(str(tmp_path / "a.png"), image)
    cv2.imwrite(str(tmp_path / "a.png.png"), mask)
    keypoints, _ = extract_image(tmp_path / "a.png", tmp_path / "a.png.png", SETTINGS, Tuning())
    assert 0 < len(keypoints) and keypoints[:, 0].max() < 100


def test_file_errors_name_the_file_and_a_remedy(tmp_path):
    (tmp_path / "broken.jpg").write_bytes(b"no image")
    cv2.imwrite(str(tmp_path / "m.png"), np.zeros((5, 8), np.uint8))
    with pytest.raises(InputError, match="broken.jpg cannot be read"):
        extract_image(tmp_path / "broken.jpg", None, SETTINGS, Tuning())
    for file, said in (
        ("a.png.png", "a.png.png is missing"), ("broken.jpg", "broken.jpg cannot be read"),
        ("m.png", "m.png is 8x5, its image 16x10 pixels"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            read_mask(tmp_path / file, (10, 16))


DIM = Tuning()


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
    assert 0.6 * levels < contrast(view(levels), DIM.contrast) < 1.5 * levels
    assert contrast(np.full((480, 640), 77, np.uint8), DIM.contrast) == 0


@pytest.mark.slow
def test_only_what_shows_little_is_evened() -> None:
    clear, dim = view(20), view(4)
    assert evened(clear, DIM.contrast) is clear
    assert contrast(evened(dim, DIM.contrast), DIM.contrast) > 2 * contrast(dim, DIM.contrast)
    never = DIM.contrast.model_copy(update={"enough": 0.0})
    assert evened(dim, never) is dim


@pytest.mark.slow
def test_dim_images_are_tied_by_their_texture_and_not_by_their_noise() -> None:
    """As it is a dim view shows a handful of features; evened it has hundreds, and they move as the texture did."""
    asked = FeaturesSettings()
    plain = extract_sift(view(3), None, asked, DIM.sift)[0]
    first, second = (extract_sift(evened(view(3, s), DIM.contrast), None, asked, DIM.sift) for s in (0, 24))
    assert len(first[0]) > 5 * max(len(plain), 20)
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(first[1].astype(np.float32), second[1].astype(np.float32), k=2)
    good = [a for a, b in pairs if a.distance < 0.8 * b.distance]
    moved = np.array([first[0][m.queryIdx, :2] - second[0][m.trainIdx, :2] for m in good])
    assert len(good) > 150 and np.mean(np.linalg.norm(moved - [24, 0], axis=1) < 1.5) > 0.8


@pytest.mark.slow
def test_a_preview_of_a_dim_image_has_features_and_the_brightness_of_the_image_itself() -> None:
    dim = view(3)
    found = extract_preview(dim, None, PreviewSettings(), DIM)
    never = DIM.model_copy(update={"contrast": DIM.contrast.model_copy(update={"enough": 0.0})})
    plain = extract_preview(dim, None, PreviewSettings(), never)
    assert len(found) > 5 * max(len(plain), 20)
    assert found.brightness == plain.brightness == pytest.approx(65, abs=2)
    np.testing.assert_array_equal(found.shares, plain.shares)
