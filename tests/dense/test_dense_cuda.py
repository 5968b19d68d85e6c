"""The kernels of the GPU against the native module, bit by bit: on a GPU where there is one, and emulated."""

import sys
from importlib.util import find_spec
from types import SimpleNamespace

import cuda_emulated
import numpy as np
import pytest
from test_dense_sgm import TABLE, options, pair, table
from test_dense_sgm import VARIANTS as CHANGES

from tiegraph.dense import cuda, tsgm
from tiegraph.dense.tuning import TsgmTuning
from tiegraph.errors import EngineMissing

sgm = pytest.importorskip("tiegraph.dense._sgm")

VARIANTS = [
    {"shape": (9, 17, 17), "low": -7, "count": 37, "radius_x": 6, "radius_y": 2},
    {"shape": (8, 37, 50), "low": 0, "count": 16} | CHANGES[1],
    {"shape": (1, 40, 40), "low": 3, "count": 1} | CHANGES[2],
    {"shape": (6, 70, 45), "low": -20, "count": 70} | CHANGES[3],
    {"shape": (5, 8, 300), "low": -250, "count": 260, "large_by_step": TABLE},
    {"shape": (23, 1, 1), "low": 0, "count": 130},
    {"shape": (4, 9, 700), "low": -600, "count": 600},
    {"shape": (3, 5, 1100), "low": -1050, "count": 1050},
]


PLACES = ["emulated", "device"] if find_spec("cupy") else ["emulated"]


def device():
    found = cuda.matcher()
    if found is None:
        pytest.skip(f"not on a GPU, emulated only: {cuda.reason()}")
    return found


@pytest.fixture(scope="module", params=PLACES)
def gpu(request, tmp_path_factory):
    if request.param == "device":
        return device()
    if cuda_emulated.compiler() is None:
        pytest.skip("no g++")
    return cuda.Matcher(cuda_emulated.Emulated(tmp_path_factory.mktemp("cuda")))


def same_disparities(found, expected):
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    np.testing.assert_array_equal(found[~np.isnan(found)].view(np.uint32), expected[~np.isnan(found)].view(np.uint32))


def whole(image):
    return [(slice(0, len(image)), slice(0, len(image)))]


def case(variant):
    changes = dict(VARIANTS[variant])
    left, right = pair(*changes.pop("shape"), seed=variant)
    return left, right, changes.pop("low"), changes.pop("count"), changes


@pytest.mark.slow
@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("variant", range(len(VARIANTS)))
def test_ranges_give_the_bits_of_the_native_module(gpu, variant, mode):
    """One for all pixels, and own ones of at most 1 and 18 blocks."""
    left, right, low, count, changes = case(variant)
    chosen, mutual = options("", mode=mode, **changes), table(variant) if mode else None
    images, how = (gpu.upload(left), gpu.upload(right)), (chosen, mutual, whole(left))
    expected = sgm.match_dense(left, right, low, count, chosen, sgm.Workspace(), mutual)
    same_disparities(gpu.download(gpu.match_dense(*images, (low, count), *how)), expected[0])
    for most in (1, 18):
        rng = np.random.default_rng(variant)
        first = rng.integers(low - 20, low + 60, left.shape).astype(np.int16)
        blocks = rng.integers(1, most + 1, left.shape).astype(np.uint8)
        expected = sgm.match_ragged(left, right, first, blocks, chosen, sgm.Workspace(), mutual)
        found = gpu.match_ragged(*images, (gpu.upload(first), gpu.upload(blocks)), *how)
        same_disparities(gpu.download(found), expected[0])


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (5, 1), (8, 10), (7, 9)])
def test_images_are_halved_alike(gpu, shape):
    image = np.random.default_rng(1).integers(0, 256, shape, np.uint8)
    np.testing.assert_array_equal(gpu.download(gpu.halve(gpu.upload(image))), sgm.halve(image))


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (9, 14), (40, 33)])
@pytest.mark.parametrize("holes", [0.0, 0.6, 0.99, 1.0])
@pytest.mark.parametrize("limit", [12, 254])
def test_ranges_are_alike(gpu, shape, holes, limit):
    rng = np.random.default_rng(len(shape) + int(100 * holes))
    coarse = rng.normal(0, 40, shape).astype(np.float32)
    coarse[rng.random(shape) < holes] = np.nan
    rules = sgm.RangeRules()
    rules.low, rules.count, rules.reach, rules.margin, rules.hole_limit = -90, 203, 3, 1, limit
    for width, height in ((2 * shape[1], 2 * shape[0]), (2 * shape[1] - 1, 2 * shape[0] - 1)):
        first, blocks, _ = sgm.ranges(coarse, width, height, rules)
        found = gpu.ranges(gpu.upload(coarse), width, height, rules)
        np.testing.assert_array_equal(gpu.download(found[0]), first)
        np.testing.assert_array_equal(gpu.download(found[1]), blocks)


