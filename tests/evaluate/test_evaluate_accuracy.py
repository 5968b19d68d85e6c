"""The layers of a run's accuracy, references that contradict it, and two passes of one survey against each other."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clouds_world import ground, tiled
from tiegraph.evaluate.accuracy import (
    Hold,
    Predicted,
    Stated,
    accuracy_csv,
    answered,
    between,
    cloud_figure,
    in_layers,
    passes_figure,
    pose_figures,
)
from tiegraph.evaluate.clouds.judge import TABLE, PassAgreement, by_section, near_places
from tiegraph.evaluate.clouds.m3c2 import cylinders_of, m3c2_tiled
from tiegraph.evaluate.clouds.nearest import Cameras, cloud_to_cloud, criteria_of
from tiegraph.evaluate.clouds.tiles import tile_clouds
from tiegraph.evaluate.survey import against_cloud, against_poses
from tiegraph.evaluate.trajectory import PoseMatch, evaluate_trajectory
from tiegraph.evaluate.tuning import PassesTuning, TrajectoryTuning, Tuning
from tiegraph.geometry import transforms
from tiegraph.scene.cloudchunks import Points, PointSource
from tiegraph.scene.results import LAYERS, Accuracy, Figure

TUNING = TrajectoryTuning()
SIGMA = 0.03  # of a position, each axis
WORLD = {
    "placed": True,
    "sigma": {"position_m": 0.02, "tilt_deg": 0.3},
    "accuracy": {"check": {"points": 3.0, "rmse_m": 0.04, "predicted_m": 0.05}},
    "held_out": {"count": 4, "rms_m": {"east": 0.03, "north": 0.0, "up": 0.04}, "sigma_m": 0.1},
    "rms_m": {"east": 0.03, "north": 0.04, "up": 0.0},
}
PREDICTED = Predicted(0.01, 0.001, 20.0, placed_m=0.03, point_m=0.02, world_m=0.04, world_90_m=0.045)
HELD = Hold(source="GNSS positions", positions=14, frames=20, covered=6, checks=3)


def line(count: int, seed: int = 0, scale: float = 1.0) -> PoseMatch:
    """Poses every metre along a line with independent errors, in a model of another unit."""
    true = np.column_stack([np.arange(count), np.zeros(count), np.zeros(count)]).astype(float)
    true[:, 1] = np.sin(true[:, 0] / 9)
    off = SIGMA * np.random.default_rng(seed).standard_normal(true.shape)
    turn = np.tile(np.eye(3), (count, 1, 1))
    poses = (transforms.rigid(turn, p) for p in ((true + off) / scale, true))
    return PoseMatch(*poses, np.zeros(count, int), np.arange(count))


def figures_of(match: PoseMatch, predicted: Predicted, same: bool = False) -> dict[str, Figure]:
    found = evaluate_trajectory(match, (10.0,), TUNING, same_frame=same)
    return {f.key: f for f in pose_figures(match, found, predicted, TUNING)}


@pytest.mark.slow
def test_predicted_is_of_what_is_measured() -> None:
    """Independent errors of a known sigma: the vector between two cameras is off by sqrt(2) of one, the ratio is 1."""
    one = np.sqrt(3) * SIGMA
    known = np.array([[1.0, np.sqrt(2) * one], [150.0, np.sqrt(2) * one]])
    predicted = Predicted(inside_m=one, scale=1e-6, placed_m=0.0, between=known)
    found = figures_of(line(200), predicted, same=True)
    assert list(found) == ["shape.whole", "shape.10m", "shape.100m", "world.reference_poses"]
    assert all(0.9 < f.ratio < 1.1 for f in found.values())
    assert 1.3 < found["shape.10m"].measured / found["shape.whole"].measured < 1.55
    assert "shape.100m" not in figures_of(line(60), predicted)  # the survey is shorter
    assert np.isnan(predicted.over_m(0.5)) and np.isnan(predicted.over_m(400.0))


@pytest.mark.slow
def test_a_model_without_scale_is_measured_in_its_own_units() -> None:
    one = np.sqrt(3) * SIGMA
    found = figures_of(line(80, scale=10.0), Predicted(inside_m=one / 10))
    assert list(found) == ["shape.whole"] and 0.85 < found["shape.whole"].ratio < 1.15


def test_a_bend_shows_in_the_whole_and_less_over_a_short_way() -> None:
    bent = line(200).reference.copy()
    bent[:, 1, 3] += 1e-4 * (bent[:, 0, 3] - 100) ** 2
    true = line(200).reference[:, :3, 3]
    short, long = (between(bent[:, :3, 3], true, d, TUNING) for d in (10.0, 100.0))
    assert 0.05 < short < 0.2 < 0.4 < long < 1.5


@pytest.mark.slow
def test_layers_stand_in_order_and_each_begins_with_what_is_predicted() -> None:
    said = in_layers(Stated(PREDICTED, HELD, WORLD), figures_of(line(60), PREDICTED).values())
    layers = [f.layer for f in said.figures]
    assert list(dict.fromkeys(layers)) == list(LAYERS) and layers == sorted(layers, key=list(LAYERS).index)
    assert all(np.isfinite(said.of(layer)[0].predicted) for layer in LAYERS)
    assert said.held_by == "GNSS positions of 14 of 20 frames" and said.placement == WORLD["sigma"]
    values = said.values()
    assert values["world.predicted"] == 0.04 and values["world.check_points.ratio"] == pytest.approx(0.8)
    assert values["world.held_out.measured"] == pytest.approx(0.05)
    assert not said.figure("world.held_out").independent and said.figure("world.check_points").independent
    assert all(f.proves_not for f in said.figures)
    assert Accuracy.from_dict(said.to_dict()).to_dict() == said.to_dict()
    bare = in_layers(Stated(Predicted(inside_m=0.01, point_m=0.02)), ())  # not placed: no figure in the world
    assert bare.of("world") == [] and bare.unit == "units" and bare.held_by == "nothing"


@pytest.mark.parametrize(
    ("tolerance", "predicted", "world", "said", "because"),
    [
        (0.05, PREDICTED, WORLD, "yes", "3 check points measured no more"),
        (0.05, PREDICTED, {**WORLD, "accuracy": {}}, "cannot be told", "nothing independent measured it"),
        (0.045, replace(PREDICTED, world_90_m=0.2), WORLD, "cannot be told", "not of nine in ten"),
        (0.03, PREDICTED, WORLD, "no", "3 check points measured more"),
        (0.03, PREDICTED, {**WORLD, "accuracy": {}}, "no", "less than half of the points"),
        (0.05, replace(PREDICTED, world_m=0.4, world_90_m=0.5), WORLD, "cannot be told", "not the cloud as a whole"),
        (0.05, Predicted(0.01, 0.01), {"placed": False}, "cannot be told", "nothing holds the survey in the world"),
        (0.05, Predicted(0.01), {"placed": False}, "cannot be told", "nothing tells the scale"),
    ],
)  # fmt: skip
def test_a_tolerance_is_answered(tolerance: float, predicted: Predicted, world: dict, said: str, because: str) -> None:
    stated = Stated(predicted, HELD, world)
    answer = answered(tolerance, in_layers(stated, ()), stated, contradicted=False, min_checks=3)
    assert (answer.said, answer.tolerance_m) == (said, tolerance) and because in answer.why
    assert bool(answer.remedy) == (said != "yes")


def test_what_would_make_it_yes_is_what_the_error_is_made_of() -> None:
    def remedy(predicted: Predicted, hold: Hold) -> str:
        stated = Stated(predicted, hold, WORLD)
        return answered(0.01, in_layers(stated, ()), stated, False, 3).remedy

    placed = replace(PREDICTED, world_m=0.4, world_90_m=0.5)
    assert "positions under the bridge (6 frames" in remedy(placed, HELD)
    assert "more control points" in remedy(placed, Hold(control=4))
    assert "nearer to the surface" in remedy(replace(placed, point_m=0.39), HELD)
    assert "overlap" in remedy(replace(placed, world_m=0.03, inside_m=0.2), HELD)


def test_a_survey_that_contradicts_itself_or_has_too_few_check_points_holds_no_tolerance() -> None:
    stated = Stated(PREDICTED, HELD, WORLD)
    assert answered(0.05, in_layers(stated, ()), stated, True, 3).said == "cannot be told"
    few = Stated(PREDICTED, replace(HELD, checks=2), WORLD)
    fine, bad = (answered(t, in_layers(few, ()), few, False, 3) for t in (0.05, 0.03))
    assert (fine.said, bad.said) == ("cannot be told", "no") and "one or two are too few" in fine.remedy


def test_every_figure_has_its_row():
    metrics = [{"name": "ate_se3_rmse", "value": 0.00676, "unit": "m"}, {"name": "ghosts", "value": None, "unit": "%"}]
    columns = ["point", "role", "dE m", "not used because"]
    tables = {"control and check points": {"columns": columns, "rows": [["A, 1", "check", 0.0123, None]]}}
    frames = [{"frame": 7, "residual_m": [0.01, -0.02, 0.03], "held_out_m": None}]
    layers = Accuracy("m", "nothing", (Figure("world", "a point", 0.37),), {"yaw_deg": 0.19}).to_dict()
    rows = csv.DictReader(
        io.StringIO(accuracy_csv({"accuracy": layers, "metrics": metrics}, tables, {"frames": frames}))
    )
    assert sorted("|".join(row[n] for n in ("about", "item", "quantity", "value", "unit")) for row in rows) == [
        "accuracy||placement.yaw_deg|0.19|",
        "accuracy||world.predicted|0.37|m",
        "control and check points|A, 1|dE m|0.0123|",
        "control and check points|A, 1|not used because||",
        "control and check points|A, 1|role|check|",
        "residual of a frame, m|7|east|0.01|",
        "residual of a frame, m|7|north|-0.02|",
        "residual of a frame, m|7|up|0.03|",
        "survey||ate_se3_rmse|0.00676|m",
        "survey||ghosts||%",
    ]


STATED = Predicted(inside_m=0.002, scale=0.0005, spread_m=12.2, placed_m=0.05, point_m=0.01)
BESIDE = Tuning()


def way(seed: int = 0) -> np.ndarray:
    """(60, 3) a bent way with hills."""
    s = np.linspace(0, 40, 60)
    return np.stack([s, 5 * np.sin(s / 6), 2 * np.cos(s / 4)], axis=1)


def judged(
    reference: np.ndarray,
    estimate: np.ndarray | None = None,
    predicted: Predicted = STATED,
    same=False,
    registered=1.0,
) -> list:
    """What is said of reference positions of the way; the model stands turned and moved elsewhere."""
    est = way() if estimate is None else estimate
    est = est + 0.002 / np.sqrt(3) * np.random.default_rng(1).standard_normal(est.shape)
    if not same:
        est = est @ Rotation.from_rotvec([0.3, 0.2, 1.0]).as_matrix().T + [5, -3, 2]
    turn = np.tile(np.eye(3), (60, 1, 1))
    match = PoseMatch(transforms.rigid(turn, est), transforms.rigid(turn, reference), np.zeros(60, int), np.arange(60))
    found = evaluate_trajectory(match, (10.0,), BESIDE.trajectory, same_frame=same)
    figures = pose_figures(match, found, predicted, BESIDE.trajectory)
    return against_poses(match, figures, predicted.metric, 0.5, registered)


@pytest.mark.slow
def test_a_reference_that_agrees_is_no_contradiction() -> None:
    assert judged(way()) == []
    assert judged(way() + 0.002 * np.random.default_rng(2).standard_normal((60, 3))) == []
    assert judged(way() * [1, 0.001, 1], predicted=Predicted()) == []  # nothing predicted, nothing said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reference", "why"),
    [
        (way() * [1, 0.001, 1], "y axis differs in scale, it is 0.001 times"),
        (way() * [1, 1, 3.0], "z axis differs in scale, it is 3 times"),
        (way()[:, [1, 0, 2]], "mirror image"),
        (way() * [1, 1, -1], "mirror image"),
        (way() * 1.2, "1.2 times as large"),
    ],
)
def test_what_is_wrong_with_a_reference_is_named(reference: np.ndarray, why: str) -> None:
    (text,) = judged(reference)
    assert why in text
    assert "predicted" in text and "mm" in text.split("predicted")[1] and "chance does once in 1000" in text


@pytest.mark.slow
def test_a_torn_model_makes_no_mirror_image_of_the_reference() -> None:
    """Nor is anything named that hardly explains the error."""
    (text,) = judged(way() * [1, 1, -1], registered=0.6)
    assert "mirror" not in text and "one of the two is wrong" in text
    (text,) = judged(way() * [1, 1, -1] + 0.6 * np.random.default_rng(4).standard_normal((60, 3)))
    assert "mirror" not in text and "one of the two is wrong" in text


@pytest.mark.slow
def test_a_lag_is_named_with_its_time() -> None:
    s = np.linspace(0, 60, 60) ** 1.0 * 2 / 3
    speed = 1 + 0.6 * np.sin(np.arange(60) / 7)
    s = np.cumsum(speed)
    there = lambda v: np.stack([v, 5 * np.sin(v / 6), 2 * np.cos(v / 4)], axis=1)  # noqa: E731
    (text,) = judged(there(np.interp(np.arange(60) - 0.4, np.arange(-1, 60), np.insert(s, 0, s[0] - 1))), there(s))
    assert "times are off by" in text and "frames (" in text


@pytest.mark.slow
def test_a_shift_on_the_earth_is_said_apart() -> None:
    assert judged(way() + [0.03, 0.0, 0.0], same=True) == []
    (text,) = judged(way() + [0.0, 1.5, 0.0], same=True)
    assert "on the Earth" in text and "-1.50 m north" in text


@pytest.mark.slow
def test_a_cloud_farther_than_predicted(tmp_path) -> None:
    def said(cloud: np.ndarray) -> Figure:
        clouds = tiled(cloud, wall, tmp_path)
        found = cloud_to_cloud(clouds, criteria_of(clouds, (0.02, 0.2)), tmp_path)
        return cloud_figure(found, 3.0, STATED, True)

    rng = np.random.default_rng(0)
    wall = np.column_stack([rng.uniform(0, 10, 20000), np.zeros(20000), rng.uniform(0, 4, 20000)])
    near = wall[:8000] + [0.0, 0.01, 0.0] * rng.standard_normal((8000, 1))
    fits = said(near)
    assert against_cloud(fits) == [] and 0.3 < fits.ratio < 1.5
    (text,) = against_cloud(said(near + [0, 0.18, 0]))
    assert "differ by 0.18" in text or "differ by 0.17" in text


TUNING_PASSES = Tuning()


def source(xyz: np.ndarray) -> PointSource:
    return PointSource("pass", lambda: iter([Points(xyz, np.full(len(xyz), 0.003))]))


@pytest.fixture(scope="module")
def agreement(tmp_path_factory) -> PassAgreement:
    """Flat ground of 3 mm noise; the second pass is 2 cm higher where x > 0, which is another section."""
    first, second = ground(5_000, 0, 0.003), ground(5_000, 1, 0.003)
    second[second[:, 0] > 0, 2] += 0.02
    clouds = tile_clouds(source(first), source(second), tmp_path_factory.mktemp("tiles"), TUNING_PASSES.cloud)
    cameras = Cameras(np.array([[-5.0, 0, 3], [5.0, 0, 3]]), ("0", "1"))
    found = m3c2_tiled(clouds, cylinders_of(clouds, TUNING_PASSES.m3c2), TUNING_PASSES.m3c2, cameras, most=300)
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
    stored = json.loads(json.dumps(asdict(agreement)))
    assert PassAgreement(**stored).note() == agreement.note() and asdict(PassAgreement(**stored)) == stored


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
