"""Statements of one quantity held against each other."""

import numpy as np
import pytest

from tiegraph.scene.evidence import CHANCE, Statement, contradictions, table


def scale(source, value, sigma, used=False):
    return Statement("scale", source, value, sigma, "m", used)


def test_what_agrees_is_no_contradiction_but_for_chance():
    rng = np.random.default_rng(1)
    many = 20000
    drawn = 1 + rng.normal(size=(many, 2)) * (0.01, 0.02)
    called = sum(bool(contradictions([scale("rig", a, 0.01), scale("GNSS", b, 0.02)])) for a, b in drawn)
    assert 0.3 * CHANCE < called / many < 3 * CHANCE


@pytest.mark.parametrize("off, found", [(0.03, False), (0.115, True)])
def test_a_scale_that_is_off_is_named_with_its_sources_and_figures(off, found):
    said = contradictions([scale("rig as given", 1.0, 0.0016, True), scale("GNSS positions", 1 + off, 0.01)])
    assert bool(said) is found
    if found:
        assert said[0].sigmas == pytest.approx(off / np.hypot(0.0016, 0.01))
        assert (
            said[0]
            .text("the cameras fire apart")
            .startswith("scale: rig as given 1 +- 0.0016 m and GNSS positions 1.115")
        )
        assert said[0].text("the cameras fire apart").endswith("the cameras fire apart")


def test_nothing_is_made_of_other_quantities_the_same_source_or_no_sigma():
    rows = [scale("rig", 1, 0.01), scale("rig", 2, 0.01), scale("GNSS", 3, float("nan")), scale("EXIF", 3, 0)]
    rows.append(Statement("heading", "GNSS", 90, 0.01, "deg"))
    assert contradictions(rows) == []


def test_the_table_says_of_each_row_what_contradicts_it():
    made = table([scale("rig", 1, 0.01, True), scale("GNSS", 2, 0.01), scale("EXIF", 1.5, 9)])
    assert [row[-1] for row in made["rows"]] == ["contradicts GNSS", "contradicts rig", ""]
    assert [row[-2] for row in made["rows"]] == ["used", "", ""]
