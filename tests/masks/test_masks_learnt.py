"""Masks learnt from a boat's own images, and the line of the water by its level."""

import cv2
import numpy as np
import pytest

from masks_world import SHAPE, smooth, write
from tiegraph.masks import EGO, NAMES, OVEREXPOSED, SKY, USE, WATER, classification
from tiegraph.masks.classification import classes_of
from tiegraph.masks.learnt import learn
from tiegraph.masks.matchability import Matchability, choose_pairs, pair_matchability
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.skyline import border_sky, textureless_sky
from tiegraph.masks.tuning import Tuning
from tiegraph.masks.waterline import (
    Lines,
    View,
    below_waterline,
    columns,
    final_classes,
    find_water,
    first_line,
    lines_of,
    never_matching,
    water_priors,
)

TUNING = Tuning()
SKYLINE, SHORE, DECK = 70, 150, 215  # rows


WALL = {c: smooth(c, (SHORE - SKYLINE + 8, 2000), (44, 900)) for c in range(4)}


def river(camera, k):
    """Frame k of a boat's camera: sky, a wall that passes, water that is new in every frame, a deck; u1 BGR."""
    image = np.zeros((*SHAPE, 3), np.float32)
    image[:SKYLINE] = np.float32([225, 190, 160]) + 6 * smooth(9, (SKYLINE, 320), (3, 4))[..., None]
    roof = SKYLINE - 8 + 5 * (k % 3)  # what passes is not of one height
    wall = WALL[camera][roof - SKYLINE + 8 :, 40 + 14 * k : 360 + 14 * k]
    image[roof:SHORE] = (40 + 150 * wall)[..., None] * np.float32([0.6, 0.75, 1.0])
    ripples = smooth(1000 * camera + k, (DECK - SHORE, 320), (26, 70))
    image[SHORE:DECK] = (20 + 130 * ripples)[..., None] * np.float32([0.8, 1.0, 0.7])
    image[DECK:] = 170
    rng = np.random.default_rng(k)
    return np.clip(image * rng.uniform(0.85, 1.1) + rng.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def boat(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boat")
    return {c: [write(folder / f"cam{c}/{k:03d}.png", river(c, k)) for k in range(9)] for c in range(3)}


@pytest.fixture(scope="module")
def learnt(boat):
    return learn(boat, MasksSettings(source="learnt"), TUNING)


def truth():
    rows = np.repeat([SKY, USE, WATER, EGO], [SKYLINE, SHORE - SKYLINE, DECK - SHORE, SHAPE[0] - DECK])
    return np.repeat(rows[:, None], SHAPE[1], axis=1)


@pytest.mark.slow
def test_sky_water_and_platform_of_a_boat(boat, learnt):
    for camera, images in boat.items():
        assert "platform" in learnt[camera].note and learnt[camera].note.endswith(", water")
        for image in images[::5]:
            found = classes_of(image, learnt[camera], MasksSettings(), SHAPE, TUNING)
            assert ((found == USE) == (truth() == USE)).mean() > 0.93
            for label in (SKY, WATER, EGO):
                both, either = ((found == label) & (truth() == label)).sum(), (found == label) | (truth() == label)
                assert both / either.sum() > 0.75, NAMES[label]


@pytest.mark.slow
def test_tables_and_maps_of_other_sizes_do_as_well_and_water_is_where_it_is_asked_for(boat):
    varied = {
        "work_px": 512,
        "sky": {"bins": 13, "texture_edges_grey": (1.0, 3.0, 8.0), "places": (9, 11)},
        "water": {"grid": (45, 70)},
    }
    tuning = Tuning.model_validate(varied)
    prepared = learn({0: boat[0]}, MasksSettings(water="on"), tuning)[0]
    assert prepared.note.endswith(", water") and prepared.water.shape == (45, 70) and prepared.sky.shape == (9, 11)
    assert {len(t) for t in prepared.table.values()} == {13**3 * 4}
    found = classes_of(boat[0][5], prepared, MasksSettings(), SHAPE, tuning)
    assert ((found == USE) == (truth() == USE)).mean() > 0.9


@pytest.mark.slow
def test_one_camera_has_no_water_if_it_is_not_asked_for_and_twice_the_same_classes(boat):
    again = [learn({0: boat[0]}, MasksSettings(), TUNING)[0] for _ in range(2)]
    assert all(a.note.endswith("no water seen") for a in again)
    a, b = (classes_of(boat[0][3], x, MasksSettings(), SHAPE, TUNING) for x in again)
    assert (a == b).all(), "twice the same"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["grey", "deep", "exposures", "all sky", "one", "still", "dark"])
def test_odd_sequences_give_a_result_and_invent_nothing(tmp_path, kind):
    frames = {
        "grey": lambda k: river(0, k)[..., 1],
        "deep": lambda k: river(0, k).astype(np.uint16) * 257,
        "exposures": lambda k: np.clip(river(0, k) * (0.45, 1.0, 1.25)[k % 3], 0, 245).astype(np.uint8),
        "all sky": lambda k: np.full((*SHAPE, 3), (230, 190, 150), np.uint8),
        "one": lambda k: river(0, 0),
        "still": lambda k: river(0, 0),
        "dark": lambda k: np.zeros((*SHAPE, 3), np.uint8),
    }[kind]
    images = [write(tmp_path / f"{k:02d}.png", frames(k)) for k in range(1 if kind == "one" else 8)]
    prepared = learn({0: images}, MasksSettings(), TUNING)[0]
    found = classes_of(images[0], prepared, MasksSettings(), SHAPE, TUNING)
    assert found.shape == SHAPE and not (found == WATER).any()
    if kind in ("one", "still", "all sky", "dark"):
        assert prepared.platform is None and "no platform learnt" in prepared.note
    if kind == "dark":
        assert (found == USE).all()
    elif kind != "all sky":
        assert (found[SKYLINE + 10 : SHORE] == USE).mean() > 0.9


@pytest.mark.slow
def test_burnt_out_areas_are_masked(tmp_path):
    images = [write(tmp_path / f"{k}.png", river(0, k)) for k in range(2)]
    image = cv2.imread(str(images[0]))
    image[90:130, 100:180] = 255
    burnt = write(tmp_path / "burnt.png", image)
    found = classes_of(burnt, learn({0: images}, MasksSettings(), TUNING)[0], MasksSettings(), SHAPE, TUNING)
    assert (found[94:126, 104:176] == OVEREXPOSED).all()


@pytest.mark.slow
def test_border_of_the_sky_and_calm_sky_of_an_upward_camera():
    sky = border_sky(river(0, 0), TUNING)
    assert sky is not None and sky[: SKYLINE - 16].mean() > 0.95 and sky[SKYLINE + 4 :].mean() < 0.02
    assert border_sky(river(0, 0)[SKYLINE:DECK], TUNING) is None
    assert border_sky(np.full((*SHAPE, 3), 128, np.uint8), TUNING) is None
    image = river(0, 0)
    sky = textureless_sky(image[:SHORE], np.zeros((SHORE, 320), bool), TUNING)
    assert sky is not None and sky[: SKYLINE - 8].mean() > 0.9 and sky[SKYLINE + 8 :].mean() < 0.05
    assert textureless_sky(image // 4, np.zeros(SHAPE, bool), TUNING) is None, "a dark calm area is a bridge"


@pytest.mark.slow
def test_pairs_tell_what_matches(boat, monkeypatch):
    found_in_both = pair_matchability((boat[0][3], boat[0][4]), TUNING)
    assert len(found_in_both) == 2
    for found in found_in_both:
        row = found.xy[:, 1] * SHAPE[0]
        wall, water = (row > SKYLINE) & (row < SHORE - 6), (row > SHORE + 6) & (row < DECK - 6)
        assert found.matched[wall].mean() > 0.15 and found.matched[water].mean() < 0.05
    assert pair_matchability((boat[0][0], boat[1][0]), TUNING) == ()
    assert [len(p) for p in choose_pairs([boat[0], boat[1][:1], []], Tuning(samples=6))] == [2, 0, 0]

    def refuse(*_):
        raise cv2.error("(-215:Assertion failed) !model.empty() in function 'setModelParameters'")

    monkeypatch.setattr(cv2, "findFundamentalMat", refuse)
    assert pair_matchability((boat[0][3], boat[0][4]), TUNING) == ()


def test_a_zone_that_never_matches():
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 1, (4000, 2)).astype(np.float32)
    matched = (xy[:, 1] < 0.6) & (rng.uniform(size=4000) < 0.3)
    zone = never_matching([Matchability(None, xy, matched, xy[:, 0])], None, TUNING)
    rows = zone.mask.mean(axis=1)
    assert rows[:33].max() == 0 and rows[39:].min() > 0.9 and zone.says > 100
    everywhere = never_matching([Matchability(None, xy, rng.uniform(size=4000) < 0.3, xy[:, 0])], None, TUNING)
    assert everywhere.says < 8
    assert water_priors({0: zone, 1: zone}, asked=False, tuning=TUNING) == {}
    assert set(water_priors({0: zone, 1: zone, 2: everywhere}, asked=False, tuning=TUNING)) == {0, 1, 2}
    for nowhere in ({0: everywhere}, {}):
        assert water_priors(nowhere, asked=True, tuning=TUNING) == {}


def test_waterline_is_the_best_line_and_spares_the_platform():
    rng = np.random.default_rng(2)
    ratio = np.where(np.arange(120)[:, None] < 70, -1.0, 1.0) + rng.normal(0, 2, (120, 160))
    ego = np.zeros((120, 160), bool)
    ego[110:, 40:] = True
    water = below_waterline(ratio.astype(np.float32), ego, TUNING)
    assert not water[ego].any() and np.abs(water.argmax(axis=0) - 70).max() <= 8
    assert not below_waterline(np.full((120, 160), -1, np.float32), None, TUNING).any()


def test_appearance_is_learnt_from_counts():
    blue, grey = np.full((8, 8, 3), (220, 150, 90), np.uint8), np.full((8, 8, 3), 120, np.uint8)
    own = TUNING
    blue, grey = (classification.bins(image, own) for image in (blue, grey))
    counts = {
        k: np.bincount(image.ravel(), minlength=classification.bin_count(own))
        for k, image in ((SKY, blue), (USE, grey))
    }
    counts |= {WATER: np.zeros(classification.bin_count(own))}
    table = classification.learn_appearance(counts, own, counts)
    assert (
        classification.log_ratio(table, blue, SKY).min() > 2 and classification.log_ratio(table, grey, SKY).max() < -2
    )
    assert not classification.log_ratio(table, blue, WATER).any()


FOCAL = 200.0
DEPTH, BANK = 2.0, 10.0  # water below the cameras, banks to both sides; up = z, the boat goes along y


def view(y, yaw_deg):
    across, down = np.meshgrid(columns(SHAPE[1], TUNING) + 0.5 - SHAPE[1] / 2, np.arange(SHAPE[0]) + 0.5 - SHAPE[0] / 2)
    rays = np.stack([across, down, np.full(across.shape, FOCAL)], axis=-1)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    world_from_camera = np.array([[c, 0, s], [-s, 0, c], [0, -1, 0]])  # right, down, forward -> east, north, up
    return View(rays @ world_from_camera.T, np.array([0.0, y, 0.0]))


def true_line(v):
    """Row of the water's edge at each column, NaN where it is too far."""
    flat = np.abs(v.rays[SHAPE[0] // 2, :, 0]) / np.linalg.norm(v.rays[SHAPE[0] // 2, :, :2], axis=1)
    distance = BANK / flat
    slope = v.slopes(np.array([0, 0, 1.0]))
    row = (slope < -DEPTH / distance).argmax(axis=0).astype(float)
    return np.where(distance < 40, row, np.nan)


@pytest.fixture(scope="module")
def survey():
    rng = np.random.default_rng(0)
    walls = [np.c_[np.full(4000, x), rng.uniform(-40, 60, 4000), rng.uniform(-DEPTH, 3, 4000)] for x in (-BANK, BANK)]
    points = np.concatenate(walls) + rng.normal(0, 0.02, (8000, 3))
    return [view(y, yaw) for y in np.arange(0, 20, 2.0) for yaw in (60, 90, -90, -60)], points


UP = np.array([0, 0, 1.0])


@pytest.mark.slow
def test_level_of_the_water_in_spite_of_wrong_first_masks(survey):
    views, points = survey
    rng = np.random.default_rng(1)
    lines = [true_line(v) + rng.normal(0, 5, len(true_line(v))) for v in views]
    water = find_water(views, lines, points, UP, TUNING)
    assert water is not None and 0 < abs(water.depth - DEPTH) < 0.1 and water.rays > 500
    errors = np.concatenate([lines_of(v, UP, water).water - true_line(v) for v in views])
    assert 0 < np.nanpercentile(np.abs(errors), 90) < 4


def test_no_level_without_agreement(survey):
    views, points = survey
    rng = np.random.default_rng(1)
    nothing = [np.full(len(true_line(v)), np.nan) for v in views]
    wild = [rng.uniform(125, 239, len(line)) for line in nothing]
    for seen, lines, there in (
        (views, nothing, points), (views, wild, points), ([], [], points), (views, wild, np.zeros((0, 3))),
        (views, wild, points + [0, 0, 50]),
    ):  # fmt: skip
        assert find_water(seen, lines, there, UP, TUNING) is None


def test_final_classes(survey):
    views, points = survey
    water = find_water(views, [true_line(v) for v in views], points, UP, TUNING)
    first = np.full(SHAPE, USE, np.uint8)
    first[:60] = SKY
    first[190:] = WATER
    first[200:210, :50] = SKY
    first[220:] = EGO
    lines = lines_of(views[1], UP, water)
    found = final_classes(first, lines, TUNING)
    row = int(np.nanmedian(true_line(views[1])))
    assert (found[:60] == SKY).all() and (found[220:] == EGO).all()
    assert (found[row + 4 : 220] == WATER).all() and (found[60 : row - 4] == USE).all()
    dry = final_classes(first, lines_of(views[1], UP, None), TUNING)
    assert (dry[190:200] == WATER).all() and not (dry[130:] == SKY).any()


def test_first_line_ignores_what_the_platform_hides():
    classes = np.full((40, 32), USE, np.uint8)
    classes[20:] = WATER
    classes[10:20, :16] = EGO
    line = first_line(classes, TUNING)
    half = len(line) // 2
    assert np.isnan(line[:half]).all() and (line[half:] == 20).all()
    assert np.isnan(first_line(np.zeros((40, 32), np.uint8), TUNING)).all()


def test_gaps_in_the_banks_are_bridged_and_their_ends_are_not():
    first = np.full((60, 320), USE, np.uint8)
    line = np.full(80, 30.0)
    line[20:32] = np.nan  # a pier without points
    line[:8] = np.nan  # nothing is known there
    found = final_classes(first, Lines(line, np.zeros(80)), TUNING)
    assert (found[35:, 80:130] == WATER).all() and (found[:28] == USE).all()
    assert (found[:, :16] == USE).all()
    open_water = np.full(80, np.nan)
    open_water[[0, 79]] = 30.0  # too wide to bridge
    assert (final_classes(first, Lines(open_water, np.zeros(80)), TUNING)[:, 80:240] == USE).all()
