"""The campaigns in short, with the seed of the day the code is at; the long form is `python tests/campaign/run.py`."""

from __future__ import annotations

from pathlib import Path

import pytest

import tiegraph
from campaign.process import Server
from campaign.run import Plan, campaign, failures, table
from campaign.world import NAMES, World

pytestmark = pytest.mark.slow
# A case costs what is left of the survey after its stage, so late ones: a kill in `products` (test_resume has all
# stages), a full disk in `dense`, a limit to files in `evaluate`; artefacts of three stages; one input of each kind.
_KINDS = (*range(10), 11, 12, 21)
_SHORT = {"kills": (NAMES.index("products"),), "disks": (8, 7), "artefacts": (4, 12, 16), "inputs": _KINDS}
_SEED = 14


@pytest.mark.parametrize("name", _SHORT)
def test_nothing_is_lost(name: str, finished: World, server: Server) -> None:
    source = Path(tiegraph.__file__).parents[1]
    indices = list(_SHORT[name])
    results = campaign(name, Plan(_SEED, indices, finished.root, source, jobs=1, short=True), server=server)
    assert len(results) == len(indices)
    assert not failures(results), table(results)
