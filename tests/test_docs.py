"""The documents say what the code says."""

import re
import runpy
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tiegraph.pipeline import STAGES

ROOT = Path(__file__).parents[1]
MAX_DESIGN_WORDS = 1800
MAX_README_LINES = 90
MAX_PICTURE_BYTES = 250_000


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


def test_the_design_is_short_and_names_every_stage_and_package():
    text = (ROOT / "DESIGN.md").read_text()
    assert len(text.split()) <= MAX_DESIGN_WORDS
    for stage in STAGES:
        assert f"**{stage.name}**" in text
    package = ROOT / "src" / "tiegraph"
    for path in package.iterdir():
        if (path / "__init__.py").exists():
            assert f"{path.name}/" in text
        elif path.suffix == ".py" and not path.name.startswith("__"):
            assert path.name in text


def test_every_stage_has_its_files_described():
    rows = [line for line in (ROOT / "docs" / "artefacts.md").read_text().splitlines() if line.startswith("| `")]
    assert [row.split("`")[1] for row in rows] == [stage.name for stage in STAGES]
    for row, stage in zip(rows, STAGES):
        for name in (*stage.makes, *stage.changes):
            assert f"`{name}" in row, f"{stage.name}: {name}"
        assert row.rstrip(" |").endswith(stage.item or "-")


def test_the_readme_is_short_and_shows_two_small_pictures():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= MAX_README_LINES
    shown = re.findall(r"!\[[^]]+\]\(([^)]+)\)", text)
    assert len(shown) == 2
    for name in shown:
        assert (ROOT / name).stat().st_size <= MAX_PICTURE_BYTES


def test_the_readme_installs_and_runs_the_demo_in_one_line():
    blocks = re.findall(r"```\n(.*?)\n```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert blocks[0] == "sh setup.sh && .venv/bin/tiegraph demo"
    assert blocks[1].startswith("sh setup.sh dev && .venv/bin/python -m pytest")
