"""What is sky, what moves with the camera, and what matches between images prove of sky, water and platform."""

from functools import cache
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pycolmap
import pytest

from masks_world import DECK, SHAPE, frame, smooth, write
from tiegraph.masks import EGO, OVEREXPOSED, SKY, USE, WATER
from tiegraph.masks.classification import _snapped, classes_of, pooled, textureless_regions
from tiegraph.masks.learnt import _like_sky, _wide, edges_of, learn, lowest_agreed, not_above
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
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.skyline import border_sky, places, without_points
from tiegraph.masks.tuning import Tuning

TUNING = Tuning()
PALE_BGR = (196, 190, 186)
HORIZON = 90  # row
EVERYWHERE = np.ones(SHAPE, bool)


@cache
def _ground():
    return smooth(1, (1000, 1400), (250, 350))[..., None] * np.float32([0.7, 1.0, 0.8])


def _taken(scene, seed):
    rng = np.random.default_rng(seed)
    return np.clip(scene + rng.normal(0, 1.5, scene.shape), 0, 255).astype(np.uint8)


@cache
def _field():
    """The ground from above, (1000, 1400, 3) f4, with roads of one pale grey."""
    field = 20 + 130 * _ground()
    for x in range(100, 1400, 330):
        cv2.line(field, (x, 0), (x + 60, 1000), PALE_BGR, 70)
    return field


def from_above(k):
    """Image k of a flight that turns at each leg, (240, 320, 3) u1."""
    leg, step = divmod(k, 6)
    y, x = 60 + 170 * leg, 100 + 55 * (step if leg % 2 else 5 - step)
    return _taken(_field()[y : y + SHAPE[0], x : x + SHAPE[1]], k)


def straight_ahead(k):
    """Image k of a walk along a hedge, dark at its top, below an overcast sky, (240, 320, 3) u1; the sky (240, 320)."""
    x = 14 * k
    tops = HORIZON + (40 * (smooth(2, (1, 1400), (1, 9))[0][x : x + SHAPE[1]] - 0.5)).astype(int)
    below = np.arange(SHAPE[0])[:, None] - tops
    scene = 20 + 130 * _ground()[: SHAPE[0], x : x + SHAPE[1]] * np.clip(below / 25, 0, 1)[..., None]
    sky = below < 0
    scene[sky] = PALE_BGR
    return _taken(scene, k), sky


def _found(tmp_path, images):
    paths = [write(tmp_path / f"{k:02d}.png", image) for k, image in enumerate(images)]
    made = learn({0: paths}, MasksSettings(), TUNING)[0]
    return made, np.stack([classes_of(p, made, MasksSettings(), SHAPE, TUNING) for p in paths])


@pytest.mark.slow
def test_pale_roads_seen_from_above_are_used(tmp_path):
    made, found = _found(tmp_path, [from_above(k) for k in range(12)])
    assert made.no_sky and (found == USE).mean() > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("roll", [0, 25])
def test_an_overcast_sky_of_the_same_looks_is_masked(tmp_path, roll):
    turn = cv2.getRotationMatrix2D((SHAPE[1] / 2, SHAPE[0] / 2), roll, 1.5)
    taken = [straight_ahead(k) for k in range(12)]
    images = [cv2.warpAffine(image, turn, SHAPE[::-1]) for image, _ in taken]
    sky = np.stack([cv2.warpAffine(s.astype(np.uint8), turn, SHAPE[::-1]) for _, s in taken]) > 0
    made, found = _found(tmp_path, images)
    assert not made.no_sky
    assert (found[sky] == SKY).mean() > 0.9 and (found[~sky] == USE).mean() > 0.98


