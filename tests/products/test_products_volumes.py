from dataclasses import replace

import numpy as np
import pytest

import terrain_world as world
from said import refused
from tiegraph.geometry.transforms import PlacementError
from tiegraph.products.tuning import VolumeTuning
from tiegraph.products.volumes import (
    Known,
    Patch,
    area_of,
    crossing,
    epoch,
    level,
    lowest,
    plane,
    shared_errors,
    volumes,
)

TUNING = VolumeTuning()
SIZE, PIXEL, SIGMA = 130, 0.2, 0.03
ANGLES = np.linspace(0, 2 * np.pi, 24, endpoint=False)
AROUND = 13 + 7.5 * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=-1)
HEAP = np.pi * 6**2 * 3 / 3
NOTHING = Known()


def patch(seed=None, bell_px=0.0):
    """A cone of 3 m height and 6 m radius on a slope; noise by ``seed``, shared by neighbours."""
    empty = Patch(np.zeros((SIZE, SIZE)), np.full((SIZE, SIZE), SIGMA), np.array([0.0, SIZE * PIXEL]), PIXEL)
    x, y = empty.places()
    w = 0.1 * x - 0.05 * y + np.maximum(0, 3 - np.hypot(x - 13, y - 13) / 2)
    noise = 0.0 if seed is None else SIGMA * world.errors(w.shape, seed, bell_px)
    return replace(empty, w=w + noise)


def placed(**sigmas):
    """A placement that is unsure in one way."""
    order = ("turn_east", "turn_north", "turn_up", "east", "north", "up", "scale")
    variance = [sigmas.get(name, 0.0) ** 2 for name in order]
    return Known(PlacementError(np.array([200.0, -50.0, 3.0]), np.diag(variance)))


@pytest.mark.parametrize(("bell_px", "least"), [(0.0, 0.6), (2.5, 0.5), (5.0, 0.2)])
@pytest.mark.slow
def test_a_heap_is_as_large_as_its_sigma_says(bell_px, least):
    found = []
    for seed in range(20):
        heap = patch(seed, bell_px)
        found.append(volumes(heap, plane(heap, AROUND, NOTHING, TUNING), AROUND, NOTHING, TUNING))
    net = np.array([(v["net"].value - HEAP, v["net"].sigma) for v in found])
    assert np.mean(np.abs(net[:, 0]) < 2 * net[:, 1]) >= 0.9 and abs(net[:, 0].mean()) < net[:, 1].mean()
    assert least < np.sqrt(np.mean((net[:, 0] / net[:, 1]) ** 2)) < 1.5
    for name, truth in (("cut", HEAP), ("fill", 0.0)):
        off = np.array([(v[name].value - truth) / v[name].sigma for v in found])
        assert np.mean(np.abs(off) < 2) >= 0.9, name
    assert found[0]["net"].value == pytest.approx(found[0]["cut"].value - found[0]["fill"].value)


def test_without_noise_the_heap_is_exact_to_what_pixels_cut_off():
    heap = patch()
    assert volumes(heap, plane(heap, AROUND, NOTHING, TUNING), AROUND, NOTHING, TUNING)["net"].value == pytest.approx(
        HEAP, rel=2e-3
    )
    disc = patch()
    under = level(disc, 1.0, "")
    flat = replace(disc, w=np.full(disc.w.shape, 3.0))
    found = volumes(flat, under, AROUND, NOTHING, TUNING)
    assert found["cut"].value == pytest.approx(2 * area_of(AROUND), rel=2e-3) and found["fill"].value == 0
    assert area_of(AROUND) == pytest.approx(12 * 7.5**2 * np.sin(2 * np.pi / 24))


@pytest.mark.slow
def test_how_errors_are_shared_is_measured():
    alone, _ = shared_errors(patch(0), TUNING)
    assert alone < 1.5
    together, rest = shared_errors(patch(0, 2.5), TUNING)
    assert 25 < together < 4 * np.pi * 2.5**2 * 1.5 and rest == 0
    calm = patch(0)
    _, rest = shared_errors(replace(calm, sigma=2 * calm.sigma), TUNING)
    assert rest == pytest.approx(0.75, abs=0.1)  # of the stated variance a quarter shows


@pytest.mark.slow
def test_what_is_not_known_of_the_whole_counts_by_how_it_moves_the_volume():
    heap, area = patch(), area_of(AROUND)
    for known, base, expected in (
        (placed(scale=0.01), "plane", 3 * HEAP * 0.01),
        (placed(up=0.5), "plane", 0.0),
        (placed(up=0.5), "level", area * 0.5),
        (placed(turn_north=0.01), "plane", 0.0),
        (placed(east=3.0), "level", 0.0),  # the polygon goes along
    ):
        made = plane(heap, AROUND, known, TUNING) if base == "plane" else level(heap, -1.0, "")
        world_part = volumes(heap, made, AROUND, known, TUNING)["net"].parts["world"]
        assert world_part == pytest.approx(expected, rel=0.02, abs=0.05), (base, expected)
    under = level(heap, -1.0, "")
    parts = volumes(heap, under, AROUND, Known(over_polygon=0.1, whole=0.2), TUNING)["net"].parts
    assert parts["shape"] == pytest.approx(0.2 * area, rel=0.01) and parts["world"] == 0


@pytest.mark.slow
def test_another_survey_as_base_brings_its_own_errors():
    before, after = patch(1, 2.5), patch(2, 2.5)
    before = replace(before, w=before.w - 0.5)
    known = placed(up=0.3)
    found = volumes(after, epoch(before, known, ""), AROUND, known, TUNING)["net"]
    area = area_of(AROUND)
    assert abs(found.value - 0.5 * area) < 2 * found.sigma
    assert found.parts["world"] == pytest.approx(np.sqrt(2) * 0.3 * area, rel=0.01)


def test_a_base_at_the_lowest_ground_around():
    heap = patch()
    base = lowest(heap, AROUND, NOTHING, TUNING)
    x, y = heap.places()
    ring = np.hypot(x - 13, y - 13)
    least = (0.1 * x - 0.05 * y)[(ring > 7.5) & (ring < 9.5)].min()
    assert base.w[0, 0] == pytest.approx(least, abs=0.1)
    found = volumes(heap, base, AROUND, NOTHING, TUNING)
    assert found["net"].parts["base"] == pytest.approx(SIGMA * area_of(AROUND), rel=0.01) and found["fill"].value < 1


def test_a_base_of_ground_that_was_not_seen_is_an_error():
    heap = patch()
    with refused("was seen on .* of its length", "--base HEIGHT"):
        plane(replace(heap, w=np.where(heap.places()[0] < 12, heap.w, np.nan)), AROUND, NOTHING, TUNING)
    with refused("no ground was seen"):
        plane(replace(heap, w=np.full(heap.w.shape, np.nan)), AROUND, NOTHING, TUNING)


@pytest.mark.parametrize(
    ("polygon", "sides"),
    [
        ([(0, 0), (4, 0), (4, 4), (0, 4)], None),
        ([(0, 0), (4, 4), (4, 0), (0, 4)], (0, 2)),
        ([(0, 0), (4, 0), (4, 4), (2, -1), (0, 4)], (0, 2)),
        ([(0, 0), (1, 0), (2, 0), (2, 2)], None),
    ],
)
def test_a_polygon_that_crosses_itself_is_found(polygon, sides):
    assert crossing(np.array(polygon, float)) == sides
