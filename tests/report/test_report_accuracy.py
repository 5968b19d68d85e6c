"""Every accuracy on the page is marked with its key and is the one of the source; none stands there without."""

from __future__ import annotations

from pathlib import Path

import pytest
from fake_survey_run import make_accuracy
from markupsafe import escape

from accuracy_marks import check, unmarked
from said import says
from tiegraph.report import accuracy
from tiegraph.scene.accuracy import Accuracy, Figure


def test_every_accuracy_on_the_page_is_the_one_of_the_source(full: Path, page: str) -> None:
    keys = check(full, page)
    layers = set(make_accuracy().values())
    assert layers <= keys, "each figure of the source stands on the page"
    assert {"metrics.ate_se3_rmse", "tables.cloud against reference.0.1"} <= keys
    assert unmarked(page) == []
    top = page[page.index('<div class="verdict') : page.index('<div class="tiles">')]
    order = [top.index(text) for text in ("Tolerance of", "In the world:", "In shape", "Of a point")]
    assert order == sorted(order) and order[0] < top.index("are registered")


def test_the_check_finds_what_it_is_for(full: Path, page: str) -> None:
    with pytest.raises(AssertionError):
        check(full, page.replace(">2.58 m<", ">2.50 m<"))
    assert unmarked(page.replace("</h1>", "</h1><p>A point has a standard deviation of 3.6 cm.</p>"))
    assert unmarked(page.replace("</main>", "<table><tr><th>rmse m</th></tr><tr><td>0.02</td></tr></table></main>"))


def test_the_terminal_says_what_the_page_says(full: Path) -> None:
    lines = accuracy.terminal_lines(full / "metrics.json")
    assert [line.split()[0] for line in lines] == ["Tolerance", "In", "In", "Of"]
    assert lines[0].startswith("Tolerance of 5.0 cm in the world: no. Reason: 3 check points measured more. What would")
    assert (
        "predicted 2.58 m for a point of the cloud" in lines[1]
        and "Measured 6.2 cm (a check point) by 3 check points" in lines[1]
    )
    assert "10.0 cm for a camera, over the whole; 4.0 mm for what lies between two cameras 10 m apart" in lines[2]
    assert "Measured 12.1 cm (a camera, over the whole) by 54 reference poses" in lines[2]
    assert "predicted 3.6 cm" in lines[3] and "Nothing independent measured it" in lines[3]
    assert not says(lines, "<")
    assert accuracy.terminal_lines(full / "none.json") == []


def test_what_is_not_known_is_said_to_be_so() -> None:
    said = Accuracy("units", "nothing", (Figure("shape.whole", "a camera", 0.3), Figure("point", "a point")))
    world, shape, point = (str(escape(s).striptags()) for s in accuracy.sentences(said))
    assert "not known" in world and "0.300 units" in shape and "Nothing independent" in shape and "\u2013" in point
    assert accuracy.placement(said) == ""
    held = Accuracy(
        "m", "positions", (Figure("world", "a", 0.1), Figure("world.held_out", "a", measured=0.2, by="4 b"))
    )
    assert "4 b are met within 20.0 cm" in escape(accuracy.sentences(held)[0]).striptags()
