"""The pages of the papers name functions that exist."""

import re
from importlib import import_module
from pathlib import Path

import pytest

PAGES = Path(__file__).parents[2] / "docs" / "papers"


@pytest.mark.parametrize("paper", ["000", "001", "002", "003", "004"])
def test_what_a_page_names_exists(paper: str) -> None:
    names = re.findall(r"`([a-z_0-9.]+):([A-Za-z_0-9]+)`", (PAGES / f"{paper}.md").read_text())
    assert len(names) >= 10
    lost = [f"{module}:{name}" for module, name in names if not hasattr(import_module(f"tiegraph.{module}"), name)]
    assert not lost
