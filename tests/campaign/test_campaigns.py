"""The campaigns in short, with the seed of the day the code is at; the long form is `python tests/campaign/run.py`."""

from __future__ import annotations

from pathlib import Path

import pytest

import tiegraph
from campaign.process import Server
from campaign.run import Plan, campaign, failures, table
from campaign.world import NAMES, World

pytestmark = pytest.mark.slow
# A case costs what is left of the survey after its stage, so late ones: kills in `refine` and `dense` (in every stage:
# test_resume), a full disk in `dense`, a limit to files in `evaluate`; artefacts of every fourth stage; inputs in turn.
_LATE = tuple(NAMES.index(stage) for stage in ("refine", "dense"))
_SHORT = {"kills": _LATE, "disks": (8, 7), "artefacts": (0, 4, 8, 12, 16), "inputs": range(24)}
_SEED = 14


@pytest.mark.parametrize("name", _SHORT)
def test_nothing_is_lost(name: str, finished: World, server: Server) -> None:
    source = Path(tiegraph.__file__).parents[1]
    indices = list(_SHORT[name])
    results = campaign(name, Plan(_SEED, indices, finished.root, source, jobs=1, short=True), server=server)
    assert len(results) == len(indices)
    assert not failures(results), table(results)
