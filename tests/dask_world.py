"""A Dask cluster started by its commands on 127.0.0.1, and what its workers are asked to do in tests."""

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from tiegraph.child import run_in_child
from tiegraph.scene.filecache import cached_by_file

_TESTS = Path(__file__).parent
_PATIENCE_S = 120


@contextmanager
def commands(workers: int = 2, options: tuple[str, ...] = ()) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """(address, [scheduler, worker, ...]) of `dask scheduler` and `dask worker`; all are ended in the end."""
    quiet = ["--dashboard-address", "127.0.0.1:0"]
    with _started("dask_scheduler", ["--host", "127.0.0.1", "--port", "0", *quiet]) as (scheduler, line):
        address = re.search(r"tcp://[\d.:]+", line("Scheduler at")).group()
        with ExitStack() as stack:
            yield address, [scheduler, *(stack.enter_context(worker(address, options)) for _ in range(workers))]


@contextmanager
def worker(address: str, options: tuple[str, ...] = ()) -> Iterator[subprocess.Popen]:
    """One more worker of one thread of the scheduler there."""
    given = [address, "--nthreads", "1", "--dashboard-address", "127.0.0.1:0", *options]
    with _started("dask_worker", given) as (process, line):
        line("Starting established connection")
        yield process


@contextmanager
def _started(module: str, arguments: list[str]) -> Iterator[tuple]:
    path = os.pathsep.join([str(_TESTS.parent / "src"), str(_TESTS), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.{module}", *arguments],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.extend(iter(process.stderr.readline, "")), daemon=True)
    reader.start()

    def line(text: str) -> str:
        end = time.monotonic() + _PATIENCE_S
        while time.monotonic() < end and process.poll() is None:
            if found := [one for one in lines if text in one]:
                return found[0]
            time.sleep(0.05)
        raise AssertionError(f"{module} does not say {text!r}: {''.join(lines)}")

    try:
        yield process, line
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


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
