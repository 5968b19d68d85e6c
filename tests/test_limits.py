"""Machines at their limits: each library's words become one sentence with a remedy."""

from __future__ import annotations

import errno
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tiegraph import limits
from tiegraph.child import run_in_child
from tiegraph.cli.main import main
from tiegraph.errors import InputError, ProcessLost, TiegraphError
from tiegraph.scene.atomic import replacing

PYTHON = [sys.executable, "-m", "tiegraph.cli.main"]


def caused(error: Exception, cause: Exception) -> Exception:
    error.__cause__ = cause
    return error


FULL = [
    OSError(errno.ENOSPC, "No space left on device"),
    OSError(errno.EFBIG, "File too large"),
    OSError(errno.EDQUOT, "Disk quota exceeded"),
    OSError("383208 requested and 256528 written"),  # numpy
    RuntimeError("[database_sqlite.cc:1737] SQLite error: database or disk is full"),
    caused(ValueError("could not write chunk"), OSError(errno.ENOSPC, "No space left on device")),
]
STARVED = [
    MemoryError(),
    RuntimeError("std::bad_alloc"),
    RuntimeError("can't start new thread"),
    OSError(errno.ENOMEM, "Cannot allocate memory"),
    ImportError("libopenblas.so: failed to map segment from shared object"),
]


def test_a_process_that_was_killed_is_said_to_be_so(tmp_path: Path) -> None:
    assert (
        limits.explained(ProcessLost("matching: its process was ended from outside (signal SIGKILL)"), tmp_path) is None
    )


@pytest.mark.parametrize("error", FULL, ids=repr)
def test_a_full_disk_in_any_words(error: Exception, tmp_path: Path) -> None:
    told = limits.explained(error, tmp_path)
    assert isinstance(told, InputError) and str(tmp_path) in str(told) and "MiB free" in str(told)


@pytest.mark.parametrize("error", STARVED, ids=repr)
def test_little_memory_in_any_words(error: Exception, tmp_path: Path) -> None:
    told = limits.explained(error, tmp_path)
    assert isinstance(told, TiegraphError) and "not enough memory" in str(told) and "--pool local:1" in str(told)


@pytest.mark.parametrize(
    "error",
    [PermissionError(errno.EACCES, "Permission denied"), InputError("x: No space left on device"), ValueError("bad"),
     RuntimeError("No registered database factory succeeded.")],
    ids=repr,
)  # fmt: skip
def test_other_errors_stay_what_they_are(error: Exception, tmp_path: Path) -> None:
    assert limits.explained(error, tmp_path) is None


def test_a_library_that_gives_no_reason_is_judged_by_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    vague = RuntimeError("No registered database factory succeeded.")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(1 << 40, 1 << 40, 4096))
    told = limits.explained(vague, tmp_path)
    assert isinstance(told, InputError) and "No space left" in str(told) and "database factory" in str(told)
    with pytest.raises(InputError, match=r"a\.bin.*No space left"), replacing(tmp_path / "a.bin"):
        raise RuntimeError("anything")


def test_the_size_limit_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "size_limit", lambda: 1 << 20)
    with pytest.raises(InputError, match=r"1 MiB \(ulimit -f\)"):
        limits.need_room(tmp_path / "a.db", 2 << 20)
    limits.need_room(tmp_path / "a.db", 1 << 19)
    assert not list(tmp_path.iterdir())
    told = limits.explained(RuntimeError("No registered database factory succeeded."), tmp_path)
    assert told is not None and "ulimit -f" in str(told)


def starved(send: Callable[[Any], None]) -> None:
    """Runs in the child process."""
    np.zeros(1 << 50)


@pytest.mark.slow
def test_a_child_without_memory(tmp_path: Path) -> None:
    with pytest.raises(TiegraphError, match="not enough memory"):
        run_in_child(starved, log=tmp_path / "log.txt")


def shell(command: str, cwd: Path) -> subprocess.CompletedProcess:
    """A command line in which $T is tiegraph."""
    text = command.replace("$T", " ".join(PYTHON))
    return subprocess.run(["bash", "-c", text], capture_output=True, text=True, check=False, cwd=cwd, timeout=300)


@pytest.mark.slow
@pytest.mark.parametrize("unbuffered", ["", "PYTHONUNBUFFERED=1"])
def test_standard_output_that_is_full(unbuffered: str, tmp_path: Path) -> None:
    done = shell(f"{unbuffered} $T --version > /dev/full", tmp_path)
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and "standard output cannot be written" in done.stderr


@pytest.mark.slow
def test_standard_streams_that_are_closed(tmp_path: Path) -> None:
    done = shell("$T --version >&- 2>&- <&-", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert shell("$T --help | head -1; exit ${PIPESTATUS[0]}", tmp_path).returncode == 0


@pytest.mark.slow
def test_an_address_space_too_small_to_begin(tmp_path: Path) -> None:
    done = shell("ulimit -v 400000; $T doctor", tmp_path)
    assert done.returncode == 1 and "not enough memory" in done.stderr and "ulimit -v" in done.stderr


@pytest.mark.slow
def test_verbs_name_what_they_were_not_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    file, none = str(tmp_path / "file"), str(tmp_path / "none")
    for arguments in (["status", file], ["status", none], ["compare", file, none], ["compare", none],
                      ["export", file, "x"], ["masks", none, "--compare", file], ["shots", file], ["init", none],
                      ["network", "--coverage", none], ["evaluate", none], ["report", file]):  # fmt: skip
        code = main(arguments)
        said = capsys.readouterr().err
        assert code in (1, 2) and "unexpected" not in said and said, arguments


def test_the_words_of_an_aborted_process_stay_in_the_log(tmp_path: Path) -> None:
    log = "2026-11-22 12:53:24,737 INFO tiegraph: stage match started\nterminate called after throwing an instance of "
    log += "'std::runtime_error'\n  what():  [database_sqlite.cc:1478] SQLite error: database or disk is full\n"
    said = str(limits.explained_text(log, tmp_path))
    assert said.startswith("No space left on device")
    assert said.endswith("is kept ([database_sqlite.cc:1478] SQLite error: database or disk is full)")
