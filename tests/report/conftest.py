"""Small pictures for the reports of tests."""

import pytest

from tiegraph.report import spatial


@pytest.fixture(autouse=True, scope="session")
def small_views():
    """The static views are a quarter as wide."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spatial, "VIEW_PX", 350)
        yield
