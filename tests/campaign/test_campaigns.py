"""The campaigns in short, with the seed of the day the code is at; the long form is `python tests/campaign/run.py`."""

from __future__ import annotations

from pathlib import Path

import pytest

import tiegraph
from campaign.run import Plan, campaign, failures, table

pytestmark = pytest.mark.slow
_SHORT = {"kills": 2, "disks": 2, "artefacts": 4, "inputs": 24}
_SEED = 14


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The survey and its clean runs."""
    return tmp_path_factory.mktemp("campaign")


@pytest.mark.parametrize("name", _SHORT)
def test_nothing_is_lost(name: str, work: Path) -> None:
    count = _SHORT[name]
    step = {"kills": 9, "artefacts": 4}.get(name, 1)  # stages in turn: spread over all of them
    indices = [k * step for k in range(count)]
    source = Path(tiegraph.__file__).parents[1]
    results = campaign(name, Plan(_SEED, indices, work, source, short=True))
    assert len(results) == count
    assert not failures(results), table(results)
