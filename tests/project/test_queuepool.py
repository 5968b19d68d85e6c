"""The slurm pool, with commands in the place of `sbatch` and `scancel` that run the job's script here."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tiegraph.errors import EngineMissing, InputError, SettingsError
from tiegraph.project.pool import Place, check_pool, map_items, open_pool

dask = pytest.importorskip("dask")
pytest.importorskip("dask_jobqueue")

JOB = {"cores": 1, "memory": "2GB", "walltime": "00:10:00", "interface": None, "log-directory": None}


def command(folder: Path, name: str, text: str) -> None:
    path = folder / name
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


@pytest.fixture
def queue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of commands, first in the path, and what a job is in dask-jobqueue's settings. As that of SLURM, this
    `sbatch` keeps the script: dask-jobqueue removes its own at once."""
    folder = tmp_path / "commands"
    folder.mkdir()
    submitted = (
        f'cp "$1" {folder}/job.sh\nsetsid sh {folder}/job.sh > {folder}/job.txt 2>&1 &\necho "Submitted batch job $!"'
    )
    command(folder, "sbatch", submitted)
    command(folder, "scancel", f'echo "$1" >> {folder}/cancelled\nkill -- "-$1"')
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    with dask.config.set({f"jobqueue.slurm.{name}": value for name, value in JOB.items()}):
        yield folder


@pytest.mark.slow
def test_jobs_of_the_queue_do_the_work(queue: Path, tmp_path: Path) -> None:
    said: list[str] = []
    for name in [name for name in sys.modules if name.startswith("dask_jobqueue")]:
        del sys.modules[name]  # which takes Ctrl-C for itself when it is loaded
    stopping = signal.getsignal(signal.SIGINT)
    executor, workers = open_pool("slurm:1", Place(tmp_path, say=said.append))
    try:
        assert signal.getsignal(signal.SIGINT) is stopping
        assert said == ["pool slurm: 1 job submitted; the run begins when the queue starts the first (squeue shows it)"]
        assert workers == 1
        (group,) = set(map_items(executor, workers, os.getpgid, [0, 0, 0]))
        assert group != os.getpgid(0)
    finally:
        executor.shutdown()
    assert (queue / "cancelled").read_text().split() == [str(group)]  # the job's number
    assert "--nthreads 1" in (queue / "job.sh").read_text()
    end = time.monotonic() + 60
    while lives(group) and time.monotonic() < end:
        time.sleep(0.1)
    assert not lives(group)


def lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_what_is_missing_is_said(queue: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for spec in ("slurm", "slurm:", "slurm:0", "slurm:two"):
        with pytest.raises(SettingsError, match="the number of jobs must be"):
            check_pool(spec)
    command(queue, "sbatch", 'echo "sbatch: error: invalid partition specified" >&2; exit 1')
    with pytest.raises(InputError, match="no job could be submitted.*invalid partition"):
        open_pool("slurm:1", Place(tmp_path))
    with dask.config.set({"jobqueue.slurm.cores": None}), pytest.raises(SettingsError, match="cores.*jobqueue.yaml"):
        open_pool("slurm:1", Place(tmp_path))
    monkeypatch.setitem(sys.modules, "dask_jobqueue", None)
    with pytest.raises(EngineMissing, match="pip install 'tiegraph\\[slurm\\]'"):
        open_pool("slurm:1", Place(tmp_path))
