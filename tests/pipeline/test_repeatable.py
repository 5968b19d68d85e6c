"""The same input, settings and version make the same bytes: whatever the pool, the order of hashes and of workers."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import worlds
from artefacts import artefacts
from tiegraph.scan.rigwrite import write_rig_toml

pytestmark = pytest.mark.slow


def run(survey: Path, out: Path, pool: str, seed: str, *more: str) -> None:
    command = [sys.executable, "-m", "tiegraph.cli.main", "run", str(survey / "images"), "-o", str(out), "--quiet"]
    given = [word for name in ("gnss", "times") for word in (f"--{name}", str(survey / f"{name}.csv"))]
    environment = {**os.environ, "PYTHONHASHSEED": seed}
    subprocess.run([*command, *given, "--pool", pool, *more], check=True, env=environment)


def test_serial_and_processes_make_the_same_bytes(tmp_path):
    """With a calibrated rig, to the world; ``test_resume`` says so of all stages, and of a survey that is not known."""
    made = worlds.make_survey(tmp_path / "images", frames=6)
    worlds.write_gnss(made, tmp_path / "gnss.csv")
    worlds.write_times(made, tmp_path / "times.csv")
    write_rig_toml(made.rig, tmp_path / "rig.toml")
    more = ("--rig", str(tmp_path / "rig.toml"), "--masks.source", "none", "--until", "georef")
    run(tmp_path, tmp_path / "a", "serial", "1", *more)
    run(tmp_path, tmp_path / "b", "local:2", "2", *more)
    a, b = artefacts(tmp_path / "a"), artefacts(tmp_path / "b")
    assert sorted(a) == sorted(b) and {"world.json", "database.db", "sparse/0/images.bin"} <= set(a)
    assert [name for name in a if a[name] != b[name]] == []
