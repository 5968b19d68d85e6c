"""The same bytes whatever the pool and however often a run is killed (SIGKILL) and goes on."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import tiegraph
from artefacts import artefacts
from campaign.process import Running
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
    """With a rig that is not known, to the world; ``test_resume`` says so of all stages and of a calibrated rig."""
    survey = finished.inputs

    def command(pool: str) -> list[str]:
        asked = ["run", survey / "images", "-o", tmp_path / pool, "--pool", pool, "--until", "georef", "--quiet"]
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
