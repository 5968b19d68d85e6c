"""The documents say what the code says."""

import ast
import re
import runpy
from pathlib import Path
from xml.etree import ElementTree

import pytest

import tiegraph
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


DOCUMENTS = ("README.md", "DESIGN.md", "CONTRIBUTING.md", "benchmarks/README.md", "docs/index.md", "docs/artefacts.md")


@pytest.mark.parametrize("name", DOCUMENTS)
def test_links_lead_to_files(name):
    path = ROOT / name
    for link in re.findall(r"\]\(([^)#]+)\)", path.read_text()):
        assert link.startswith("https://") or (path.parent / link).exists(), f"{name}: {link}"


def test_the_version_to_cite_is_the_version():
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited is not None
    assert cited[1] == tiegraph.__version__


def test_types_are_there_for_who_imports_the_package():
    assert (Path(tiegraph.__file__).parent / "py.typed").exists()


def test_examples_say_how_they_are_called():
    examples = sorted((ROOT / "examples").glob("*.py"))
    assert len(examples) == 3
    for path in examples:
        assert f"python examples/{path.name}" in path.read_text()


@pytest.mark.slow
def test_the_quick_example_runs(tmp_path, capsys):
    """In this process: what it prints is what a reader sees."""
    runpy.run_path(str(ROOT / "examples" / "read_survey.py"))["main"](str(tmp_path / "out"))
    printed = capsys.readouterr().out
    assert "120 images in 20 frames" in printed
    assert "10 frames have a position" in printed


def test_every_package_is_a_chapter_of_the_documentation():
    tree = ast.parse((ROOT / "docs" / "hooks.py").read_text())
    named = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    packages = {path.parent.name for path in (ROOT / "src" / "tiegraph").glob("*/__init__.py")}
    assert packages <= named


def test_the_tests_of_every_situation_are_there():
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", (ROOT / "docs" / "situations.md").read_text())
    assert len(named) > 50 and [f"{p}::{n}" for p, n in named if f"def {n}(" not in (ROOT / p).read_text()] == []


def test_messages_of_the_troubleshooting_page_are_those_of_the_program():
    quoted = re.findall(r'^\| "([^"]+)"', (ROOT / "docs" / "troubleshooting.md").read_text(), re.M)
    source = "\n".join(p.read_text() for p in (ROOT / "src" / "tiegraph").rglob("*.py")).lower()
    assert len(quoted) > 5 and [q for q in quoted if q.lower() not in source] == []
