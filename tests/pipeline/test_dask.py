"""A whole survey over the workers of Dask: the same bytes as by local processes, and a clean end."""

import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

import dask_world
import tiegraph
import worlds

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

# What must be the same byte for byte, whatever the pool; the database is compared by its rows.
COMPARED_UNTIL = "verify"
COMPARED = (
    "scene.json", "images", "masks", "classes", "masks.csv", "preview", "candidates.npz", "candidates",
    "coarse.npz", "coarse", "network.npz", "network.csv", "network",
    "pairs.npz", "pairs.txt", "pairs", "design", "match.npz", "verify.npz",
)  # fmt: skip
_PATIENCE_S = 600


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return worlds.write_survey(tmp_path_factory.mktemp("survey"), frames=5)


@pytest.fixture(scope="module")
def other(survey):
    """The run folder of two local processes."""
    asked = command(survey, "local", "local:2", COMPARED_UNTIL)
    done = subprocess.run(asked, cwd=survey, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return survey / "local"


def command(survey: Path, out: str, pool: str, until: str | None = None) -> list[str]:
    given = ["--gnss", str(survey / "gnss.csv"), "--times", str(survey / "times.csv"), "--pool", pool]
    given += ["--until", until] if until else []
    return [sys.executable, "-m", "tiegraph.cli.main", "run", str(survey / "images"), "-o", out, *given]


def contents(out: Path) -> dict[str, object]:
    """Bytes of every compared file below a run folder, and the rows of the database."""
    found = [p for name in COMPARED for p in ([out / name] if (out / name).is_file() else (out / name).rglob("*"))]
    made: dict[str, object] = {p.relative_to(out).as_posix(): p.read_bytes() for p in found if p.is_file()}
    if (out / "database.db").exists():
        with sqlite3.connect(f"{(out / 'database.db').as_uri()}?mode=ro", uri=True) as database:
            tables = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
            made["database.db"] = {t: sorted(map(repr, database.execute(f"SELECT * FROM {t}"))) for t in tables}
    return made


def local_cluster():
    return distributed.LocalCluster(2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0")


@pytest.mark.parametrize("kind, until", [("local cluster", None), ("commands", "network")])
def test_a_survey_over_two_workers(kind, until, survey, other, tmp_path):
    with local_cluster() if kind == "local cluster" else dask_world.commands(2) as made:
        address = made.scheduler_address if kind == "local cluster" else made[0]
        # A relative folder: the workers' own working folder is another one.
        whole = command(survey, "out", f"dask:{address}", until)
        done = subprocess.run(whole, cwd=tmp_path, capture_output=True, text=True, timeout=_PATIENCE_S)
    assert done.returncode == 0, done.stderr
    assert "distributed" not in done.stderr and "Warning" not in done.stderr
    out = tmp_path / "out"
    assert not list(out.glob(".dask-*"))
    mine, theirs = contents(out), contents(other)
    assert (out / "report.html").exists() and mine.keys() == theirs.keys() if until is None else len(mine) > 40
    assert not [name for name in mine if mine[name] != theirs[name]]
    here, there = (tiegraph.open(out=folder).receipt("masks") for folder in (out, other))
    assert here["cpu_s"] > 0.5 * there["cpu_s"], "the workers' CPU seconds count"
    assert here["peak_mib"] > 0.5 * there["peak_mib"], "the workers' memory counts"


def test_ctrl_c_ends_with_one_line_and_the_next_run_goes_on(survey, other, tmp_path):
    with local_cluster() as cluster:
        asked = command(survey, "out", f"dask:{cluster.scheduler_address}", "preview")
        process = subprocess.Popen(asked, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
        end = time.monotonic() + _PATIENCE_S
        while not list((tmp_path / "out" / "masks").rglob("*.png")) and time.monotonic() < end:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=120)
        last = said.strip().splitlines()[-1]
        assert process.returncode == 1 and last.startswith("tiegraph: stopped"), said
        assert "Traceback" not in said and "distributed" not in said, said
        again = subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True, timeout=_PATIENCE_S)
    assert again.returncode == 0, again.stderr
    mine, theirs = contents(tmp_path / "out"), contents(other)
    assert len(mine) > 40 and not [name for name in mine if mine[name] != theirs[name]]
