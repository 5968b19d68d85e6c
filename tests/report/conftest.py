"""Small pictures for the reports of tests, and a run with its page that several files look at."""

from pathlib import Path

import pytest
from fake_survey_run import make_run

from tiegraph.report import cloudview
from tiegraph.report.html import write_report
from tiegraph.report.settings import ReportSettings


@pytest.fixture(autouse=True, scope="session")
def small_views():
    """The static views are a quarter as wide."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cloudview, "VIEW_PX", 350)
        yield


@pytest.fixture(scope="session")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole run, that nobody changes."""
    return make_run(tmp_path_factory.mktemp("run") / "quay survey")


@pytest.fixture(scope="session")
def page(full: Path, small_views: None) -> str:
    """Its report."""
    return write_report(full, ReportSettings(viewer_points=2000)).read_text(encoding="utf-8")
