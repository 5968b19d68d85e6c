"""Shared fixtures. Data sets that the project does not own are found by TIEGRAPH_DATA, and their tests skip without."""

from __future__ import annotations

import gc
import os
import re
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import tiegraph  # zlib before pycolmap
from tiegraph.child import cores

# Hundreds of processes import the same files: byte code is kept, also where the environment says otherwise.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# A shell's job in the background is started with Ctrl-C ignored, and its children would be: they are told to stop here.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

if TYPE_CHECKING:
    from campaign.process import Server
    from campaign.world import World


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The folder of the measuring data sets; skips where it is absent."""
    root = Path(os.environ.get("TIEGRAPH_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"data sets not there ({root}): set TIEGRAPH_DATA")
    return root


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """``-n auto``: one process more than there are cores, for slow tests wait for processes of their own."""
    return cores() + (config.getoption("markexpr") != "not slow")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What is loaded and collected stays to the end: garbage is not looked for meanwhile, and later not among it, which
    takes two of five seconds of every process."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A file that is marked slow as a whole is not even imported where nothing slow is to run."""
    if config.getoption("markexpr") != "not slow" or collection_path.suffix != ".py":
        return None
    return bool(re.search(r"^pytestmark = \[?\s*pytest\.mark\.slow", collection_path.read_text("utf-8"), re.M)) or None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The slower the tests of a file, the earlier: of several processes none is left alone with a long one at the
    end."""
    tests, slow = Counter(), Counter()
    for item in items:
        tests[item.path] += 1
        slow[item.path] += item.get_closest_marker("slow") is not None
    items.sort(key=lambda item: -slow[item.path] / tests[item.path])


@pytest.fixture(scope="session")
def server() -> Iterator[Server]:
    """Runs command lines as children of a process that has imported everything once (campaign/README.md)."""
    from campaign.process import Server

    made = Server(Path(tiegraph.__file__).parents[1])
    yield made
    made.close()


@pytest.fixture(scope="session")
def finished(server: Server, tmp_path_factory: pytest.TempPathFactory) -> World:
    """The smallest survey that goes through all stages, and its run folder as it is after each of them: made once for
    all processes of the suite. Tests work in copies (``World.after``)."""
    import fcntl

    from campaign.world import make

    base = tmp_path_factory.getbasetemp()
    root = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "finished"
    with open(root.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return make(root, server)


@pytest.fixture
def children_are_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Children of match, sparse and georef are calls (``here``)."""
    import here

    here.patch(monkeypatch)


@pytest.fixture(scope="session")
def canal() -> Path:
    """The example survey that ships with the project."""
    return Path(__file__).parents[1] / "examples" / "canal"
