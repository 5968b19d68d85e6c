"""The notebooks of the documentation, one after another in one folder and without Jupyter."""

import json
import runpy
from pathlib import Path
from typing import Any

import pytest

import tiegraph

pytestmark = pytest.mark.slow

DOCS = Path(__file__).parents[1] / "docs"


def kinds(notebook: dict[str, Any]) -> list[list[list[str]]]:
    """What each cell gave: text, pictures, tables."""
    cells = [cell.get("outputs", []) for cell in notebook["cells"]]
    return [[sorted(output.get("data", {"text": ""})) for output in outputs] for outputs in cells]


def text(notebook: dict[str, Any]) -> str:
    """All that was printed."""
    return "".join("".join(o.get("text", ())) for cell in notebook["cells"] for o in cell.get("outputs", ()))


@pytest.fixture
def small_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Depth maps of a third of the side that the notebooks ask for, and a coarser cloud."""
    whole = tiegraph.open
    coarse = {"dense": {"max_image_size": 160, "partners": 3}, "cloud": {"voxel_size": 0.2}}

    def opened(*given: Any, settings: dict | None = None, **more: Any) -> Any:
        return whole(*given, settings=settings and settings | coarse, **more)

    monkeypatch.setattr(tiegraph, "open", opened)


@pytest.mark.usefixtures("children_are_functions", "small_maps")
def test_the_notebooks_run_and_give_what_they_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runner = runpy.run_path(str(DOCS / "notebooks.py"))
    monkeypatch.chdir(tmp_path)
    printed = ""
    for path in runner["notebooks"]():
        written = json.loads(path.read_text("utf-8"))
        before = kinds(written)
        runner["execute"](written)
        assert kinds(written) == before, f"{path.name}: python docs/notebooks.py FOLDER writes it anew"
        printed += text(written)
    assert "10 of 10 images have a pose" in printed and "in one piece: True" in printed
