"""A run that is told to stop: one line, within seconds, no process left; and one that loses a process."""

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

import tiegraph
import worlds
from tiegraph.cli.main import main

_PATIENCE_S = 240  # for a stage to begin
_STOP_S = 25  # on a busy machine; 6 s and what it takes to print a line are meant


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    folder = tmp_path_factory.mktemp("survey")
    made = worlds.make_survey(folder / "images", frames=4)
    worlds.write_gnss(made, folder / "gnss.csv")
    worlds.write_times(made, folder / "times.csv")
    return folder


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
    wait_for(lambda: receipt.exists() and "began" in receipt.read_text(), process)
    return process


def wait_for(condition: Callable[[], object], process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + _PATIENCE_S
    while not condition():
        assert process.poll() is None and time.monotonic() < end, "the run ended before, or nothing happens"
        time.sleep(0.005)


def helpers(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Workers and children, oldest first."""
    below = psutil.Process(process.pid).children(recursive=True)
    return sorted((p for p in below if "spawn_main" in " ".join(p.cmdline())), key=lambda p: p.create_time())


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
    ("network", signal.SIGHUP, True),
    ("features", signal.SIGINT, False),
    ("match", signal.SIGINT, True),
    ("match", signal.SIGTERM, False),
    ("sparse", signal.SIGTERM, True),
    ("dense", signal.SIGINT, True),
]


@pytest.mark.slow
@pytest.mark.parametrize("stage, number, group", STOPS)
def test_a_signal_stops_the_run_in_one_line(survey, out, stage, number, group):
    process = begun(survey, out, stage)
    if stage == "match":  # within the child
        wait_for(lambda: len(helpers(process)) > 2 or "key" in receipt(out, stage), process)
    (os.killpg if group else os.kill)(process.pid, number)
    code, said = ended(process)
    assert code == 1
    assert said == "tiegraph: stopped; finished work is kept: run the same command again to go on\n"


@pytest.mark.slow
def test_a_second_signal_ends_the_process_at_once(survey, out):
    process = begun(survey, out, "dense")
    for _ in range(2):
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(0.05)
    code, said = ended(process)
    assert code in (1, -signal.SIGINT) and "Traceback" not in said


LOSSES = [("network", 0), ("match", -1), ("sparse", -1), ("dense", 0)]  # 0: a worker, -1: a child


@pytest.mark.slow
@pytest.mark.parametrize("stage, which", LOSSES)
def test_a_killed_process_ends_the_run_with_a_clear_line(survey, tmp_path_factory, stage, which):
    out = tmp_path_factory.getbasetemp() / "lost"
    process = begun(survey, out, stage)
    wait_for(lambda: len(helpers(process)) > (0 if which == 0 else 2), process)
    helpers(process)[which].kill()
    code, said = ended(process)
    assert code == 1 and said.count("\n") == 1, said
    assert "ended from outside (signal SIGKILL)" in said and "finished work is kept" in said


def receipt(out: Path, stage: str) -> dict:
    try:
        return json.loads((out / "receipts" / f"{stage}.json").read_text())
    except (OSError, ValueError):
        return {}


# ------------------------------------------------------------------------------- what is no file, and rings of links


@pytest.fixture
def images(survey: Path, tmp_path: Path) -> Path:
    """The survey's images by links of their own, so that a test may add to the folder."""
    folder = tmp_path / "images"
    for image in (survey / "images").rglob("*.jpg"):
        link = folder / image.relative_to(survey / "images")
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(image)
    return folder


def scanned(images: Path, out: Path, *more: str) -> int:
    return main(["run", str(images), "-o", str(out), "--pool", "serial", "--quiet", "--until", "scan", *more])


@pytest.mark.timeout(120)
def test_pipes_devices_and_rings_of_links_among_the_images_are_left_out_with_a_reason(images, tmp_path):
    os.mkfifo(images / "up/cam0/pipe.jpg")
    (images / "up/cam0/zero.jpg").symlink_to("/dev/zero")
    (images / "up/cam0/ring.jpg").symlink_to("ring.jpg")
    for name in ("a", "b"):
        (images / name).symlink_to(images, target_is_directory=True)
    (images / "up/again").symlink_to(images / "up/cam0", target_is_directory=True)
    (images / "above").symlink_to("/", target_is_directory=True)
    assert scanned(images, tmp_path / "out") == 0
    made = tiegraph.open(out=tmp_path / "out").receipt("scan")
    assert made["counts"]["images"] == 16
    reasons = dict(made["dropped"])
    assert "a named pipe, not a file" in reasons["up/cam0/pipe.jpg"]
    assert "a device, not a file" in reasons["up/cam0/zero.jpg"]
    assert "links" in reasons["up/cam0/ring.jpg"] and len(reasons) == 3
    passed = [note for note in made["notes"] if "passed over" in note]
    assert len(passed) == 4 and sum("above leads up to /" in note for note in passed) == 1


@pytest.mark.timeout(120)
@pytest.mark.parametrize("option", ["--gnss", "--times", "--rig", "--trajectory", "--gcp"])
def test_a_pipe_as_an_input_file_is_refused(images, tmp_path, option, capsys):
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    assert scanned(images, tmp_path / "out", option, str(pipe)) == 2
    said = capsys.readouterr().err
    assert str(pipe) in said and "a named pipe, not a file" in said


@pytest.mark.timeout(60)
@pytest.mark.parametrize("pool", ["local:100000", "local:0", "local:-1", "local:x", "serial:3", "local:9" + "9" * 5000])
def test_an_impossible_pool_is_refused_before_anything_starts(images, tmp_path, pool, capsys):
    assert main(["run", str(images), "-o", str(tmp_path / "out"), "--pool", pool]) == 2
    said = capsys.readouterr().err
    assert pool[:20] in said and ("cores" in said) == pool.startswith(("local:1", "local:9"))
    assert not (tmp_path / "out/receipts").exists()
