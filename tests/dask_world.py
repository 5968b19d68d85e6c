"""A Dask cluster started by its commands on 127.0.0.1, and what its workers are asked to do in tests."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import psutil

from tiegraph.child import run_in_child
from tiegraph.scene.atomic import cached_by_file

if TYPE_CHECKING:
    from campaign.process import Server

_PATIENCE_S = 120


class Commands:
    """Starts `dask scheduler` and `dask worker` as children of a process that has imported everything once."""

    def __init__(self, server: Server, folder: Path) -> None:
        self._server, self._folder, self._count = server, folder, 0

    @contextmanager
    def cluster(self, workers: int = 2) -> Iterator[tuple[str, list[psutil.Process]]]:
        """(address, [scheduler, worker, ...]); all are ended in the end."""
        given = ["--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0"]
        with self._started("dask_scheduler", given, "Scheduler at") as (scheduler, line):
            address = re.search(r"tcp://[\d.:]+", line).group()
            with ExitStack() as stack:
                yield address, [scheduler, *(stack.enter_context(self.worker(address)) for _ in range(workers))]

    @contextmanager
    def worker(self, address: str) -> Iterator[psutil.Process]:
        """One more worker of one thread, without a nanny, of the scheduler there."""
        given = [address, "--nthreads", "1", "--no-nanny", "--dashboard-address", "127.0.0.1:0"]
        with self._started("dask_worker", given, "Starting established connection") as (process, _):
            yield process

    @contextmanager
    def _started(self, module: str, arguments: list[str], ready: str) -> Iterator[tuple[psutil.Process, str]]:
        """The process and the line by which it says that it is ready."""
        self._count += 1
        folder = self._folder / f"{self._count}-{module}"
        process = self._server.start_module(f"distributed.cli.{module}", arguments, folder)
        end = time.monotonic() + _PATIENCE_S
        try:
            while not (found := [one for one in _lines(folder) if ready in one]):
                assert time.monotonic() < end and _runs(process), f"{module} does not say {ready!r}: {_lines(folder)}"
                time.sleep(0.05)
            yield process, found[0]
        finally:
            _end(process)


def _lines(folder: Path) -> list[str]:
    return (folder / "said.txt").read_text().splitlines()


def _runs(process: psutil.Process) -> bool:
    return process.is_running() and process.status() != psutil.STATUS_ZOMBIE


def _end(process: psutil.Process) -> None:
    end = time.monotonic() + 20
    with suppress(psutil.NoSuchProcess):
        process.terminate()
        while _runs(process) and time.monotonic() < end:
            time.sleep(0.02)
        process.kill()


def where(number: int, factor: float = 1) -> tuple[float, int]:
    """A product and the process that made it."""
    return number * factor, os.getpid()


def add(a: int, b: int, send: object) -> int:
    """Run in a child."""
    return a + b


def in_child(number: int, log: Path) -> int:
    """The number and one, by a child process of the worker."""
    return run_in_child(add, number, 1, log=log)


def threads(number: int) -> tuple[int, str | None]:
    """What the libraries may take."""
    import cv2

    return cv2.getNumThreads(), os.environ.get("OMP_NUM_THREADS")


def burn(number: int, seconds: float) -> int:
    """Use so much CPU time, and 200 MB."""
    data, start = np.ones(25_000_000), time.process_time()
    while time.process_time() - start < seconds:
        data[:1000].sum()
    return number


def span(number: int, seconds: float) -> tuple[float, float]:
    """When it began and ended."""
    start = time.time()
    time.sleep(seconds)
    return start, time.time()


def total(number: int, data: np.ndarray) -> float:
    """The number plus the sum of an array."""
    return number + float(data.sum())


def leave_file(number: int, folder: Path, seconds: float) -> int:
    """Write a file after a while."""
    time.sleep(seconds)
    (folder / str(number)).touch()
    return number


def write_down(number: int, folder: Path, seconds: float) -> tuple[int, int]:
    """The number and who made it, which is kept in a file too."""
    with open(folder / str(number), "a") as file:
        file.write(f"{os.getpid()}\n")
    time.sleep(seconds)
    return number, os.getpid()


def refuse(number: int) -> int:
    """Raise for one number."""
    if number == 3:
        raise KeyError("three")
    return number


def relative(number: int) -> str:
    """Read a file beside where the run was started."""
    return Path("beside.txt").read_text()


def end_process(number: int) -> None:
    """As the kernel does when memory runs out."""
    os.kill(os.getpid(), 9)


@cached_by_file(maxsize=4)
def kept(path: Path) -> str:
    """What is in a file."""
    return path.read_text()


def read_kept(number: int, path: Path) -> str:
    """What is in a file, from memory."""
    return kept(path)
