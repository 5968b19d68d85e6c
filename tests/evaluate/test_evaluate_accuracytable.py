"""The accuracies as a table that spreadsheets open."""

import csv
import io

from tiegraph.evaluate.accuracy import accuracy_csv
from tiegraph.scene.accuracy import Accuracy, Figure


def test_every_figure_has_its_row():
    metrics = [{"name": "ate_se3_rmse", "value": 0.00676, "unit": "m"}, {"name": "ghosts", "value": None, "unit": "%"}]
    columns = ["point", "role", "dE m", "not used because"]
    tables = {"control and check points": {"columns": columns, "rows": [["A, 1", "check", 0.0123, None]]}}
    frames = [{"frame": 7, "residual_m": [0.01, -0.02, 0.03], "held_out_m": None}]
    layers = Accuracy("m", "nothing", (Figure("world", "a point", 0.37),), {"yaw_deg": 0.19}).to_dict()
    said = {"accuracy": layers, "metrics": metrics}
    rows = list(csv.DictReader(io.StringIO(accuracy_csv(said, tables, {"frames": frames}))))
    said = {(r["about"], r["item"], r["quantity"]): (r["value"], r["unit"]) for r in rows}
    assert said == {
        ("survey", "", "ate_se3_rmse"): ("0.00676", "m"),
        ("survey", "", "ghosts"): ("", "%"),
        ("accuracy", "", "world.predicted"): ("0.37", "m"),
        ("accuracy", "", "placement.yaw_deg"): ("0.19", ""),
        ("residual of a frame, m", "7", "east"): ("0.01", ""),
        ("residual of a frame, m", "7", "north"): ("-0.02", ""),
        ("residual of a frame, m", "7", "up"): ("0.03", ""),
        ("control and check points", "A, 1", "role"): ("check", ""),
        ("control and check points", "A, 1", "dE m"): ("0.0123", ""),
        ("control and check points", "A, 1", "not used because"): ("", ""),
    }
    assert len(rows) == len(said)
