"""Sky lies above the rest: pale roads seen straight from above are used, a sky of the same looks is masked."""

from functools import cache

import cv2
import numpy as np
import pytest

from masks_world import write
from tiegraph.masks import SKY, USE
from tiegraph.masks.classification import classes_of
from tiegraph.masks.labels import Edges, edges_of, not_above
from tiegraph.masks.learnt import learn
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Tuning

SIZE = (240, 320)
TUNING = Tuning()
PALE_BGR = (196, 190, 186)
HORIZON = 90  # row
EVERYWHERE = np.ones(SIZE, bool)


def _noise(seed, shape, cells):
    coarse = np.random.default_rng(seed).uniform(0, 1, cells).astype(np.float32)
    return cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)


@cache
def _ground():
    return _noise(1, (1000, 1400), (250, 350))[..., None] * np.float32([0.7, 1.0, 0.8])


@cache
def _hedge():
    return _noise(2, (1, 1400), (1, 9))[0]


def _taken(scene, seed):
    rng = np.random.default_rng(seed)
    return np.clip(scene + rng.normal(0, 1.5, scene.shape), 0, 255).astype(np.uint8)


def _field():
    """The ground from above, (1000, 1400, 3) f4, with roads of one pale grey."""
    field = 20 + 130 * _ground()
    for x in range(100, 1400, 330):
        cv2.line(field, (x, 0), (x + 60, 1000), PALE_BGR, 70)
    return field


FIELD = _field()


def from_above(k):
    """Image k of a flight that turns at each leg, (240, 320, 3) u1."""
    leg, step = divmod(k, 6)
    y, x = 60 + 170 * leg, 100 + 55 * (step if leg % 2 else 5 - step)
    return _taken(FIELD[y : y + SIZE[0], x : x + SIZE[1]], k)


def straight_ahead(k):
    """Image k of a walk along a hedge, dark at its top, below an overcast sky, (240, 320, 3) u1; the sky (240, 320)."""
    x = 14 * k
    tops = HORIZON + (40 * (_hedge()[x : x + SIZE[1]] - 0.5)).astype(int)
    below = np.arange(SIZE[0])[:, None] - tops
    scene = 20 + 130 * _ground()[: SIZE[0], x : x + SIZE[1]] * np.clip(below / 25, 0, 1)[..., None]
    sky = below < 0
    scene[sky] = PALE_BGR
    return _taken(scene, k), sky


def _found(tmp_path, images):
    paths = [write(tmp_path / f"{k:02d}.png", image) for k, image in enumerate(images)]
    made = learn({0: paths}, MasksSettings(), TUNING)[0]
    return made, np.stack([classes_of(p, made, MasksSettings(), SIZE, TUNING) for p in paths])


@pytest.mark.slow
def test_pale_roads_seen_from_above_are_used(tmp_path):
    made, found = _found(tmp_path, [from_above(k) for k in range(12)])
    assert made.no_sky
    assert (found == USE).mean() > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("roll", [0, 25])
def test_an_overcast_sky_of_the_same_looks_is_masked(tmp_path, roll):
    turn = cv2.getRotationMatrix2D((SIZE[1] / 2, SIZE[0] / 2), roll, 1.5)
    taken = [straight_ahead(k) for k in range(12)]
    images = [cv2.warpAffine(image, turn, SIZE[::-1]) for image, _ in taken]
    sky = np.stack([cv2.warpAffine(s.astype(np.uint8), turn, SIZE[::-1]) for _, s in taken]) > 0
    made, found = _found(tmp_path, images)
    assert not made.no_sky
    assert (found[sky] == SKY).mean() > 0.9 and (found[~sky] == USE).mean() > 0.98


def test_edges_of_a_sky_face_down_and_those_of_a_road_both_ways():
    row, column = np.mgrid[: SIZE[0], : SIZE[1]]
    sky = edges_of(row < HORIZON, EVERYWHERE, TUNING.labels)
    assert sky.down == pytest.approx(sky.length) and sky.length == pytest.approx(SIZE[1], rel=0.02)
    tilted = edges_of(row < HORIZON + 0.5 * (column - 160), EVERYWHERE, TUNING.labels)
    assert tilted.down / tilted.length == pytest.approx(np.cos(np.arctan(0.5)), abs=0.02)
    road = edges_of(abs(column - 160 + 0.3 * row) < 30, EVERYWHERE, TUNING.labels)
    yard = edges_of((abs(column - 160) < 40) & (abs(row - 120) < 40), EVERYWHERE, TUNING.labels)
    assert abs(road.down) < 0.02 * road.length and abs(yard.down) < 0.02 * yard.length
    cut = edges_of(row < HORIZON, row < HORIZON, TUNING.labels)
    assert cut.length < 0.03 * sky.length, "where the sky is no longer sought it has no edge"


def test_all_level_cameras_say_together_whether_the_sky_is_above():
    own = TUNING.labels
    assert not_above({0: [Edges(40, 80), Edges(10, 20)], 1: [Edges(-5, 30)]}, own) == set()
    assert not_above({0: [Edges(4, 80), Edges(10, 20)], 1: [Edges(9, 10)]}, own) == {0, 1}
    assert not_above({0: [Edges()], 1: []}, own) == set() == not_above({}, own), "nothing looks like sky"
