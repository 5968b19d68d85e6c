"""A whole survey over the workers of Dask: the same bytes as without, and a clean end."""

import importlib.util
import signal
import subprocess
import sys
import time

import pytest

import dask_world
import tiegraph
from campaign.compare import differences
from campaign.world import NAMES

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="without Dask"),
]
_PATIENCE_S = 600


@pytest.fixture(scope="module")
def address():
    """Of two workers that were started by Dask's commands."""
    with dask_world.commands(2) as (made, _):
        yield made


def command(finished, address: str) -> list[str]:
    """A relative folder: the workers' own working folder is another one."""
    return [sys.executable, "-m", "tiegraph.cli.main", *finished.command("out", "--pool", f"dask:{address}")]


def test_a_survey_over_two_workers_is_stopped_by_ctrl_c_and_goes_on(finished, address, tmp_path):
    """In the midst of its masks, with one line; the next run does the rest, to the bytes of a run without Dask."""
    out, clean = finished.after("scan", tmp_path / "out"), finished.clean[NAMES[-1]]
    process = subprocess.Popen(command(finished, address), cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + _PATIENCE_S
    while not list((out / "masks").rglob("*.png")) and time.monotonic() < end:
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    last = said.strip().splitlines()[-1]
    assert process.returncode == 1 and last.startswith("tiegraph: stopped"), said
    assert "Traceback" not in said and "distributed" not in said, said
    assert not (out / "receipts" / "preview.json").exists()
    again = subprocess.run(
        command(finished, address), cwd=tmp_path, capture_output=True, text=True, timeout=_PATIENCE_S
    )
    assert again.returncode == 0, again.stderr
    assert "distributed" not in again.stderr and "Warning" not in again.stderr
    assert not list(out.glob(".dask-*"))
    assert (out / "report.html").exists() and differences(clean, out) == []
    here, there = (tiegraph.open(out=folder).receipt("dense") for folder in (out, clean))
    assert here["cpu_s"] > 0.5 * there["cpu_s"], "the workers' CPU seconds count"
    assert here["peak_mib"] > 0.5 * there["peak_mib"], "the workers' memory counts"
