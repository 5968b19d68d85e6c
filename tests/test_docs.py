"""The documents say what the code says."""

import runpy
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tiegraph.pipeline import STAGES

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def diagram() -> dict:
    """The script that draws the table of stages."""
    return runpy.run_path(str(ROOT / "docs" / "stages.py"))


def test_the_diagram_of_the_stages_is_the_table(diagram):
    made = diagram["drawing"]()
    assert (ROOT / "docs" / "stages.svg").read_text() == made, "python docs/stages.py draws it anew"
    texts = [t.text for t in ElementTree.fromstring(made).iter("{http://www.w3.org/2000/svg}text")]
    for stage in STAGES:
        assert stage.name in texts
        assert not stage.needs or ", ".join(stage.needs) in texts


def test_lanes_of_the_diagram_do_not_run_into_each_other(diagram):
    needed = diagram["consumers"](STAGES)
    lane_of = diagram["lanes"](needed)
    assert set(lane_of) == {row for row, to in needed.items() if any(k > row + 1 for k in to)}
    for row, lane in lane_of.items():
        for other, same in lane_of.items():
            if row < other and lane == same:
                assert max(needed[row]) <= other
