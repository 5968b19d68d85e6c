"""The accuracies as a table that spreadsheets open."""

import csv
import io

from tiegraph.evaluate.accuracytable import accuracy_csv


def test_every_figure_has_its_row():
    metrics = [{"name": "ate_se3_rmse", "value": 0.00676, "unit": "m"}, {"name": "ghosts", "value": None, "unit": "%"}]
    columns = ["point", "role", "dE m", "not used because"]
    tables = {"control and check points": {"columns": columns, "rows": [["A, 1", "check", 0.0123, None]]}}
    frames = [{"frame": 7, "residual_m": [0.01, -0.02, 0.03], "held_out_m": None}]
    world = {"rms_m": {"east": 0.05}, "sigma": {"yaw_deg": 0.19}, "held_out_rms_m": None, "frames": frames}
    rows = list(csv.DictReader(io.StringIO(accuracy_csv(metrics, tables, world))))
    said = {(r["about"], r["item"], r["quantity"]): (r["value"], r["unit"]) for r in rows}
    assert said == {
        ("survey", "", "ate_se3_rmse"): ("0.00676", "m"),
        ("survey", "", "ghosts"): ("", "%"),
        ("residuals of the positions, m", "", "east"): ("0.05", ""),
        ("sigma of the place in the world", "", "yaw_deg"): ("0.19", ""),
        ("residual of a frame, m", "7", "east"): ("0.01", ""),
        ("residual of a frame, m", "7", "north"): ("-0.02", ""),
        ("residual of a frame, m", "7", "up"): ("0.03", ""),
        ("control and check points", "A, 1", "role"): ("check", ""),
        ("control and check points", "A, 1", "dE m"): ("0.0123", ""),
        ("control and check points", "A, 1", "not used because"): ("", ""),
    }
    assert len(rows) == len(said)
