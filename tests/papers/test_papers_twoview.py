"""Paper 002's accuracy of a pair: how far the bundle adjustment of its two images moves the base."""

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.papers.fuse2014 import two_view
from tiegraph.sfm.tuning import TwoViewTuning

CAMERA = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240])


def matches(base: float, noise_px: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of 80 points 8 to 12 away, seen from two places ``base`` apart across the view."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform((-4, -3, 8), (4, 3, 12), (80, 3))
    second = transforms.rigid(np.eye(3), np.array([-base, 0, 0]))
    moved = xyz @ second[:3, :3].T + second[:3, 3]
    return tuple(np.asarray(CAMERA.img_from_cam(x)) + rng.normal(0, noise_px, (80, 2)) for x in (xyz, moved))  # type: ignore[return-value]


def test_good_matches_hardly_move_and_the_range_is_in_bases() -> None:
    found = two_view(*matches(2.0, 0.0), CAMERA, CAMERA, TwoViewTuning())
    assert found is not None
    assert found[0] < 1e-3 and 4.5 < found[1] < 6.0  # about 10.5 / 2


def test_noise_and_short_bases_move_more() -> None:
    def moved(base: float, noise: float) -> float:
        found = [two_view(*matches(base, noise, s), CAMERA, CAMERA, TwoViewTuning()) for s in range(7)]
        return float(np.median([f[0] for f in found if f is not None]))

    good, noisy, short = moved(2.0, 0.3), moved(2.0, 1.5), moved(0.3, 0.3)
    assert 1e-5 < good < noisy < 1.5 and good < short


def test_too_few_matches_give_nothing() -> None:
    a, b = matches(1.0, 0.2)
    assert two_view(a[:7], b[:7], CAMERA, CAMERA, TwoViewTuning()) is None
