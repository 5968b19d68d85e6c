"""The matchers of pairs as a whole; of the hierarchical one the pyramid between levels and mutual information."""

import cv2
import numpy as np
import pytest

from tiegraph.dense import engine, tsgm
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tsgm import _left_right, match_sgbm, mutual_information
from tiegraph.dense.tuning import Tuning
from tiegraph.errors import EngineMissing, SettingsError, choose

sgm = pytest.importorskip("tiegraph.dense._sgm")
SETTINGS = DenseSettings()
TUNING = Tuning()


def texture(shape, seed=0, sigma=1.2):
    noise = np.random.default_rng(seed).uniform(0, 255, shape).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), sigma), None, 0, 255, cv2.NORM_MINMAX)


def grey(image):
    return np.clip(image, 0, 255).astype(np.uint8)


def rules(**changes):
    r = sgm.RangeRules()
    for name, value in {"low": -8, "count": 100, "reach": 1, "margin": 1, "hole_limit": 32, **changes}.items():
        setattr(r, name, value)
    return r


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (5, 1), (8, 10), (7, 9)])
def test_half_the_image_is_the_mean_of_four(shape):
    image = np.random.default_rng(1).integers(0, 256, shape, np.uint8)
    even = np.pad(image.astype(int), ((0, shape[0] % 2), (0, shape[1] % 2)), mode="edge")
    mean = (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2] + 2) // 4
    np.testing.assert_array_equal(sgm.halve(image), mean)


def test_ranges_hold_what_the_neighbourhood_had():
    coarse = (texture((13, 17), 2, 3.0) / 10 + 3).astype(np.float32)
    first, blocks, cells = sgm.ranges(coarse, 33, 25, rules())
    assert cells == 16 * blocks.astype(int).sum()
    for y in range(25):
        for x in range(33):
            v, u = y // 2, x // 2
            near = coarse[max(0, v - 1) : v + 2, max(0, u - 1) : u + 2]
            low, high = np.floor(2 * near).min() - 1, np.ceil(2 * near).max() + 1
            assert first[y, x] <= low and first[y, x] + 16 * blocks[y, x] > high
            assert 16 * blocks[y, x] - (high - low + 1) < 16


def test_holes_ask_their_surroundings_and_stay_bounded():
    coarse = np.full((40, 40), 20, np.float32)
    coarse[:, 20:] = 5
    coarse[5:35, 5:35] = np.nan
    first, blocks, _ = sgm.ranges(coarse, 80, 80, rules(hole_limit=500))
    assert first[40, 40] <= 9 and first[40, 40] + 16 * blocks[40, 40] > 41
    first, blocks, _ = sgm.ranges(coarse, 80, 80, rules(hole_limit=10))
    assert blocks[40, 40] == 1


def test_nothing_known_means_the_whole_range():
    first, blocks, _ = sgm.ranges(np.full((3, 3), np.nan, np.float32), 5, 6, rules())
    assert (first <= -8).all() and (first + 16 * blocks.astype(int) >= 92).all()


@pytest.mark.parametrize(
    ("size", "changes", "says"),
    [((5, 5), {}, "half the size"), ((4, 4), {"count": 0}, "disparities"), ((4, 4), {"low": 30000}, "20000")],
)
def test_impossible_ranges_are_refused(size, changes, says):
    with pytest.raises(ValueError, match=says):
        sgm.ranges(np.zeros((2, 2), np.float32), *size, rules(**changes))


def test_mutual_information_knows_any_relation_of_greys():
    left = grey(texture((80, 120)))
    right = 255 - left // 2  # as unlike as it can be, but a function of it
    table = mutual_information(sgm.joint_greys(left, right, np.zeros(left.shape, np.float32)))
    true = table[left, right].mean()
    wrong = table[left, np.roll(right, 30, axis=1)].mean()
    assert true + 10 < wrong
    nothing = sgm.joint_greys(left, right, np.full(left.shape, np.nan, np.float32))
    assert nothing.sum() == 0 and mutual_information(nothing).shape == (256, 256)


