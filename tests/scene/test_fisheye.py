"""Fisheye images: the circle of a lens is found to a hundredth and in nothing else; views look where rays do."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest
from PIL import Image

from tiegraph.scene.rig import LensView, Rig, Sensor, Source, rig_from_dict, rig_to_dict
from tiegraph.scene.wideviews import image_circles, lit, render_lens_view, seen_half_deg


def blots(width: int, height: int, seed: int = 0) -> np.ndarray:
    """A picture (h, w, 3) u1 of bright and dark blots."""
    rng = np.random.default_rng(seed)
    small = Image.fromarray(rng.integers(30, 255, (12, 16, 3), dtype=np.uint8))
    return np.asarray(small.resize((width, height), Image.Resampling.BICUBIC))


def lit_by(pixels: np.ndarray, circle: tuple[float, float, float], blur_px: float = 1.0) -> np.ndarray:
    """The same as a lens lights it: black but for a circle with a soft rim and the noise of JPEG."""
    x, y = np.meshgrid(np.arange(pixels.shape[1]) + 0.5, np.arange(pixels.shape[0]) + 0.5)
    off = circle[2] - np.hypot(x - circle[0], y - circle[1])
    noise = np.random.default_rng(1).integers(0, 8, pixels.shape)
    return (pixels * np.clip(off / blur_px + 0.5, 0, 1)[..., None]).clip(noise, 255).astype(np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(
    "circle", [(320.0, 320.0, 290.0), (310.0, 331.0, 300.0), (322.0, 316.0, 340.0), (320.0, 330.0, 210.0)]
)
def test_the_circle_of_a_lens_is_found(circle: tuple[float, float, float]) -> None:
    picture = lit_by(blots(640, 640), circle)
    picture[:, 40:110] = lit_by(blots(640, 640) // 12, circle)[:, 40:110]  # a dark tree at the rim
    found = image_circles(Image.fromarray(picture))
    assert len(found) == 1
    assert np.abs(np.subtract(found[0], circle)).max() < 0.01 * circle[2]


@pytest.mark.slow
def test_two_circles_side_by_side_are_found() -> None:
    left, right = (252.0, 249.0, 240.0), (248.0, 251.0, 241.0)
    halves = [lit_by(blots(500, 500, seed), circle) for seed, circle in enumerate((left, right))]
    found = image_circles(Image.fromarray(np.hstack(halves)))
    assert len(found) == 2
    assert np.allclose(found, [left, (right[0] + 500, *right[1:])], atol=2.4)
    panorama = Image.fromarray(blots(1000, 500))
    assert image_circles(panorama) == ()


@pytest.mark.slow
def test_nothing_else_has_a_circle() -> None:
    frame = np.zeros((480, 640, 3), np.uint8)
    frame[80:400, 60:580] = blots(520, 320)  # a picture in a black frame
    lamp = lit_by(blots(640, 480), (320.0, 240.0, 60.0))  # a spot of light in the night
    half = lit_by(blots(640, 480), (40.0, 240.0, 200.0))  # a round thing at the border
    for picture in (blots(640, 480), frame, lamp, half, np.zeros((480, 640, 3), np.uint8)):
        assert image_circles(Image.fromarray(picture)) == ()


def fisheye(focal: float = 100.0, side: int = 400) -> pycolmap.Camera:
    """An exactly equidistant lens."""
    params = [focal, focal, side / 2, side / 2, 0, 0, 0, 0]
    return pycolmap.Camera(model="OPENCV_FISHEYE", width=side, height=side, params=params)


def pinhole(focal: float = 100.0, side: int = 200) -> pycolmap.Camera:
    return pycolmap.Camera(model="SIMPLE_PINHOLE", width=side, height=side, params=[focal, side / 2, side / 2])


def to_the_right() -> tuple[float, ...]:
    """view_from_lens of a view 45 degrees to the right."""
    s = float(np.sqrt(0.5))
    return (s, 0, -s, 0, 1, 0, s, 0, s)


def test_a_view_shows_what_its_rays_see_and_nothing_behind_the_lens() -> None:
    lens, view = fisheye(), LensView("lens", fisheye(), to_the_right())
    x, y = np.meshgrid(np.arange(400) + 0.5, np.arange(400) + 0.5)
    image = np.stack([x / 2, y / 2, 0 * x + 77], axis=-1).astype(np.float32)
    seen = render_lens_view(image, view, pinhole())
    u, v = np.meshgrid((np.arange(200) + 0.5 - 100) / 100, (np.arange(200) + 0.5 - 100) / 100)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.reshape(view.rotation, (3, 3))
    angle = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
    around = np.arctan2(rays[..., 1], rays[..., 0])
    expected = 200 + 100 * angle[..., None] * np.stack([np.cos(around), np.sin(around)], axis=-1)
    before = angle < np.radians(88)
    assert 0.9 < before.mean() < 0.99
    assert np.abs(2 * seen[..., :2] - expected)[before].max() < 0.2
    sensor = Sensor("v", pinhole(), source=Source(camera=pinhole(), view=view))
    used = lit(sensor, 80.0)
    assert used[before].all() and not used[angle > np.radians(93)].any()
    circle = Sensor("v", pinhole(), source=Source(camera=pinhole(), view=view, circle_px=(200, 200, 120)))
    used = lit(circle, 80.0)
    assert used[angle < 1.19].all() and not used[angle > 1.21].any()
    assert lens.width == 400


def test_what_is_used_of_a_whole_fisheye_image() -> None:
    sensor = Sensor("w", fisheye(), source=Source(camera=fisheye(), circle_px=(200, 200, 130)))
    x, y = np.meshgrid(np.arange(400) + 0.5, np.arange(400) + 0.5)
    off = np.hypot(x - 200, y - 200)
    for half_deg, radius in ((60.0, np.radians(60) * 100), (80.0, 130.0)):
        used = lit(sensor, half_deg)
        assert used[off < radius - 1.5].all() and not used[off > radius + 1.5].any()
    assert lit(Sensor("p", pinhole()), 80.0) is None


def test_how_far_a_lens_sees() -> None:
    assert seen_half_deg(fisheye(focal=200)) == pytest.approx(np.degrees(1), abs=0.6)
    assert seen_half_deg(fisheye(focal=100)) == pytest.approx(90, abs=0.6)
    folds = pycolmap.Camera(model="OPENCV_FISHEYE", width=400, height=400, params=[100, 100, 200, 200, -0.25, 0, 0, 0])
    assert seen_half_deg(folds) == pytest.approx(np.degrees(np.sqrt(1 / 0.75)), abs=1)


def test_a_view_goes_to_the_scene_and_back() -> None:
    source = Source(camera=pinhole(), view=LensView("lens", fisheye(), to_the_right()), circle_px=(1.0, 2.0, 3.0))
    rig = Rig("r", (Sensor("v", pinhole(), np.eye(4), source=source),))
    assert rig_from_dict(rig_to_dict(rig)).sensors[0].source == source
