"""Two passes of one survey: which cameras take part, what is stated by section, what becomes of it."""

import json

import numpy as np
import pytest

from clouds_world import ground
from tiegraph.evaluate.accuracy import Predicted, Stated, in_layers, passes_figure
from tiegraph.evaluate.clouds.judge import TABLE, PassAgreement, by_section, near_places
from tiegraph.evaluate.clouds.m3c2 import cylinders_of, m3c2_tiled
from tiegraph.evaluate.clouds.nearest import Cameras
from tiegraph.evaluate.clouds.tiles import tile_clouds
from tiegraph.evaluate.tuning import PassesTuning, Tuning
from tiegraph.scene.cloudchunks import Points, PointSource

TUNING = Tuning()


def source(xyz: np.ndarray) -> PointSource:
    return PointSource("pass", lambda: iter([Points(xyz, np.full(len(xyz), 0.003))]))


@pytest.fixture(scope="module")
def agreement(tmp_path_factory) -> PassAgreement:
    """Flat ground of 3 mm noise; the second pass is 2 cm higher where x > 0, which is another section."""
    first, second = ground(5_000, 0, 0.003), ground(5_000, 1, 0.003)
    second[second[:, 0] > 0, 2] += 0.02
    clouds = tile_clouds(source(first), source(second), tmp_path_factory.mktemp("tiles"), TUNING.cloud)
    cameras = Cameras(np.array([[-5.0, 0, 3], [5.0, 0, 3]]), ("0", "1"))
    found = m3c2_tiled(clouds, cylinders_of(clouds, TUNING.m3c2), TUNING.m3c2, cameras, most=300)
    assert 200 < len(found) < 700, "about as many core points as asked for"
    return PassAgreement(("up", "down"), (5, 6), (5, 9), by_section(found, cameras))


def test_a_step_in_one_section_is_found_there(agreement: PassAgreement) -> None:
    table = agreement.tables()[TABLE]
    rows = {row[0]: dict(zip(table["columns"], row)) for row in table["rows"]}
    assert list(rows) == ["all", "0", "1"]
    assert abs(rows["0"]["median m"]) < 0.003 and rows["1"]["median m"] == pytest.approx(0.02, abs=0.003)
    assert rows["0"]["significant %"] < 10 and rows["1"]["significant %"] > 80
    assert rows["all"]["core points"] == rows["0"]["core points"] + rows["1"]["core points"]
    assert {m.name for m in agreement.metrics()} == {"passes_median", "passes_spread", "passes_significant"}
    assert "5 of 5 and 6 of 9 depth maps" in agreement.note() and "does not tell what both share" in agreement.note()
    assert PassAgreement.from_dict(json.loads(json.dumps(agreement.to_dict()))) == agreement


def test_it_is_a_figure_of_the_shape_that_nothing_independent_measured(agreement: PassAgreement) -> None:
    predicted = Predicted(inside_m=0.006, scale=0.001)
    (figure,) = passes_figure(agreement, predicted)
    assert figure.key == "shape.passes" and not figure.independent and "what both passes share" in figure.proves_not
    assert 0.01 < figure.measured < 0.03
    # of the points 3 mm each, of two cameras 6 mm in space
    assert np.hypot(0.003 * 2**0.5, 0.006 * (2 / 3) ** 0.5) < figure.predicted < 0.008
    layers = in_layers(Stated(predicted=predicted), [figure])
    assert [f.key for f in layers.of("shape")] == ["shape.whole", "shape.passes"]


def test_what_was_not_compared_says_why_and_states_nothing() -> None:
    none = PassAgreement(("up", "down"), (5, 6), (5, 9), {}, "the clouds do not meet")
    assert none.metrics() == [] and none.tables() == {} and passes_figure(none, Predicted()) == []
    assert none.note() == "Passes up and down were not compared with each other: the clouds do not meet"


def test_of_many_cameras_those_near_places_along_the_way_take_part() -> None:
    along = np.column_stack([np.arange(300.0), np.zeros((300, 2))])
    tuning = PassesTuning(maps=40, places=5)
    first, second = near_places(along, along[::-1] + [0, 4.0, 0], tuning)
    assert len(first) == len(second) == 40
    assert np.abs(np.sort(299 - second) - first).max() <= 8, "of both passes the same places"
    assert np.diff(first).max() > 30 and first.min() > 30 and first.max() < 269
    few = near_places(along[:40], along[:7], tuning)
    assert len(few[0]) == 40 and len(few[1]) == 7