@pytest.mark.slow
def test_greys_that_lie_upon_each_other_are_counted_alike(gpu):
    left, right = pair(20, 30, 40)
    disparity = np.random.default_rng(0).uniform(-15, 15, left.shape).astype(np.float32)
    disparity[::3] = np.nan
    disparity[1, :4] = 0.5, 1.5, 2.5, -0.5  # to the even one
    found = gpu.joint_greys(*(gpu.upload(a) for a in (left, right, disparity)))
    np.testing.assert_array_equal(found, sgm.joint_greys(left, right, disparity))


@pytest.mark.slow
@pytest.mark.parametrize("disparities", [12, 300])
def test_the_pyramid_gives_the_same_bits(gpu, monkeypatch, disparities):
    left, right = pair(40, 60, 60 + disparities, seed=5)
    use = np.ones(left.shape, bool)
    use[10:20, 5:30] = False
    tuning = TsgmTuning(strip_overlap_px=4, full_disparities=64)
    monkeypatch.setattr(tsgm, "_VOLUME_BYTES", 60_000)  # several strips
    monkeypatch.setattr(cuda, "matcher", lambda: None)
    expected = tsgm.match(left, right, disparities, disparities, tuning, use)
    monkeypatch.setattr(cuda, "matcher", lambda: gpu)
    same_disparities(tsgm.match(left, right, disparities, disparities, tuning, use), expected)


@pytest.mark.slow
def test_what_does_not_fit_the_device_at_once_is_matched_in_batches(gpu, monkeypatch):
    left, right, low, count, changes = case(1)
    strips = [(slice(0, 4), slice(0, 3)), (slice(2, 6), slice(1, 3)), (slice(4, 8), slice(1, 4))]
    chosen = options("", **changes)
    expected = [sgm.match_dense(left[o], right[o], low, count, chosen, sgm.Workspace())[0][i] for o, i in strips]
    launched = []
    run = gpu._run
    monkeypatch.setattr(gpu, "_run", lambda name, *a, **k: (launched.append(name), run(name, *a, **k)))
    for room, batches in ((1 << 40, 1), (62_000, 2), (1, 3)):
        monkeypatch.setattr(gpu, "_room", lambda room=room: room)
        launched.clear()
        found = gpu.match_dense(gpu.upload(left), gpu.upload(right), (low, count), chosen, None, strips)
        same_disparities(gpu.download(found), np.concatenate(expected))
        assert launched.count("finish") == batches


@pytest.mark.slow
def test_costs_that_do_not_fit_a_byte_are_refused(gpu):
    left, right, low, count, changes = case(0)
    mutual = np.full((256, 256), 128, np.uint8)
    with pytest.raises(ValueError, match="127"):
        gpu.match_dense(gpu.upload(left), gpu.upload(right), (low, count), options("", mode=1), mutual, whole(left))


def test_the_device_is_found():
    """Where CuPy and a GPU are there; says what is missing elsewhere."""
    assert device().xp.__name__ == "cupy" and "cuda" in tsgm.kernel_in_use(TsgmTuning())


def test_cupy_without_a_device_that_works_is_said_once_and_not_used(monkeypatch, caplog):
    def fails():
        raise RuntimeError("driver too old")

    runtime = SimpleNamespace(getDeviceCount=fails)
    monkeypatch.setitem(sys.modules, "cupy", SimpleNamespace(cuda=SimpleNamespace(runtime=runtime)))
    monkeypatch.setattr(cuda, "find_spec", lambda name: True)
    cuda._found.cache_clear()
    try:
        assert cuda.matcher() is None and cuda.device_name() is None and "driver too old" in cuda.reason()
        assert [r.message for r in caplog.records] == ["the GPU is not used: RuntimeError: driver too old"]
    finally:
        cuda._found.cache_clear()


def test_a_gpu_that_is_asked_for_and_not_there_is_an_error(monkeypatch):
    monkeypatch.setattr(cuda, "matcher", lambda: None)
    left, right = pair(20, 30, 50)
    with pytest.raises(EngineMissing, match="cuda12"):
        tsgm.match(left, right, 20, 20, TsgmTuning(kernel="cuda"))


def test_a_pair_that_does_not_fit_the_device_is_matched_without_it(monkeypatch):
    class Full:
        released = 0

        def upload(self, array):
            raise MemoryError

        def release(self):
            self.released += 1

    left, right = pair(20, 30, 50)
    expected = tsgm.match(left, right, 20, 20, TsgmTuning())
    full = Full()
    monkeypatch.setattr(cuda, "matcher", lambda: full)
    same_disparities(tsgm.match(left, right, 20, 20, TsgmTuning()), expected)
    assert full.released == 1
