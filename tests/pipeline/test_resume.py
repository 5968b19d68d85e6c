"""Runs that are killed, told to stop or lose a process go on, and end with the same bytes whatever the pool."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

import dask_world
import tiegraph
from artefacts import artefacts
from campaign.compare import differences
from campaign.process import Running
from campaign.world import NAMES, PATIENCE_S
from tiegraph.pipeline import STAGES

pytestmark = pytest.mark.slow
_PATIENCE_S = 400


def kill_in(stage, running: Running, out: Path) -> None:
    """Kill a run as soon as the stage has begun (and, if it has items, finished one)."""
    receipt = out / "receipts" / f"{stage.name}.json"
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        assert not running.poll(), f"the run ended before it could be killed in {stage.name}: {running.log.read_text()}"
        if receipt.exists() and "began" in receipt.read_text():
            break
        time.sleep(0.005)
    while stage.item == "image" and time.monotonic() < end and not files(out, stage.makes[-1]):
        time.sleep(0.005)
        if running.poll() or "key" in json.loads(receipt.read_text()):
            break
    os.kill(running.pid, signal.SIGKILL)
    ended = running.wait(_PATIENCE_S)
    assert ended.signal == signal.SIGKILL, f"{stage.name}: {ended}"
    assert not ended.left, f"orphans keep working after a kill in {stage.name}: {ended.left}"


def finished_at(out: Path, stage: str) -> str | None:
    return tiegraph.open(out=out).receipt(stage).get("finished")


def files(out: Path, artefact: str) -> dict[str, int]:
    """Finished files of an artefact folder and when they were written."""
    names = [p.relative_to(out) for p in (out / artefact).rglob("*")]
    shown = [n for n in names if not any(part.startswith(".") for part in n.parts) and (out / n).is_file()]
    return {n.as_posix(): (out / n).stat().st_mtime_ns for n in shown}


def test_killed_in_every_stage(finished, server, tmp_path):
    """Each run finishes the stage that the one before was killed in, and is killed in the next."""
    broken = tmp_path / "broken"
    done: dict[str, str] = {}
    before: dict[str, int] = {}
    for k, stage in enumerate(STAGES):
        # Workers are there to be orphans where a stage has items, or to make the tiles of the stage before; their start
        # costs as much as the rest of the run.
        pool = "local:2" if stage.item == "image" or STAGES[k - 1].item == "tile" else "serial"
        kill_in(stage, server.start(finished.command(broken, "--pool", pool), tmp_path / "said"), broken)
        if k:
            last = STAGES[k - 1]
            assert before.items() <= files(broken, last.makes[-1]).items(), f"{last.name} made finished items again"
        done |= {s.name: at for s in STAGES[:k] if s.name not in done and (at := finished_at(broken, s.name))}
        assert list(done) == [s.name for s in STAGES[:k]]
        # ``features`` and ``match`` share a database, which changes.
        before = files(broken, stage.makes[-1]) if stage.item == "image" and stage.name != "features" else {}
    ended = server.run(finished.command(broken, "--pool", "serial"), tmp_path / "said", _PATIENCE_S)
    assert ended.good, ended
    assert {name: finished_at(broken, name) for name in done} == done, "what was finished ran again"
    a, b = artefacts(finished.clean[STAGES[-1].name]), artefacts(broken)
    assert sorted(a) == sorted(b) and {"cloud.laz", "world.json", "database.db", "sparse/0/images.bin"} <= set(a)
    assert [name for name in a if a[name] != b[name]] == []


def test_second_run_does_nothing(finished, server, tmp_path):
    out = finished.after(STAGES[-1].name, tmp_path / "out")
    stamps = {p: p.stat().st_mtime_ns for p in out.rglob("*") if p.is_file() and p.name not in ("log.txt", ".lock")}
    again = server.run(finished.command(out, "--pool", "serial"), tmp_path / "said", _PATIENCE_S)
    assert again.good and again.text.count("up to date") == len(STAGES), again
    assert stamps == {p: p.stat().st_mtime_ns for p in stamps}


def test_serial_and_processes_make_the_same_bytes(finished, server, tmp_path):
    """With a rig that is not known, to the world; ``test_killed_in_every_stage`` says so of a calibrated rig, of masks
    and of all stages."""
    survey = finished.inputs

    def command(pool: str) -> list[str]:
        asked = ["run", survey / "images", "-o", tmp_path / pool, "--pool", pool, "--until", "georef", "--quiet"]
        asked += ["--masks.source", "none"]
        given = [word for name in ("gnss", "times") for word in (f"--{name}", survey / f"{name}.csv")]
        return [str(word) for word in (*asked, *given)]

    # The server's order of hashes is drawn.
    serial = server.run(command("serial"), tmp_path / "said", _PATIENCE_S)
    assert serial.good, serial
    subprocess.run(
        [sys.executable, "-m", "tiegraph", *command("local:2")],
        env={**os.environ, "PYTHONHASHSEED": "2"}, timeout=_PATIENCE_S, check=True,
    )  # fmt: skip
    a, b = artefacts(tmp_path / "serial"), artefacts(tmp_path / "local:2")
    assert sorted(a) == sorted(b) and {"world.json", "database.db", "sparse/0/images.bin"} <= set(a)
    assert [name for name in a if a[name] != b[name]] == []


_PATIENCE_S_STOPPING = 240  # for a stage to begin
_STOP_S = 25  # on a busy machine; 6 s and what it takes to print a line are meant


@pytest.fixture
def run(finished, server, tmp_path):
    """Starts the survey where the clean run was before a stage, and waits for the stage to begin."""

    def start(stage: str, *more: str) -> Running:
        out = finished.after(before(stage), tmp_path / "out")
        command = finished.command(out, "--pool", "local:2", "--quiet", *more)
        running = server.start(command, tmp_path / "said")
        wait_for((out / "receipts" / f"{stage}.json").exists, running)
        return running

    return start


def before(stage: str) -> str:
    return NAMES[NAMES.index(stage) - 1] if stage != NAMES[0] else ""


def wait_for(condition: Callable[[], object], running: Running) -> None:
    end = time.monotonic() + _PATIENCE_S_STOPPING
    while not condition():
        assert not running.poll() and time.monotonic() < end, "the run ended before, or nothing happens"
        time.sleep(0.005)


def helpers(running: Running, of_child: bool) -> list[psutil.Process]:
    """The workers, or the children of ``run_in_child``: these write into the log."""
    found = []
    for below in running.children():
        try:
            found += [below] if os.readlink(f"/proc/{below.pid}/fd/1").endswith("log.txt") == of_child else []
        except (OSError, psutil.Error):
            pass
    return found


def ended(running: Running, within_s: float = _STOP_S) -> tuple[int | None, str]:
    """(exit code, what it said) of a run that has been told to stop, none of whose processes is left."""
    end = running.wait(within_s)
    assert not end.hung and not end.left, f"processes are left: {end}"
    return end.code, end.text


STOPS = [  # in the process itself, in workers and in a child of a stage; with the whole group, and the process alone
    ("masks", signal.SIGTERM, False),
    ("candidates", signal.SIGHUP, True),
    ("match", signal.SIGINT, True),
    ("match", signal.SIGTERM, False),
    ("dense", signal.SIGINT, True),
]


@pytest.mark.parametrize("stage, number, group", STOPS)
def test_a_signal_stops_the_run_in_one_line(run, stage, number, group):
    running = run(stage)
    if stage == "match":  # within the child
        wait_for(lambda: helpers(running, of_child=True), running)
    (os.killpg if group else os.kill)(running.pid, number)
    code, said = ended(running)
    assert code == 1
    assert said == "tiegraph: stopped; finished work is kept: run the same command again to go on\n"


def test_a_second_signal_ends_the_process_at_once(finished, tmp_path):
    """Of a process that nobody forked."""
    out = finished.after(before("dense"), tmp_path / "out")
    asked = finished.command(out, "--pool", "local:2", "--quiet")
    command = [sys.executable, "-m", "tiegraph.cli.main", *asked]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        while not (out / "receipts" / "dense.json").exists():
            assert process.poll() is None
            time.sleep(0.005)
        for _ in range(2):
            os.killpg(process.pid, signal.SIGINT)
            time.sleep(0.05)
        _, said = process.communicate(timeout=_STOP_S)
    finally:
        process.kill()
    assert not in_group(process.pid), "processes are left"
    assert process.returncode in (1, -signal.SIGINT) and "Traceback" not in said


def in_group(group: int) -> list[psutil.Process]:
    """Processes of a group that do not end within a few seconds."""
    there = []
    for process in psutil.process_iter():
        try:
            if os.getpgid(process.pid) == group and process.status() != psutil.STATUS_ZOMBIE:
                there.append(process)
        except (OSError, psutil.Error):
            pass
    return psutil.wait_procs(there, timeout=10)[1]


LOSSES = [("match", True), ("dense", False)]


@pytest.mark.parametrize("stage, child", LOSSES)
def test_a_killed_process_costs_a_second_try(run, stage, child):
    running = run(stage, "--until", stage)
    wait_for(lambda: helpers(running, child), running)
    helpers(running, child)[0].kill()
    code, said = ended(running, _PATIENCE_S_STOPPING)
    assert code == 0 and "Traceback" not in said, said


def test_a_signal_within_an_exec_ends_the_process_with_its_exit_code(tmp_path):
    """Imports execute strings (dataclasses, namedtuples); CPython then ended the stopped run by SIGINT."""
    code = "import sys\nfrom tiegraph.cli.main import say_stopped\n"
    code += "try:\n    exec('raise KeyboardInterrupt')\nexcept KeyboardInterrupt:\n    say_stopped()\nsys.exit(1)\n"
    (tmp_path / "stopped.py").write_text(code)
    command = [sys.executable, "-m", "stopped"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("tiegraph: stopped;")) == (1, 1), done


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="without Dask")
def test_a_survey_over_two_workers_is_stopped_by_ctrl_c_and_goes_on(finished, server, tmp_path):
    """In the midst of its depth maps, with one line; the next run does the rest, to the bytes of a run without Dask
    (matches of a cluster: test_features_match)."""
    out, clean = finished.after(before("dense"), tmp_path / "out"), finished.clean[NAMES[-1]]
    with dask_world.Commands(server, tmp_path / "dask").cluster(2) as (address, _):
        command = finished.command("out", "--pool", f"dask:{address}")  # relative: the workers' own folder is another
        running = server.start(command, tmp_path)
        end = time.monotonic() + PATIENCE_S
        while not list((out / "depth").rglob("*.npz")) and time.monotonic() < end:
            assert not running.poll()
            time.sleep(0.01)
        os.kill(running.pid, signal.SIGINT)
        stopped = running.wait(120)
        last = stopped.text.strip().splitlines()[-1]
        assert stopped.code == 1 and not stopped.left and last.startswith("tiegraph: stopped"), stopped
        assert "Traceback" not in stopped.text and "distributed" not in stopped.text, stopped
        assert not (out / "receipts" / "cloud.json").exists()
        again = server.run(command, tmp_path, PATIENCE_S)
    assert again.good, again
    assert "distributed" not in again.text and "Warning" not in again.text
    assert not list(out.glob(".dask-*"))
    assert (out / "report.html").exists() and differences(clean, out) == []
    here, there = (tiegraph.open(out=folder).receipt("dense") for folder in (out, clean))
    assert here["cpu_s"] > 0.5 * there["cpu_s"], "the workers' CPU seconds count"
    assert here["peak_mib"] > 0.5 * there["peak_mib"], "the workers' memory counts"
