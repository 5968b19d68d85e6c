"""The georeference in words."""

from __future__ import annotations

from tiegraph.report.georeference import sentences


def test_control_and_check_points_are_told_apart() -> None:
    values = {"points": 4.0, "rmse_plan_m": 0.02, "rmse_up_m": 0.03, "ce90_m": 0.03, "le90_m": 0.05}
    world = {
        "placed": True, "vertical": "heights are above the ellipsoid", "adjusted": True, "antenna_m": [0.1, 0.2, 0.3],
        "accuracy": {"gcp": values, "check": {**values, "points": 1.0}},
    }  # fmt: skip
    text = sentences(world)
    assert text[0] == "Heights are above the ellipsoid."
    assert any("0.10, 0.20, 0.30 m" in t for t in text) and any("adjusted together" in t for t in text)
    assert sum("independent check" in t for t in text) == 1
    assert any(t.startswith("4 control points are met") for t in text)
    assert any(t.startswith("1 check point is met") for t in text)
    assert sentences({}) == []
