"""The native kernels against the plain reference, bit by bit, on every instruction set this machine has."""

import cv2
import numpy as np
import pytest
import sgm_reference as reference

sgm = pytest.importorskip("tiegraph.dense._sgm")

KERNELS = sgm.kernels()
TABLE = [120, 120, 110, 100, 90, 80, 70, 60, 55, 50, 45, 40, 40, 40, 40, 40]


def pair(h, w, right_width, seed=0):
    """A pair that shows partly the same, with a few discrete grey steps so that ties happen."""
    rng = np.random.default_rng(seed)
    wide = cv2.GaussianBlur(rng.uniform(0, 255, (h, w + right_width + 5)).astype(np.float32), (0, 0), 1.0)
    wide = cv2.normalize(wide, None, 0, 255, cv2.NORM_MINMAX)
    left = wide[:, 5 : 5 + w] + rng.normal(0, 3, (h, w))
    return np.clip(left, 0, 255).astype(np.uint8), np.ascontiguousarray(wide[:, :right_width]).astype(np.uint8)


def options(kernel, **changes):
    o = sgm.Options()
    o.kernel = kernel
    for name, value in changes.items():
        setattr(o, name, value)
    return o


def same(found, expected):
    """Equal in every bit; where the disparity is NaN only that counts."""
    np.testing.assert_array_equal(found[1], expected[1])
    np.testing.assert_array_equal(
        found[0].view(np.uint32) * ~np.isnan(found[0]), expected[0].view(np.uint32) * ~np.isnan(expected[0])
    )
    np.testing.assert_array_equal(np.isnan(found[0]), np.isnan(expected[0]))


SHAPES = [(1, 1, 1), (1, 40, 40), (23, 1, 1), (2, 3, 2), (9, 17, 17), (8, 37, 50), (6, 70, 45)]
DENSE = [(-7, 37), (0, 16), (3, 1), (-20, 70)]
VARIANTS = [
    {},
    {"large_by_step": TABLE, "uniqueness": 5},
    {"radius_x": 2, "radius_y": 2, "small": 8, "large": 40, "parabola": False},
    {"left_right": -1, "small": 0, "large": 127},
]


def table(seed=3):
    return np.random.default_rng(seed).integers(0, 63, (256, 256)).astype(np.uint8)


def ranges(shape, seed, spread=12, most=4):
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.normal(0, 1, shape).astype(np.float32), (0, 0), 2.0)
    first = np.rint(smooth * spread * 3).astype(np.int16) - 4
    jumps = rng.random(shape) < 0.03
    first = np.where(jumps, rng.integers(-60, 60, shape), first).astype(np.int16)
    blocks = np.where(rng.random(shape) < 0.15, rng.integers(1, most + 1, shape), 1).astype(np.uint8)
    return first, blocks


def check_dense(left, right, low, count, *mutual, **changes):
    """One range for all pixels: every kernel gives the bits of the reference."""
    even = np.full(left.shape, low), np.full(left.shape, count)
    expected = reference.match(left, right, *even, options("", **changes), *mutual)
    for kernel in KERNELS:
        same(sgm.match_dense(left, right, low, count, options(kernel, **changes), sgm.Workspace(), *mutual), expected)


def check_ragged(left, right, seed, *mutual, **changes):
    """A range of its own for each pixel."""
    first, blocks = ranges(left.shape, seed)
    each = first.astype(int), 16 * blocks.astype(int)
    expected = reference.match(left, right, *each, options("", **changes), *mutual)
    for kernel in KERNELS:
        own = options(kernel, **changes)
        same(sgm.match_ragged(left, right, first, blocks, own, sgm.Workspace(), *mutual), expected)


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("variant", range(len(VARIANTS)))
def test_kernels_equal_the_reference(shape, variant):
    check_dense(*pair(*shape), *DENSE[variant], **VARIANTS[variant])
    check_ragged(*pair(*shape, seed=1), variant, **VARIANTS[variant])


@pytest.mark.slow
@pytest.mark.parametrize("mode", [1, 2])
def test_mutual_information_equals_the_reference(mode):
    images = pair(7, 33, 40)
    check_dense(*images, -4, 30, table(), mode=mode)
    check_ragged(*images, 5, table(), mode=mode)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", KERNELS)
def test_threads_do_not_change_a_bit(kernel):
    left, right = pair(61, 150, 160, seed=4)
    first, blocks = ranges(left.shape, 6)
    one = sgm.match_dense(left, right, -10, 48, options(kernel), sgm.Workspace())
    other = sgm.match_ragged(left, right, first, blocks, options(kernel), sgm.Workspace())
    for threads in (2, 3, 7, 100):
        o = options(kernel, threads=threads)
        same(sgm.match_dense(left, right, -10, 48, o, sgm.Workspace()), one)
        same(sgm.match_ragged(left, right, first, blocks, o, sgm.Workspace()), other)


def test_a_dense_range_and_equal_ragged_ranges_agree():
    left, right = pair(40, 90, 100, seed=2)
    first, blocks = np.full(left.shape, -5, np.int16), np.full(left.shape, 3, np.uint8)
    how = sgm.Options(), sgm.Workspace()
    same(sgm.match_ragged(left, right, first, blocks, *how), sgm.match_dense(left, right, -5, 48, *how))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"small": 130}, "P1"), ({"large": 128}, "P2"), ({"large_by_step": [5]}, "16 entries"), ({"mode": 1}, "mutual"),
        ({"uniqueness": 100}, "uniqueness"), ({"threads": 0}, "threads"), ({"radius_x": 40}, "census"),
        ({"kernel": "mmx"}, "mmx"), ({"count": 0}, "disparities"), ({"low": 30000}, "30000"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(changes, says):
    left, right = pair(8, 20, 20)
    changes = {"kernel": "", "low": 0, "count": 16} | changes
    low, count = changes.pop("low"), changes.pop("count")
    with pytest.raises(ValueError, match=says):
        sgm.match_dense(left, right, low, count, options(**changes), sgm.Workspace())


def test_shapes_and_types_are_checked():
    left, right = pair(8, 20, 20)
    how = sgm.Options(), sgm.Workspace()
    for first, blocks, says in (
        (np.zeros((8, 19)), np.ones((8, 19)), "shape of the left"), (np.zeros((8, 20)), np.zeros((8, 20)), "one block")
    ):  # fmt: skip
        with pytest.raises(ValueError, match=says):
            sgm.match_ragged(left, right, first.astype(np.int16), blocks.astype(np.uint8), *how)
    for images, error, says in (
        ((left, right[:4]), ValueError, "height"), ((left[:, :0], right), ValueError, "one pixel"),
        ((left.astype(np.float32), right), TypeError, "incompatible"),
    ):  # fmt: skip
        with pytest.raises(error, match=says):
            sgm.match_dense(*images, 0, 16, *how)
