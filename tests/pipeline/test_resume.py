"""A run that is killed (SIGKILL) in every stage goes on where it stopped and ends with the bytes of an unbroken one."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

import tiegraph
import worlds
from artefacts import artefacts
from tiegraph.pipeline import STAGES

pytestmark = pytest.mark.slow
_PATIENCE_S = 240


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return worlds.write_survey(tmp_path_factory.mktemp("survey"), frames=5)


def command(survey: Path, out: Path, pool: str = "local:2") -> list[str]:
    given = ["--gnss", str(survey / "gnss.csv"), "--times", str(survey / "times.csv"), "--pool", pool]
    return [sys.executable, "-m", "tiegraph.cli.main", "run", str(survey / "images"), "-o", str(out), *given]


def run(asked: list[str], seed: str) -> None:
    subprocess.run(asked, check=True, capture_output=True, env={**os.environ, "PYTHONHASHSEED": seed})


def kill_in(stage, survey: Path, out: Path) -> None:
    """Start the run and kill it as soon as the stage has begun (and, if it has items, finished one)."""
    process = subprocess.Popen(command(survey, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    receipt = out / "receipts" / f"{stage.name}.json"
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        assert process.poll() is None, f"the run ended before it could be killed in {stage.name}"
        if receipt.exists() and "began" in receipt.read_text():
            break
        time.sleep(0.005)
    while stage.item == "image" and time.monotonic() < end and not files(out, stage.makes[-1]):
        time.sleep(0.005)
        if process.poll() is not None or "key" in json.loads(receipt.read_text()):
            break
    below = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
    process.send_signal(signal.SIGKILL)
    process.wait()
    _, alive = psutil.wait_procs(below, timeout=20)
    assert not alive, f"orphans keep working after a kill in {stage.name}: {alive}"


def finished(out: Path, stage: str) -> str | None:
    return tiegraph.open(out=out).receipt(stage).get("finished")


def files(out: Path, artefact: str) -> dict[str, int]:
    """Finished files of an artefact folder and when they were written."""
    names = [p.relative_to(out) for p in (out / artefact).rglob("*")]
    shown = [n for n in names if not any(part.startswith(".") for part in n.parts) and (out / n).is_file()]
    return {n.as_posix(): (out / n).stat().st_mtime_ns for n in shown}


def test_killed_in_every_stage(survey, tmp_path):
    """Each run finishes the stage that the one before was killed in, and is killed in the next."""
    clean, broken = tmp_path / "clean", tmp_path / "broken"
    run(command(survey, clean, "serial"), seed="1")
    done: dict[str, str] = {}
    before: dict[str, int] = {}
    for k, stage in enumerate(STAGES):
        kill_in(stage, survey, broken)
        if k:
            last = STAGES[k - 1]
            assert before.items() <= files(broken, last.makes[-1]).items(), f"{last.name} made finished items again"
        done |= {s.name: at for s in STAGES[:k] if s.name not in done and (at := finished(broken, s.name))}
        assert list(done) == [s.name for s in STAGES[:k]]
        # ``features`` and ``match`` share a database, which changes.
        before = files(broken, stage.makes[-1]) if stage.item == "image" and stage.name != "features" else {}
    run(command(survey, broken), seed="2")
    assert {name: finished(broken, name) for name in done} == done, "what was finished ran again"
    a, b = artefacts(clean), artefacts(broken)
    assert sorted(a) == sorted(b) and {"cloud.laz", "world.json", "database.db", "sparse/0/images.bin"} <= set(a)
    assert [name for name in a if a[name] != b[name]] == []


def test_second_run_does_nothing(survey, tmp_path):
    out = tmp_path / "out"
    subprocess.run([*command(survey, out), "--until", "design"], check=True, capture_output=True)
    stamps = {p: p.stat().st_mtime_ns for p in out.rglob("*") if p.is_file() and p.name not in ("log.txt", ".lock")}
    again = subprocess.run([*command(survey, out), "--until", "design"], check=True, capture_output=True, text=True)
    assert again.stderr.count("up to date") == 5
    assert stamps == {p: p.stat().st_mtime_ns for p in stamps}
    assert os.listdir(out).count("report.html") == 0