def test_edges_of_a_sky_face_down_and_those_of_a_road_both_ways():
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    sky = edges_of(row < HORIZON, EVERYWHERE, TUNING)
    assert sky[0] == pytest.approx(sky[1]) and sky[1] == pytest.approx(SHAPE[1], rel=0.02)
    tilted = edges_of(row < HORIZON + 0.5 * (column - 160), EVERYWHERE, TUNING)
    assert tilted[0] / tilted[1] == pytest.approx(np.cos(np.arctan(0.5)), abs=0.02)
    road = edges_of(abs(column - 160 + 0.3 * row) < 30, EVERYWHERE, TUNING)
    yard = edges_of((abs(column - 160) < 40) & (abs(row - 120) < 40), EVERYWHERE, TUNING)
    assert abs(road[0]) < 0.02 * road[1] and abs(yard[0]) < 0.02 * yard[1]
    cut = edges_of(row < HORIZON, row < HORIZON, TUNING)
    assert cut[1] < 0.03 * sky[1], "where the sky is no longer sought it has no edge"


def test_all_level_cameras_say_together_whether_the_sky_is_above():
    own = TUNING
    assert not_above({0: [(40, 80), (10, 20)], 1: [(-5, 30)]}, own) == set()
    assert not_above({0: [(4, 80), (10, 20)], 1: [(9, 10)]}, own) == {0, 1}
    assert not_above({0: [(0.0, 0.0)], 1: []}, own) == set() == not_above({}, own), "nothing looks like sky"


WIDE = (360, 640)


@pytest.fixture
def street():
    """Classes with true sky at the left, and at the right a wall called sky, with two windows; points on the rest."""
    classes = np.full(WIDE, USE, np.uint8)
    classes[:150, :300] = SKY
    classes[:200, 340:] = SKY
    classes[60:84, 400:424] = classes[60:84, 500:524] = USE
    classes[320:] = WATER
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (3000, 2)).astype(np.float32)
    row, column = (points[:, 1] * WIDE[0]).astype(int), (points[:, 0] * WIDE[1]).astype(int)
    return classes, points[classes[row, column] == USE], rng


def test_a_wall_called_sky_is_found_out_by_points_in_and_on_it(street):
    classes, seen, rng = street
    on_wall = np.stack([rng.uniform(0.55, 0.99, 120), rng.uniform(0.02, 0.53, 120)], axis=1).astype(np.float32)
    found = without_points(classes, np.concatenate([seen, on_wall]), TUNING)
    assert (found[:150, :300] == SKY).all() and not (found[:, 340:] == SKY).any()
    assert (found[320:] == WATER).all() and (classes[:200, 340:] == SKY).any(), "the argument stays as it is"


def test_points_at_the_skyline_and_single_false_ones_leave_the_sky(street):
    classes, seen, rng = street
    edge = np.stack([rng.uniform(0, 0.46, 200), np.full(200, 148 / 360)], axis=1).astype(np.float32)
    false = np.float32([[0.1, 0.1], [0.2, 0.2], [0.3, 0.05]])
    found = without_points(classes, np.concatenate([seen, edge, false]), TUNING)
    assert (found[:150, :300] == SKY).all()
    sky = np.full(WIDE, SKY, np.uint8)
    assert without_points(sky, np.random.default_rng(0).uniform(0, 1, (50, 2)).astype(np.float32), TUNING) is sky
    use = np.full(WIDE, USE, np.uint8)
    assert without_points(use, np.zeros((0, 2), np.float32), TUNING) is use


def test_places_of_points_in_an_image():
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=360, params=[320, 320, 320, 180], camera_id=1)
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.eye(3)), np.array([0, 0, 2.0]))

    image = SimpleNamespace(cam_from_world=lambda: pose)
    points = np.array([[0, 0, 0], [1, 0.5, 0], [0, 0, -3], [40, 0, 1]], float)  # two in view, behind, aside
    assert places(image, camera, points, TUNING) == pytest.approx(np.array([[0.5, 0.5], [0.75, 0.5 + 80 / 360]]))


