"""The layers of a run's accuracy: predicted and measured are of one thing, and a tolerance is answered by both."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from tiegraph.evaluate.accuracy import Hold, Predicted, Stated, accuracy_csv, answered, between, in_layers, pose_figures
from tiegraph.evaluate.trajectory import PoseMatch, evaluate_trajectory
from tiegraph.evaluate.tuning import TrajectoryTuning
from tiegraph.geometry import transforms
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
