"""A whole survey over the workers of Dask: the same bytes as without, and a clean end."""

import importlib.util
import os
import signal
import time

import pytest

import dask_world
import tiegraph
from campaign.compare import differences
from campaign.world import NAMES, PATIENCE_S

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="without Dask"),
]


def test_a_survey_over_two_workers_is_stopped_by_ctrl_c_and_goes_on(finished, server, tmp_path):
    """In the midst of its masks, with one line; the next run does the rest, to the bytes of a run without Dask."""
    out, clean = finished.after("scan", tmp_path / "out"), finished.clean[NAMES[-1]]
    with dask_world.Commands(server, tmp_path / "dask").cluster(2) as (address, _):
        command = finished.command("out", "--pool", f"dask:{address}")  # relative: the workers' own folder is another
        running = server.start(command, tmp_path)
        end = time.monotonic() + PATIENCE_S
        while not list((out / "masks").rglob("*.png")) and time.monotonic() < end:
            assert not running.poll()
            time.sleep(0.01)
        os.kill(running.pid, signal.SIGINT)
        stopped = running.wait(120)
        last = stopped.text.strip().splitlines()[-1]
        assert stopped.code == 1 and not stopped.left and last.startswith("tiegraph: stopped"), stopped
        assert "Traceback" not in stopped.text and "distributed" not in stopped.text, stopped
        assert not (out / "receipts" / "preview.json").exists()
        again = server.run(command, tmp_path, PATIENCE_S)
    assert again.good, again
    assert "distributed" not in again.text and "Warning" not in again.text
    assert not list(out.glob(".dask-*"))
    assert (out / "report.html").exists() and differences(clean, out) == []
    here, there = (tiegraph.open(out=folder).receipt("dense") for folder in (out, clean))
    assert here["cpu_s"] > 0.5 * there["cpu_s"], "the workers' CPU seconds count"
    assert here["peak_mib"] > 0.5 * there["peak_mib"], "the workers' memory counts"
