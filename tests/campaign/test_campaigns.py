"""The campaigns in short, with the seed of the day the code is at; the long form is `python tests/campaign/run.py`."""

from __future__ import annotations

from pathlib import Path

import pytest

import tiegraph
from campaign.process import Server
from campaign.run import Plan, campaign, failures, table
from campaign.world import World

pytestmark = pytest.mark.slow
# What a case costs goes by its stage: kills of `match` and `dense` (of every stage: test_resume), of every kind of
# input one, ...
_SHORT = {"kills": (6, 11), "disks": (0, 1), "artefacts": (0, 4, 8, 12), "inputs": range(24)}
_SEED = 14


@pytest.mark.parametrize("name", _SHORT)
def test_nothing_is_lost(name: str, finished: World, server: Server) -> None:
    source = Path(tiegraph.__file__).parents[1]
    indices = list(_SHORT[name])
    results = campaign(name, Plan(_SEED, indices, finished.root, source, jobs=1, short=True), server=server)
    assert len(results) == len(indices)
    assert not failures(results), table(results)
