from pathlib import Path

import cv2
import numpy as np
import pytest

from tiegraph.masks import EGO, OVEREXPOSED, SKY, USE, WATER
from tiegraph.masks.matchability import Matchability, _shown, nearness
from tiegraph.masks.platform import platform_of_frames
from tiegraph.masks.proof import MatchCounts, matches_in, moves, white_ties, without_sky
from tiegraph.masks.tuning import Tuning

SHAPE = (300, 400)
TUNING = Tuning()


def two_views(focal, shift, turn_deg, seed=0):
    """Matches of 160 points 4 to 9 m away and of 40 at 5 km, seen before and after a step; (a, b, far)."""
    rng = np.random.default_rng(seed)
    depth = np.r_[rng.uniform(4, 9, 160), np.full(40, 5000.0)]
    a = rng.uniform((20, 20), (380, 280), (200, 2))
    a[160:, 1] = rng.uniform(20, 90, 40)
    points = np.column_stack([(a - (200, 150)) / focal, np.ones(200)]) * depth[:, None]
    turn = cv2.Rodrigues(np.radians([0, turn_deg, 0]))[0]
    moved = points @ turn.T + shift
    b = focal * moved[:, :2] / moved[:, 2:] + (200, 150)
    return a + rng.normal(0, 0.15, a.shape), b + rng.normal(0, 0.15, b.shape), depth > 100


@pytest.mark.parametrize("focal", [280, 360, 520])
@pytest.mark.parametrize(("shift", "turn"), [((0.5, 0, 0), 0.0), ((0.5, 0.05, 0), 2.0), ((0.1, 0, -0.8), 0.0)])
def test_sky_is_far_and_walls_are_near_whatever_the_lens(focal, shift, turn):
    a, b, far = two_views(focal, np.array(shift), turn)
    near = nearness(a, b, SHAPE, TUNING.matchability)
    known = np.isfinite(near)
    assert known[far].mean() > 0.5 and known[~far].mean() > 0.5
    assert (near[far & known] > TUNING.proof.near).mean() < 0.2
    assert (near[~far & known] > TUNING.proof.near).mean() > 0.7, "half of them refute a sky"


def test_what_cannot_be_told_is_unknown():
    a, b, _ = two_views(360, np.array([0.5, 0, 0]), 0.0)
    assert np.isnan(nearness(a, a + 1e-3, SHAPE, TUNING.matchability)).all(), "no motion"
    assert np.isnan(nearness(a[:4], b[:4], SHAPE, TUNING.matchability)).all(), "too few"


def test_ties_by_class():
    labels = np.repeat(np.array([SKY, USE, WATER, EGO], np.uint8), 25)[:, None].repeat(100, axis=1)
    y = np.array([0.1, 0.1, 0.24, 0.4, 0.4, 0.6, 0.9, 0.1])
    matched = np.array([1, 1, 1, 1, 1, 1, 1, 0], bool)
    near = np.array([1.0, 0.0, 1.0, 1, 1, 1, 1, np.nan], np.float32)
    evidence = Matchability(Path("a"), np.column_stack([np.full(8, 0.5), y]).astype(np.float32), matched, near)
    ties = matches_in(labels, labels == SKY, evidence, TUNING.proof)
    assert ties.inside.tolist() == [2, 3, 1, 1, 0]
    assert (ties.near, ties.far) == (1, 1), "the third lies at the edge of the sky"


def test_the_skies_of_all_cameras_are_judged_together():
    def ties(near, far, room=0.1):
        return MatchCounts(np.zeros(5, int), near, far, told=40, area=1, room=room)

    assert without_sky({0: ties(21, 0), 1: ties(3, 0), 2: ties(0, 0)}, TUNING.proof) == {0, 1, 2}
    assert without_sky({0: ties(21, 0), 1: ties(2, 40)}, TUNING.proof) == set(), "the walls beside a true sky"
    assert without_sky({0: ties(1, 40), 1: ties(4, 0)}, TUNING.proof) == set()
    assert without_sky({0: ties(2, 0)}, TUNING.proof) == set(), "two matches prove nothing"
    assert without_sky({0: ties(5, 0, room=0.8)}, TUNING.proof) == set(), "wires and tops of trees in a wide sky"
    assert without_sky({0: ties(12, 0, room=0.8)}, TUNING.proof) == {0}
    assert without_sky({0: ties(0, 0), 1: ties(0, 0)}, TUNING.proof) == set()


def test_a_rig_that_no_frames_show_to_move_has_no_platform():
    one = Matchability(Path("a"), np.zeros((1, 2), np.float32), np.ones(1, bool))
    for still in ([()] * 36, [], [(one, one)] + [()] * 35):
        assert not moves(still, TUNING.proof)
    assert moves([(one, one)] * 5 + [()] * 31, TUNING.proof)


def test_what_left_the_image_is_no_sign_of_water():
    rng = np.random.default_rng(3)
    here = rng.uniform((0, 0), (400, 180), (60, 2))
    every = np.column_stack([np.full(30, 200.0), np.linspace(5, 295, 30)])
    shown = _shown(every, here, here + (0, 120), SHAPE, TUNING.matchability)
    assert shown[every[:, 1] < 170].all() and not shown[every[:, 1] > 190].any()


def test_a_black_backdrop_is_no_platform_and_the_surround_of_a_lens_is():
    y, x = np.mgrid[:240, :320]
    rng = np.random.default_rng(5)

    def inside(k):
        coarse = np.random.default_rng(k).uniform(60, 220, (30, 40)).astype(np.float32)
        return cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC)

    lens = (x - 160) ** 2 + (y - 120) ** 2 < 115**2
    fisheye = [np.where(lens, inside(k), 0).clip(0, 255).astype(np.uint8) for k in range(12)]
    found = platform_of_frames(fisheye, TUNING.platform)
    assert found[~lens].mean() > 0.9 and found[(x - 160) ** 2 + (y - 120) ** 2 < 105**2].mean() < 0.02
    turned = []
    for k in range(12):
        a, b = rng.uniform(35, 75, 2)
        angle = rng.uniform(0, np.pi)
        u, v = (
            (x - 160) * np.cos(angle) + (y - 120) * np.sin(angle),
            (y - 120) * np.cos(angle) - (x - 160) * np.sin(angle),
        )
        body = (u / a) ** 2 + (v / b) ** 2 < 1
        turned.append(np.where(body, inside(100 + k), 0).clip(0, 255).astype(np.uint8))
    assert not platform_of_frames(turned, TUNING.platform).any()


def test_overexposed_areas_that_tie_are_a_surface():
    """White paint ties as its surroundings do, a burnt-out sky does not."""

    def ties(count, white, every=200):
        inside = np.zeros(5, int)
        inside[USE], inside[OVEREXPOSED] = every - count, count
        return MatchCounts(inside, area=10, white=white)

    assert white_ties([ties(20, 1.0), ties(0, 0.1)], TUNING.proof)
    for few in ([ties(3, 2.0)], [ties(2, 0.001)], []):
        assert not white_ties(few, TUNING.proof)
