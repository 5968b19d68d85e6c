"""Planned against reached compares like with like."""

from tiegraph.plan.tables import comparison

PLAN = {"stations": [{}], "path": {"position_shape_sigma_median_m": 0.002, "place_world_sigma_median_m": 0.03}}


def test_it_is_said_in_a_sentence():
    run = {"position_shape_sigma_median_m": 0.003, "place_world_sigma_median_m": 0.04, "ate_m": 0.01}
    table = comparison(PLAN, run)
    assert "known to 3 mm where 2 mm were planned" in table.sentence
    assert any("ATE" in row[0] for row in table.rows)
