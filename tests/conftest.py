"""Shared fixtures. Data sets that the project does not own are found by TIEGRAPH_DATA, and their tests skip without."""

import os
from pathlib import Path

import pytest

import tiegraph  # noqa: F401  zlib before pycolmap


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The folder of the measuring data sets; skips where it is absent."""
    root = Path(os.environ.get("TIEGRAPH_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"data sets not there ({root}): set TIEGRAPH_DATA")
    return root


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests first: of several processes none is left alone with a long one at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session")
def canal() -> Path:
    """The example survey that ships with the project."""
    return Path(__file__).parents[1] / "examples" / "canal"
