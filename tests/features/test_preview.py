"""Previews on a textured plane with known camera motion."""

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.features.matchers import rounded
from tiegraph.features.preview import Preview, PreviewMatch, extract_preview, match_previews, spread, tentative
from tiegraph.features.settings import PreviewSettings
from tiegraph.features.tuning import PreviewTuning, Tuning
from tiegraph.geometry.transforms import angle_deg

SETTINGS, TUNING = PreviewSettings(), PreviewTuning()
CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[500.0, 320.0, 240.0])
K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])


def texture(seed: int, size: int = 1400) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = np.full((size, size), 128, np.uint8)
    for _ in range(1500):
        x, y, w, h = rng.integers(0, size, 2).tolist() + rng.integers(6, 60, 2).tolist()
        cv2.rectangle(out, (x, y), (x + w, y + h), int(rng.integers(0, 255)), -1)
    return cv2.GaussianBlur(out, (0, 0), 1.0)


def view(paper: np.ndarray, rotation: np.ndarray, centre: tuple[float, float, float]) -> np.ndarray:
    """A corner of two planes (z = 4 m, the right half leaning away), so that the essential matrix is well defined."""
    rows, columns = np.mgrid[0:480, 0:640]
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones_like(rows)], axis=-1) @ np.linalg.inv(K).T @ rotation
    origin = np.array(centre)
    flat = (4.0 - origin[2]) / rays[..., 2]
    leaning = (4.0 - origin[2] - 0.8 * origin[0]) / (rays[..., 2] + 0.8 * rays[..., 0])
    length = np.where(origin[0] + flat * rays[..., 0] < 0, flat, leaning)
    point = origin + length[..., None] * rays
    u = (point[..., 0] * 150 + 700).astype(np.float32)
    v = (point[..., 1] * 150 + 700).astype(np.float32)
    return cv2.remap(paper, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def preview(image: np.ndarray, mask: np.ndarray | None = None) -> Preview:
    return extract_preview(image, mask, SETTINGS, Tuning())


def matched(a: Preview, b: Preview, camera: pycolmap.Camera = CAMERA) -> PreviewMatch:
    return match_previews(a, b, camera, camera, SETTINGS, TUNING)


@pytest.fixture(scope="module")
def views() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    turn = Rotation.from_euler("y", 8, degrees=True).as_matrix()
    paper = texture(1)
    return view(paper, np.eye(3), (0, 0, 0)), view(paper, turn, (0.6, 0.1, 0)), turn


@pytest.mark.slow
def test_two_views_of_one_place_match_with_their_rotation_and_shift(views) -> None:
    a, b = (preview(v) for v in views[:2])
    found = matched(a, b)
    assert 40 < found.inliers <= SETTINGS.features and angle_deg(found.rotation, views[2]) < 3.0
    assert matched(a, b).inliers == found.inliers
    there, back = (matched(p, q) for p, q in ((a, b), (b, a)))
    assert np.sign(there.shift[0]) == -np.sign(back.shift[0]) != 0
    assert abs(there.shift[0] + back.shift[0]) < 0.03
    guess = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 1.2 * max(a.width, a.height), a.width, a.height)
    known, guessed = (matched(a, b, c) for c in (CAMERA, guess))
    assert 0.6 * known.inliers < guessed.inliers < 1.6 * known.inliers


@pytest.mark.slow
def test_unrelated_images_stay_at_chance() -> None:
    previews = [preview(view(texture(s), np.eye(3), (0, 0, 0))) for s in range(2, 7)]
    counts = [matched(previews[a], previews[b]).inliers for a in range(5) for b in range(a)]
    assert max(counts) < 20 and np.median(counts) < 13


@pytest.mark.slow
def test_mask_keeps_features_out_and_brightness_whole(views) -> None:
    mask = np.zeros((480, 640), bool)
    mask[:, :320] = True
    whole, half = preview(views[0]), preview(views[0], mask)
    assert len(half) > 50 and half.xy[:, 0].max() <= 324 and whole.xy[:, 0].max() > 600
    assert half.brightness == whole.brightness and abs(whole.brightness - views[0].mean()) < 1
    assert abs(whole.shares.sum() - 1) < 1e-5


def test_pixels_are_full_size_and_count_from_the_corner() -> None:
    image = np.zeros((960, 1280), np.uint8)
    cv2.circle(image, (600, 400), 20, 255, -1)  # its middle is at (600.5, 400.5)
    found = preview(image)
    nearest = np.min(np.linalg.norm(found.xy - (600.5, 400.5), axis=1))
    assert 0 <= nearest < 0.3 * 1280 / 400 and found.scale == pytest.approx(400 / 1280)


def test_flat_or_tiny_images_match_nothing() -> None:
    flat, tiny = (preview(np.full(size, 90, np.uint8)) for size in ((480, 640), (3, 5)))
    assert len(flat) == len(tiny) == matched(flat, tiny).inliers == 0


def test_npz_round_trip(views, tmp_path) -> None:
    made = preview(views[0])
    np.savez(tmp_path / "p.npz", **made.to_npz())
    with np.load(tmp_path / "p.npz") as data:
        again = Preview.from_npz(dict(data))
    assert np.array_equal(again.xy, made.xy) and np.array_equal(again.descriptors, made.descriptors)
    assert (again.width, again.height, again.scale) == (640, 480, made.scale)
    assert again.brightness == made.brightness


@pytest.mark.parametrize(
    ("image", "mask", "said"),
    [(np.zeros((4, 4, 3), np.uint8), None, "grey"), (np.zeros((4, 4), np.float32), None, "grey"),
     (np.zeros((4, 4), np.uint8), np.ones((4, 5), bool), "mask")],
)  # fmt: skip
def test_wrong_images_and_masks_are_refused(image, mask, said) -> None:
    with pytest.raises(ValueError, match=said):
        preview(image, mask)


def test_spread_takes_the_best_of_each_cell_first() -> None:
    cell, response = np.array([0, 0, 0, 1, 2]), np.array([9.0, 8.0, 7.0, 1.0, 2.0])
    assert spread(cell, response, 3).tolist() == [0, 3, 4]
    assert spread(cell, response, 4).tolist() == [0, 1, 3, 4]
    assert spread(cell, response, 99).tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("seed", range(20))
def test_of_equal_descriptors_the_first_is_the_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = rng.integers(0, 60, (5, 128)).astype(np.uint8)
    a, b = (
        Preview(
            np.zeros((n, 2), np.float32), kinds[rng.integers(0, 5, n)], 640, 480, 1.0, 128.0, 40.0, np.full(16, 1 / 16)
        )
        for n in rng.integers(2, 12, 2)
    )
    cosine = rounded(a.descriptors).astype(float) @ rounded(b.descriptors).astype(float).T
    nearest = cosine.argmax(axis=1)
    mutual = cosine.argmax(axis=0)[nearest] == np.arange(len(a))
    loose = TUNING.model_copy(update={"max_distance": 2.0})
    left, right = tentative(a, b, SETTINGS.model_copy(update={"ratio": 1.0}), loose)
    assert 0 < mutual.sum() <= len(b)
    np.testing.assert_array_equal(left, np.flatnonzero(mutual))
    np.testing.assert_array_equal(right, nearest[mutual])
