"""What moves with the camera, and what matches between images prove of sky, water and platform."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from masks_world import DECK, SHAPE, frame, smooth, write
from tiegraph.masks import EGO, OVEREXPOSED, SKY, USE, WATER
from tiegraph.masks.matchability import (
    Matchability,
    MatchCounts,
    _shown,
    matches_in,
    moves,
    nearness,
    white_ties,
    without_sky,
)
from tiegraph.masks.platform import different_frames, learn_platform, platform_of_frames
from tiegraph.masks.tuning import Tuning

TUNING = Tuning()


def scenery(k, gain=1.0):
    """A scene that moves, under a platform with an outline and a mast: what a deck looks like. (240, 320) u1."""
    rng = np.random.default_rng(50 + k)
    coarse = rng.uniform(40, 210, (40, 54)).astype(np.float32)
    image = cv2.resize(coarse, SHAPE[::-1], interpolation=cv2.INTER_LINEAR)
    for mask in platform():
        image[mask] = 150
    image[205:] += np.linspace(0, 20, 320)[None]
    image = gain * image + rng.normal(0, 1.5, SHAPE)
    return np.clip(image, 0, 255).astype(np.uint8)


def platform():
    deck, mast = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
    deck[190:] = True
    mast[100:190, 60:76] = True
    return deck, mast


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


@pytest.mark.parametrize("light", ["steady", "changing"])
def test_platform_is_found_in_any_light(light):
    gains = np.linspace(0.45, 1.2, 14) if light == "changing" else np.ones(14)
    found = platform_of_frames([scenery(k, g) for k, g in enumerate(gains)], TUNING.platform)
    truth = platform()[0] | platform()[1]
    assert 0.85 < iou(found, truth) <= 1 and found[~truth].mean() < 0.02


def test_nothing_is_invented_where_everything_moves():
    """And a far skyline that shakes is no platform."""
    rng = np.random.default_rng(3)
    frames = [cv2.GaussianBlur(rng.uniform(0, 255, SHAPE).astype(np.float32), (0, 0), 2) for _ in range(10)]
    assert not platform_of_frames([f.astype(np.uint8) for f in frames], TUNING.platform).any()
    # The upper part stands still but for a shake of a pixel, as a skyline does for a car; the lower part moves.
    far = cv2.GaussianBlur(np.random.default_rng(1).uniform(0, 255, (150, 340)).astype(np.float32), (0, 0), 3)
    frames = []
    for k in range(14):
        rng = np.random.default_rng(k)
        image = cv2.GaussianBlur(rng.uniform(0, 255, SHAPE).astype(np.float32), (0, 0), 3)
        x, y = rng.normal(0, 1.2, 2)
        shift = np.array([[1, 0, x - 10], [0, 1, y - 10]], np.float32)
        image[:120] = cv2.warpAffine(far, shift, (320, 120))
        frames.append(np.clip((image - 127) * 4 + 127, 0, 255).astype(np.uint8))
    assert platform_of_frames(frames, TUNING.platform).mean() < 0.01


def test_standing_cameras_and_short_sequences_are_refused(tmp_path):
    still = [write(tmp_path / f"still{k}.png", scenery(0)) for k in range(12)]
    assert len(different_frames(still, TUNING)) == 1
    few = [write(tmp_path / f"few{k}.png", scenery(k)) for k in range(TUNING.platform.min_frames - 1)]
    for paths, why in ((still, "hardly moves"), (still[:1], "one image"), (few, ""), ([tmp_path / "absent.png"], "")):
        _, mask, note = learn_platform(paths, TUNING)
        assert mask is None and why in note


def test_from_files_and_a_camera_without_platform(tmp_path):
    mask = learn_platform([write(tmp_path / f"{k}.png", scenery(k)) for k in range(9)], TUNING)[1]
    assert mask is not None and mask.shape == SHAPE and 0.15 < mask.mean() < 0.4
    mast = []
    for k in range(9):  # the deck cut off: a thin mast alone is too little for so few frames
        cut = np.where(np.arange(SHAPE[0])[:, None] < 190, scenery(k), 255 * (k % 2)).astype(np.uint8)[60:190]
        mast.append(write(tmp_path / f"mast{k}.png", cut))
    assert learn_platform(mast, TUNING)[1] is None
    bare = [write(tmp_path / f"bare{k}.png", frame(k)[60:DECK]) for k in range(8)]
    assert learn_platform(bare, TUNING)[1:] == (None, "no platform seen")


def test_what_is_black_in_every_frame_round_a_fisheye_image_is_no_scene():
    across, down = np.meshgrid(np.arange(SHAPE[1]) - SHAPE[1] / 2, np.arange(SHAPE[0]) - SHAPE[0] / 2)
    radius = np.hypot(across, down) / SHAPE[0]
    frames = [np.random.default_rng(k).uniform(40, 210, (30, 40)).astype(np.float32) for k in range(10)]
    frames = [np.where(radius > 0.48, 3, cv2.resize(f, SHAPE[::-1])).astype(np.uint8) for f in frames]
    mask = platform_of_frames(frames, TUNING.platform)
    assert mask[radius > 0.48].mean() > 0.97 and mask[radius < 0.44].mean() < 0.02


SIZE = (300, 400)


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
    near = nearness(a, b, SIZE, TUNING.matchability)
    known = np.isfinite(near)
    assert known[far].mean() > 0.5 and known[~far].mean() > 0.5
    assert (near[far & known] > TUNING.proof.near).mean() < 0.2
    assert (near[~far & known] > TUNING.proof.near).mean() > 0.7, "half of them refute a sky"


def test_what_cannot_be_told_is_unknown():
    a, b, _ = two_views(360, np.array([0.5, 0, 0]), 0.0)
    assert np.isnan(nearness(a, a + 1e-3, SIZE, TUNING.matchability)).all(), "no motion"
    assert np.isnan(nearness(a[:4], b[:4], SIZE, TUNING.matchability)).all(), "too few"


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
    one = Matchability(Path("a"), np.zeros((1, 2), np.float32), np.ones(1, bool), np.zeros(1, np.float32))
    for still in ([()] * 36, [], [(one, one)] + [()] * 35):
        assert not moves(still, TUNING.proof)
    assert moves([(one, one)] * 5 + [()] * 31, TUNING.proof)


def test_what_left_the_image_is_no_sign_of_water():
    rng = np.random.default_rng(3)
    here = rng.uniform((0, 0), (400, 180), (60, 2))
    every = np.column_stack([np.full(30, 200.0), np.linspace(5, 295, 30)])
    shown = _shown(every, here, here + (0, 120), SIZE, TUNING.matchability)
    assert shown[every[:, 1] < 170].all() and not shown[every[:, 1] > 190].any()


def test_a_black_backdrop_is_no_platform():
    y, x = np.mgrid[:240, :320] - np.array([120, 160])[:, None, None]
    rng, turned = np.random.default_rng(5), []
    for k in range(12):
        a, b = rng.uniform(35, 75, 2)
        angle = rng.uniform(0, np.pi)
        u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        body = (u / a) ** 2 + (v / b) ** 2 < 1
        turned.append(np.where(body, smooth(100 + k, (240, 320), (30, 40), (60, 220)), 0).clip(0, 255).astype(np.uint8))
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