def test_regions_end_at_edges_and_hold_soft_clouds():
    image = np.full((200, 320), 180, np.float32)
    image[:90] += 25 * np.sin(np.linspace(0, 6, 320))[None]  # clouds: a few grey levels a pixel at most
    image[90:] = 100
    regions = textureless_regions(np.clip(image, 0, 255).astype(np.uint8), TUNING)
    above, below = regions[5:85], regions[95:195]
    assert (above == above[0, 0]).all() and (below == below[0, 0]).all() and 0 < above[0, 0] != below[0, 0] > 0
    assert (regions[89:91] == 0).any(), "the edge itself is of no region"


def test_a_region_is_judged_as_one():
    regions = np.zeros((10, 10), np.int32)
    regions[:, :5], regions[:, 6:] = 1, 2
    ratio = np.full((10, 10), 2.0, np.float32)
    ratio[:, 6:] = -9.0  # clipped: no single pixel outweighs all others
    mean = pooled(ratio, regions, TUNING)
    assert mean[0, 0] == pytest.approx(2) and mean[0, 9] == pytest.approx(-3) and (mean[:, 5] == 0).all()


def test_the_edge_of_the_sky_snaps_to_the_brightness():
    light = np.full((240, 640), 90, np.uint8)
    light[:100] = 200
    light = cv2.GaussianBlur(light, (3, 3), 0)
    labels = np.full((240, 640), USE, np.uint8)
    labels[:98] = SKY  # two pixels short
    found = _snapped(labels, light, TUNING)
    assert (found[:100] == SKY).all() and (found[101:] == USE).all()
    flat = _snapped(labels, np.full((240, 640), 128, np.uint8), TUNING)
    assert (flat == labels).all(), "no brightness tells: the edge stays"


def test_narrow_strips_are_no_seeds():
    sky = np.zeros((100, 320), bool)
    sky[:30, :200] = True
    sky[30:90, 100:120] = True  # a border that ran down a pale wall
    wide = _wide(sky, TUNING)
    assert (wide[:30, :200]).all() and not wide[30:].any()


@pytest.mark.parametrize("bottom, cloud", [(100, True), (200, False)])
def test_a_pale_piece_that_matches_is_a_cloud_above_the_horizon_and_a_wall_below_it(bottom, cloud):
    image = np.full((240, 320, 3), 40, np.uint8)
    image[:90] = 180  # the sky, of which the right part is not known yet
    image[60:bottom, 200:] = 230
    sky = np.zeros((240, 320), bool)
    sky[:60] = True
    across, down = np.meshgrid(np.linspace(0.65, 0.95, 12), np.linspace(0.3, 0.4, 8))
    xy = np.stack([across.ravel(), down.ravel()], axis=1).astype(np.float32)
    seen = Matchability(Path("a.jpg"), xy, np.ones(len(xy), bool), np.ones(len(xy)))
    found = _like_sky(image, sky, seen, TUNING, lowest=60 / 240)
    assert found[65:90, 210:310].all() == cloud
    assert not found[:60].any() and not _like_sky(image, sky & False, seen, TUNING, 0.3).any()


def test_the_lowest_sky_is_what_several_images_agree_on():
    rows = [0.0] * 20 + [0.3, 0.31, 0.33, 0.42, 0.43, 0.46]
    assert lowest_agreed([*rows, 1.0], TUNING) == pytest.approx(0.46), "a border found on a road is alone"
    assert lowest_agreed([*rows, 0.99, 1.0], TUNING) == pytest.approx(1.0)
    assert lowest_agreed([0.0, 0.4], TUNING) == pytest.approx(0.4)
    assert lowest_agreed([], TUNING) == lowest_agreed([0.0], TUNING) == 0


def _street(fisheye):
    image = np.full((240, 320, 3), (235, 200, 170), np.uint8)
    image[100:] = np.random.default_rng(0).uniform(20, 120, (140, 320, 3)).astype(np.uint8)
    if fisheye:
        image[(np.hypot(*np.meshgrid(np.arange(320) - 160, np.arange(240) - 120)) > 118)] = 0
    return image