def test_grey_values_are_counted_where_the_disparity_leads():
    rng = np.random.default_rng(7)
    left, right = (rng.integers(0, 256, (9, w), np.uint8) for w in (30, 41))
    disparity = rng.uniform(-15, 15, left.shape).astype(np.float32)
    disparity[rng.random(left.shape) < 0.2] = np.nan
    disparity[0, :4] = [0.5, 1.5, -0.5, -1.5]  # halves go to the even number
    expected = np.zeros((256, 256), int)
    for y, x in np.argwhere(np.isfinite(disparity)):
        there = x - int(np.rint(disparity[y, x]))
        if 0 <= there < 41:
            expected[left[y, x], right[y, there]] += 1
    np.testing.assert_array_equal(sgm.joint_greys(left, right, disparity), expected)
    with pytest.raises(ValueError, match="same height"):
        sgm.joint_greys(left, right[1:], disparity)


SGBM = [(match_sgbm, DenseSettings(paths=paths), 40, shift, 0.1) for paths in (3, 5, 8) for shift in (0.0, 7.0, 20.5)]
# Quarters are drawn towards whole pixels.
TSGM = [(tsgm.match_tsgm, SETTINGS, 100, shift, 0.2) for shift in (0.0, 7.0, 20.5, 80.25)]


@pytest.mark.parametrize("match, settings, disparities, shift, most_px", [*SGBM, *TSGM])
def test_a_matcher_finds_a_shift(match, settings, disparities, shift, most_px):
    """Column x of the left image shows what column x + disparities - shift of the right one does."""
    wide = texture((100, 420))
    right = wide[:, : 240 + disparities]
    move = np.array([[1.0, 0, -(disparities - shift)], [0, 1, 0]])
    left = cv2.warpAffine(wide, move, (240, 100), flags=cv2.INTER_CUBIC)
    found = match(grey(left), grey(right), disparities, settings, TUNING)
    inner = found[5:-5, 5:-5]
    assert found.shape == (100, 240) and found.dtype == np.float32
    assert np.isfinite(inner).mean() > 0.95 and abs(np.nanmedian(inner) - shift) < most_px
    assert np.nanmean(np.abs(inner - shift) > 1) < 0.01


def test_pixels_not_in_use_are_hardly_searched_and_the_others_answered_as_before(monkeypatch):
    wall, sky = texture((160, 500), 1), texture((60, 300), 2)
    left, right = wall[:, 100:400].copy(), wall[:, 110:410].copy()  # 10 px
    left[:60] = sky  # seen by this image alone
    padded = cv2.copyMakeBorder(right, 0, 0, 128, 0, cv2.BORDER_REPLICATE)
    searched = []
    ragged = sgm.match_ragged

    def counted(left, right, first, blocks, *rest):
        searched.append(int(blocks.sum(dtype=np.int64)))
        return ragged(left, right, first, blocks, *rest)

    monkeypatch.setattr(sgm, "match_ragged", counted)
    use = np.arange(160)[:, None] >= np.full(300, 60)
    all_pixels = tsgm.match_tsgm(grey(left), grey(padded), 128, SETTINGS, TUNING)
    in_use = tsgm.match_tsgm(grey(left), grey(padded), 128, SETTINGS, TUNING, use)
    assert searched[1] < 0.75 * searched[0]
    both = np.isfinite(all_pixels[66:]) & np.isfinite(in_use[66:])
    assert both.mean() > 0.98 * np.isfinite(all_pixels[66:]).mean() > 0.8
    assert np.mean(np.abs(all_pixels[66:] - in_use[66:])[both] > 0.5) < 0.005


def test_a_thin_bar_before_the_wall_is_kept():
    wall, bar = texture((160, 500), 1), texture((160, 500), 2)
    left, right = wall[:, 110:410].copy(), wall[:, 100:400].copy()  # 10 px
    left[:, 150:160], right[:, 70:80] = bar[:, :10], bar[:, :10]  # 80 px
    padded = cv2.copyMakeBorder(right, 0, 0, 128, 0, cv2.BORDER_REPLICATE)
    found = tsgm.match_tsgm(grey(left), grey(padded), 128, SETTINGS, TUNING)
    assert np.mean(np.abs(found[:, 152:158] - 80) < 2) > 0.8
    assert np.mean(np.abs(found[20:-20, 200:280] + 10) < 2) < 0.01
    assert np.mean(np.abs(found[20:-20, 20:140] - (-10)) < 2) < 0.01


@pytest.mark.parametrize(
    "match, shape, disparities, most", [(match_sgbm, (80, 160), 32, 0.15), (tsgm.match_tsgm, (120, 200), 64, 0.25)]
)
def test_a_matcher_refuses_what_the_other_image_does_not_show(match, shape, disparities, most):
    left, right = texture(shape, 1), texture((shape[0], shape[1] + disparities), 2)
    assert np.isfinite(match(grey(left), grey(right), disparities, SETTINGS, TUNING)).mean() < most


