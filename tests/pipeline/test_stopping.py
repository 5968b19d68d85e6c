"""A run that is told to stop: one line, within seconds, no process left; and one that loses a process."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

import worlds

pytestmark = pytest.mark.slow
_PATIENCE_S = 240  # for a stage to begin
_STOP_S = 25  # on a busy machine; 6 s and what it takes to print a line are meant


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return worlds.write_survey(tmp_path_factory.mktemp("survey"), frames=4)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """One run folder for all: each test stops in a later stage."""
    return tmp_path_factory.mktemp("run") / "out"


def begun(survey: Path, out: Path, stage: str) -> subprocess.Popen[str]:
    """A run in a process group of its own, at the beginning of a stage."""
    given = ["--gnss", str(survey / "gnss.csv"), "--times", str(survey / "times.csv"), "--pool", "local:2", "--quiet"]
    command = [sys.executable, "-m", "tiegraph.cli.main", "run", str(survey / "images"), "-o", str(out), *given]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    receipt = out / "receipts" / f"{stage}.json"
    began = time.time_ns()  # an earlier run may have been stopped in the same stage
    wait_for(lambda: receipt.exists() and receipt.stat().st_mtime_ns > began, process)
    return process


def wait_for(condition: Callable[[], object], process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + _PATIENCE_S
    while not condition():
        assert process.poll() is None and time.monotonic() < end, "the run ended before, or nothing happens"
        time.sleep(0.005)


def helpers(process: subprocess.Popen[str], of_child: bool) -> list[psutil.Process]:
    """The workers, or the children of ``run_in_child``: these write into the log."""
    found = []
    for below in psutil.Process(process.pid).children(recursive=True):
        try:
            if "spawn_main" in " ".join(below.cmdline()):
                found += [below] if os.readlink(f"/proc/{below.pid}/fd/1").endswith("log.txt") == of_child else []
        except (OSError, psutil.Error):
            pass
    return found


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """(exit code, what it said) of a run that has been told to stop, none of whose processes is left."""
    try:
        _, said = process.communicate(timeout=_STOP_S)
    finally:
        process.kill()
    assert not in_group(process.pid), "processes are left"
    return process.returncode, said


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


STOPS = [
    ("scan", signal.SIGINT, True),
    ("masks", signal.SIGTERM, False),
    ("candidates", signal.SIGHUP, True),
    ("features", signal.SIGINT, False),
    ("match", signal.SIGINT, True),
    ("match", signal.SIGTERM, False),
    ("sparse", signal.SIGTERM, True),
    ("dense", signal.SIGINT, True),
]


@pytest.mark.parametrize("stage, number, group", STOPS)
def test_a_signal_stops_the_run_in_one_line(survey, out, stage, number, group):
    process = begun(survey, out, stage)
    if stage == "match":  # within the child
        wait_for(lambda: helpers(process, of_child=True), process)
    (os.killpg if group else os.kill)(process.pid, number)
    code, said = ended(process)
    assert code == 1
    assert said == "tiegraph: stopped; finished work is kept: run the same command again to go on\n"


def test_a_second_signal_ends_the_process_at_once(survey, out):
    process = begun(survey, out, "dense")
    for _ in range(2):
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(0.05)
    code, said = ended(process)
    assert code in (1, -signal.SIGINT) and "Traceback" not in said


LOSSES = [("candidates", False), ("match", True), ("sparse", True), ("dense", False)]


@pytest.mark.parametrize("stage, child", LOSSES)
def test_a_killed_process_ends_the_run_with_a_clear_line(survey, tmp_path_factory, stage, child):
    out = tmp_path_factory.getbasetemp() / "lost"
    process = begun(survey, out, stage)
    wait_for(lambda: helpers(process, child), process)
    helpers(process, child)[0].kill()
    code, said = ended(process)
    assert code == 1 and said.count("\n") == 1, said
    assert "ended from outside (signal SIGKILL)" in said and "finished work is kept" in said


def test_a_signal_within_an_exec_ends_the_process_with_its_exit_code(tmp_path):
    """Imports execute strings (dataclasses, namedtuples); CPython then ended the stopped run by SIGINT."""
    code = "import sys\nfrom tiegraph.cli.stopping import say_stopped\n"
    code += "try:\n    exec('raise KeyboardInterrupt')\nexcept KeyboardInterrupt:\n    say_stopped()\nsys.exit(1)\n"
    (tmp_path / "stopped.py").write_text(code)
    command = [sys.executable, "-m", "stopped"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("tiegraph: stopped;")) == (1, 1), done
