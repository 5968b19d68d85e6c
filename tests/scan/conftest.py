"""Surveys of small images that no test changes, opened once for all of them."""

from __future__ import annotations

import pytest
from scan_worlds import Survey, papers_rig


@pytest.fixture(scope="session")
def one_pass(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    """Two cameras, eight frames."""
    return Survey(papers_rig(tmp_path_factory.mktemp("one") / "in", ("up",), 2, 8))


@pytest.fixture(scope="session")
def two_passes(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    """Two cameras, three frames a pass."""
    return Survey(papers_rig(tmp_path_factory.mktemp("two") / "in", ("up", "down"), 2, 3))


@pytest.fixture(scope="session")
def three_cameras(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    """Two passes of three frames."""
    return Survey(papers_rig(tmp_path_factory.mktemp("three") / "in"))