@pytest.mark.parametrize("apart, stays", [(0, True), (1, True), (2, False)])
def test_both_directions_may_differ_by_a_pixel(apart: int, stays: bool):
    """Paper 004, section 5.2.2: "greater than 1 pixel" is invalid."""
    found = _left_right(np.full((2, 6), 3, np.float32), np.full((2, 14), 3.0 + apart, np.float32), 8)
    assert np.isfinite(found).all() == stays == np.isfinite(found).any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (40, 1), (3, 200), (17, 16)])
@pytest.mark.parametrize("disparities", [1, 16, 33, 700])
def test_tiny_images_and_wide_ranges_do_no_harm(shape, disparities):
    left = np.zeros(shape, np.uint8)
    right = np.zeros((shape[0], shape[1] + disparities), np.uint8)
    found = tsgm.match_tsgm(left, right, disparities, SETTINGS, TUNING)
    assert found.shape == shape and not np.any((found < -1) | (found > disparities))


def test_strips_change_almost_nothing(monkeypatch):
    wide = texture((700, 260))
    left, right = grey(wide[:, 20:220]), grey(wide)[:, :240]
    padded = cv2.copyMakeBorder(right, 0, 0, 40, 0, cv2.BORDER_REPLICATE)
    whole = tsgm.match_tsgm(left, padded, 80, SETTINGS, TUNING)
    monkeypatch.setattr(tsgm, "_VOLUME_BYTES", 2 * 200 * 16 * 250)
    strips = tsgm.match_tsgm(left, padded, 80, SETTINGS, TUNING)
    assert np.mean((whole == strips) | (np.isnan(whole) & np.isnan(strips))) > 0.998


@pytest.mark.parametrize("limit", [1, 10_000, 100_000, 10**9])
def test_strips_cover_every_row_once_and_stay_within_the_limit(monkeypatch, limit):
    monkeypatch.setattr(tsgm, "_VOLUME_BYTES", limit)
    cells = np.random.default_rng(0).integers(1, 60, 900)
    strips = tsgm._strips(cells, TUNING.tsgm.strip_overlap_px)
    rows = np.concatenate([np.arange(900)[outer][inner] for outer, inner in strips])
    np.testing.assert_array_equal(rows, np.arange(900))
    for outer, _ in strips:
        assert cells[outer].sum() <= limit or outer.stop - outer.start <= 3 * TUNING.tsgm.strip_overlap_px
    if limit == 10**9:
        assert len(strips) == 1


@pytest.mark.slow
def test_the_volumes_stay_within_what_is_said_before(monkeypatch):
    wide = texture((480, 900))
    left, right = grey(wide[:, 200:840]), grey(wide)[:, :840]
    workspace = tsgm._sgm.Workspace()
    stated = tsgm.volume_bytes(480, 640, 200, TUNING.tsgm)
    monkeypatch.setattr(tsgm._memory, "workspace", workspace, raising=False)
    tsgm.match_tsgm(left, right, 200, SETTINGS, TUNING)
    assert 0.05 * stated < workspace.bytes < 1.3 * stated  # the rows in work come on top
    assert tsgm.volume_bytes(2048, 2448, 512, TUNING.tsgm) <= 300e6
    assert tsgm.volume_bytes(4000, 6000, 1000, TUNING.tsgm) <= 800e6


def test_without_the_native_module_the_remedy_is_named(monkeypatch):
    monkeypatch.setattr(tsgm, "_sgm", None)
    assert not tsgm.kernels()
    with pytest.raises(EngineMissing, match="compiler"):
        tsgm.match_tsgm(np.zeros((4, 4), np.uint8), np.zeros((4, 8), np.uint8), 4, SETTINGS, TUNING)
    name, remark = engine.installed("tsgm")
    assert name == "sgbm" and "compiler" in remark


def test_the_chosen_engine_is_used_where_it_is_installed_and_an_unknown_one_refused():
    assert [engine.installed(name) for name in ("tsgm", "sgbm")] == [("tsgm", ""), ("sgbm", "")]
    with pytest.raises(ValueError, match="engine"):
        DenseSettings(engine="magic")
    with pytest.raises(SettingsError, match="sgbm"):
        choose("dense engine", "sgm", engine.ENGINES)