@pytest.mark.slow
def test_the_sky_begins_below_the_surround_of_a_fisheye_lens():
    image = _street(fisheye=True)
    surround = (image == 0).all(axis=2)
    assert border_sky(image, TUNING) is None
    sky = border_sky(image, TUNING, surround)
    assert sky[20:90, 130:190].all() and not sky[105:].any() and not (sky & surround).any()


def test_sand_is_no_sky():
    image = _street(fisheye=False)
    assert border_sky(image, TUNING) is not None
    image[:100] = (150, 200, 220)
    assert border_sky(image, TUNING) is None


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


@pytest.mark.slow
@pytest.mark.parametrize("light", ["steady", "changing"])
def test_platform_is_found_in_any_light(light):
    gains = np.linspace(0.45, 1.2, 14) if light == "changing" else np.ones(14)
    found = platform_of_frames([scenery(k, g) for k, g in enumerate(gains)], TUNING)[0]
    truth = platform()[0] | platform()[1]
    assert 0.85 < iou(found, truth) <= 1 and found[~truth].mean() < 0.02


@pytest.mark.slow
def test_burnt_in_text_is_masked_and_no_outline_of_a_platform(tmp_path):
    """The sky of a vehicle's camera was taken for its platform, because letters stood still along its outline."""
    frames, places = [scenery(k) for k in range(12)], [(x, y) for x in (10, 130, 240) for y in (30, 62)]
    for k, image in enumerate(frames):
        across, rng = np.arange(SHAPE[1]), np.random.default_rng(k)
        skyline = 70 + 12 * np.sin(across / 25 + k) + rng.uniform(-10, 10)
        image[np.arange(SHAPE[0])[:, None] < skyline] = 225
    platform_alone, text = platform_of_frames(frames, TUNING)[0], np.zeros(SHAPE, bool)
    for x, y in places:
        text[y - 9 : y, x : x + 28] = True
        for image in frames:
            cv2.putText(image, "23.4C", (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.4, 0, 1, cv2.LINE_AA)
    assert iou(platform_of_frames(frames, TUNING)[0], platform_alone) > 0.95
    paths = [write(tmp_path / f"{k}.png", image) for k, image in enumerate(frames)]
    mask = learn_platform(paths, TUNING)[1]
    assert mask[text].mean() > 0.97 and mask[platform_alone].mean() > 0.97
    assert (mask & ~platform_alone).mean() < 0.1


@pytest.mark.slow
def test_nothing_is_invented_where_everything_moves():
    """And a far skyline that shakes is no platform."""
    rng = np.random.default_rng(3)
    frames = [cv2.GaussianBlur(rng.uniform(0, 255, SHAPE).astype(np.float32), (0, 0), 2) for _ in range(10)]
    assert not platform_of_frames([f.astype(np.uint8) for f in frames], TUNING)[0].any()
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
    assert platform_of_frames(frames, TUNING)[0].mean() < 0.01


@pytest.mark.slow
def test_standing_cameras_and_short_sequences_are_refused(tmp_path):
    still = [write(tmp_path / f"still{k}.png", scenery(0)) for k in range(12)]
    assert len(different_frames(still, TUNING)) == 1
    few = [write(tmp_path / f"few{k}.png", scenery(k)) for k in range(TUNING.platform.min_frames - 1)]
    for paths, why in ((still, "hardly moves"), (still[:1], "one image"), (few, ""), ([tmp_path / "absent.png"], "")):
        _, mask, note = learn_platform(paths, TUNING)
        assert mask is None and why in note


@pytest.mark.slow
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


@pytest.mark.slow
def test_what_is_black_in_every_frame_round_a_fisheye_image_is_no_scene():
    across, down = np.meshgrid(np.arange(SHAPE[1]) - SHAPE[1] / 2, np.arange(SHAPE[0]) - SHAPE[0] / 2)
    radius = np.hypot(across, down) / SHAPE[0]
    frames = [np.random.default_rng(k).uniform(40, 210, (30, 40)).astype(np.float32) for k in range(10)]
    frames = [np.where(radius > 0.48, 3, cv2.resize(f, SHAPE[::-1])).astype(np.uint8) for f in frames]
    mask = platform_of_frames(frames, TUNING)[0]
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
    near = nearness(a, b, SIZE, TUNING)
    known = np.isfinite(near)
    assert known[far].mean() > 0.5 and known[~far].mean() > 0.5
    assert (near[far & known] > TUNING.matchability.near).mean() < 0.2
    assert (near[~far & known] > TUNING.matchability.near).mean() > 0.7, "half of them refute a sky"


def test_what_cannot_be_told_is_unknown():
    a, b, _ = two_views(360, np.array([0.5, 0, 0]), 0.0)
    assert np.isnan(nearness(a, a + 1e-3, SIZE, TUNING)).all(), "no motion"
    assert np.isnan(nearness(a[:4], b[:4], SIZE, TUNING)).all(), "too few"


def test_ties_by_class():
    labels = np.repeat(np.array([SKY, USE, WATER, EGO], np.uint8), 25)[:, None].repeat(100, axis=1)
    y = np.array([0.1, 0.1, 0.24, 0.4, 0.4, 0.6, 0.9, 0.1])
    matched = np.array([1, 1, 1, 1, 1, 1, 1, 0], bool)
    near = np.array([1.0, 0.0, 1.0, 1, 1, 1, 1, np.nan], np.float32)
    evidence = Matchability(Path("a"), np.column_stack([np.full(8, 0.5), y]).astype(np.float32), matched, near)
    ties = matches_in(labels, labels == SKY, evidence, TUNING)
    assert ties.inside.tolist() == [2, 3, 1, 1, 0]
    assert (ties.near, ties.far) == (1, 1), "the third lies at the edge of the sky"


def test_the_skies_of_all_cameras_are_judged_together():
    def ties(near, far, room=0.1):
        return MatchCounts(np.zeros(5, int), near, far, told=40, area=1, room=room)

    assert without_sky({0: ties(21, 0), 1: ties(3, 0), 2: ties(0, 0)}, TUNING) == {0, 1, 2}
    assert without_sky({0: ties(21, 0), 1: ties(2, 40)}, TUNING) == set(), "the walls beside a true sky"
    assert without_sky({0: ties(1, 40), 1: ties(4, 0)}, TUNING) == set()
    assert without_sky({0: ties(2, 0)}, TUNING) == set(), "two matches prove nothing"
    assert without_sky({0: ties(5, 0, room=0.8)}, TUNING) == set(), "wires and tops of trees in a wide sky"
    assert without_sky({0: ties(12, 0, room=0.8)}, TUNING) == {0}
    assert without_sky({0: ties(0, 0), 1: ties(0, 0)}, TUNING) == set()


def test_a_rig_that_no_frames_show_to_move_has_no_platform():
    one = Matchability(Path("a"), np.zeros((1, 2), np.float32), np.ones(1, bool), np.zeros(1, np.float32))
    for still in ([()] * 36, [], [(one, one)] + [()] * 35):
        assert not moves(still, TUNING)
    assert moves([(one, one)] * 5 + [()] * 31, TUNING)


def test_what_left_the_image_is_no_sign_of_water():
    rng = np.random.default_rng(3)
    here = rng.uniform((0, 0), (400, 180), (60, 2))
    every = np.column_stack([np.full(30, 200.0), np.linspace(5, 295, 30)])
    shown = _shown(every, here, here + (0, 120), SIZE, TUNING)
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
    assert not platform_of_frames(turned, TUNING)[0].any()


def test_overexposed_areas_that_tie_are_a_surface():
    """White paint ties as its surroundings do, a burnt-out sky does not."""

    def ties(count, white, every=200):
        inside = np.zeros(5, int)
        inside[USE], inside[OVEREXPOSED] = every - count, count
        return MatchCounts(inside, area=10, white=white)

    assert white_ties([ties(20, 1.0), ties(0, 0.1)], TUNING)
    for few in ([ties(3, 2.0)], [ties(2, 0.001)], []):
        assert not white_ties(few, TUNING)
