"""Images of 48 megapixels: what a step of a depth map holds beside its result is that of some rows, not of the image.

Bounds are two-sided: a peak below the result itself would mean that nothing was measured.
"""

import json
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tiegraph.cloud.fuse import Maps, fuse
from tiegraph.cloud.settings import CloudSettings
from tiegraph.cloud.tuning import Tuning as CloudTuning
from tiegraph.dense import depth as dense_depth
from tiegraph.dense import undistort
from tiegraph.dense.depth import check, with_normals
from tiegraph.dense.plan import CameraModel
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import _maps, pinhole_of
from tiegraph.scene.results import DepthMap, row_strips

pytestmark = pytest.mark.slow
WIDTH, HEIGHT = 8064, 6048
CAMERA = CameraModel("SIMPLE_RADIAL", WIDTH, HEIGHT, (5376.0, WIDTH / 2, HEIGHT / 2, -0.02))
SETTINGS, TUNING = DenseSettings(), Tuning()
K, SIZE = pinhole_of(CAMERA, SETTINGS)
PIXELS = SIZE[0] * SIZE[1]


def bytes_a_pixel(work: Callable[[], object]) -> float:
    """Most that is held at once, result included, for each pixel of the depth map."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / PIXELS
    finally:
        tracemalloc.stop()


def slope(normals: bool) -> DepthMap:
    row, column = np.arange(SIZE[1], dtype=np.float32)[:, None], np.arange(SIZE[0], dtype=np.float32)
    depth = 60 + 1e-3 * row + 5e-4 * column
    return DepthMap(
        image="a.jpg",
        depth_m=depth,
        sigma_m=np.full_like(depth, 0.02),
        views=np.full(depth.shape, 3, np.uint8),
        K=K,
        cam_from_world=np.eye(4),
        normal=np.zeros((*depth.shape, 3), np.float32) if normals else None,
    )


def test_normals_take_the_memory_of_some_rows():
    assert 3000 <= max(SIZE) <= 4032  # on a drone's images the bound of disparities makes more than this no better
    depth = slope(normals=False)
    assert 12 < bytes_a_pixel(lambda: with_normals(depth)) < 40


def test_strips_of_rows_give_the_bits_of_the_whole(monkeypatch):
    shape = (90, 120)
    noise = np.random.default_rng(0).normal(scale=0.02, size=shape).astype(np.float32)
    noise[::11] = np.nan
    small = {"sigma_m": np.full(shape, 0.02, np.float32), "views": np.full(shape, 3, np.uint8)}
    depth = DepthMap(image="a.jpg", depth_m=10 + noise, K=np.diag([100.0, 100, 1]), cam_from_world=np.eye(4), **small)
    pinhole = CameraModel("PINHOLE", 120, 90, (100.0, 100.0, 60.0, 45.0))
    camera = CameraModel("SIMPLE_RADIAL", 120, 90, (100.0, 60.0, 45.0, -0.1))

    def made() -> list[np.ndarray]:
        confirmed, _ = check(depth, ["b"], ["b"], {"b": replace(depth, image="b")}.get, SETTINGS, TUNING.rays)
        found = [confirmed.depth_m, confirmed.sigma_m, confirmed.views, with_normals(depth).normal]
        return [*found, *_maps.__wrapped__(camera, pinhole)]

    whole = made()
    for module in (dense_depth, undistort):
        monkeypatch.setattr(module, "row_strips", lambda shape, *_: row_strips(shape, 7 * shape[1]))
    for one, other in zip(whole, made(), strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.isfinite(whole[3]).mean() > 0.8


def test_the_way_from_pixels_of_the_image_takes_the_memory_of_some_rows():
    pinhole = CameraModel("PINHOLE", *SIZE, (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    assert 9 < bytes_a_pixel(lambda: _maps.__wrapped__(CAMERA, pinhole)) < 40


def test_points_take_the_memory_of_some_rows(tmp_path):
    depth, settings = slope(normals=True), CloudSettings().unfiltered(voxel_size=0.1)
    rgb = np.zeros((*depth.depth_m.shape, 3), np.uint8)
    maps = Maps({"a.jpg": depth}.get, lambda name: rgb)
    assert 5 < bytes_a_pixel(lambda: fuse(["a.jpg"], maps, tmp_path, settings, CloudTuning())) < 60


ONE_IMAGE = """
import json, sys
from pathlib import Path

import numpy as np

from tiegraph.dense.depth import confirmed_map, depth_map
from tiegraph.dense.plan import CameraModel, DepthRange, ImagePlan, ViewPlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning

folder, width, height, baseline = Path(sys.argv[1]), *map(int, sys.argv[2:4]), float(sys.argv[4])
camera = CameraModel("SIMPLE_RADIAL", width, height, (5376.0, width / 2, height / 2, 0.0))
aside = np.eye(4)
aside[0, 3] = -baseline
views = [ViewPlan("a.jpg", camera, np.eye(4)), ViewPlan("b.jpg", camera, aside)]
plan = ImagePlan(views[0], (views[1],) * 2, ("b.jpg",), DepthRange(50.0, 72.0))
settings, tuning = DenseSettings(min_views=2), Tuning()
first = depth_map(plan, folder, None, settings, tuning)
final, _ = confirmed_map(plan, first, {}.get, settings, tuning)
peak = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM"))
known = np.isfinite(first.depth_m)
print(json.dumps({"peak_mib": int(peak) / 1024, "size": first.depth_m.shape[::-1], "known": float(known.mean()),
                  "depth": float(np.median(first.depth_m[known]))}))
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the system does not tell the peak")
def test_an_image_and_its_partners_fit_a_small_machine(tmp_path):
    shift = 800
    coarse = np.random.default_rng(0).integers(0, 255, (HEIGHT // 4, (WIDTH + shift) // 4), dtype=np.uint8)
    scene = cv2.resize(coarse, (WIDTH + shift, HEIGHT), interpolation=cv2.INTER_LINEAR)
    for name, left in (("a.jpg", 0), ("b.jpg", shift)):
        cv2.imwrite(str(tmp_path / name), np.ascontiguousarray(scene[:, left : left + WIDTH]))
    args = [str(tmp_path), str(WIDTH), str(HEIGHT), str(shift * 60 / 5376)]
    said = subprocess.run([sys.executable, "-c", ONE_IMAGE, *args], capture_output=True, text=True, check=True)
    found = json.loads(said.stdout)
    assert found["size"] == list(SIZE) and found["known"] > 0.8
    assert found["depth"] == pytest.approx(60, rel=0.002)
    assert 400 < found["peak_mib"] < 2000  # two such workers and the rest of the run: well below 8 GiB
