"""What a Dask worker does for ``daskpool``: is prepared, makes items one at a time, stops when the run has gone."""

import os
import pickle
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tiegraph.project.pool import limit_threads
from tiegraph.project.progress import Meter

GOES_ON = "finished work is kept, run the same command again"

_turn = threading.Lock()  # one item at a time in a process: the libraries have the threads
_runs: set[str] = set()  # that this process was prepared for


@dataclass(frozen=True)
class Seen:
    """What a worker says of itself; ``problem``: why it cannot use the folders."""

    host: str
    pid: int
    problem: str = ""


class _Unwanted(Exception):
    """The run has gone; nobody reads this."""


def unpacked(packed: bytes) -> Any:
    """Call what was pickled: the scheduler, which looks into its tasks, sees bytes."""
    return pickle.loads(packed)()


def prepare(run: str, threads: int, probe: tuple[str, list[str]] | None) -> Seen:
    """Make this process fit for a run, once what it does for another has ended. ``probe``: the folder to write into,
    the paths to read."""
    with _turn:
        limit_threads(threads)
        _runs.add(run)
        problem = "" if probe is None else _unreachable(*probe)
        return Seen(socket.gethostname(), os.getpid(), problem)


def _unreachable(folder: str, reads: list[str]) -> str:
    try:
        for path in reads:
            os.stat(path)
    except OSError as error:
        return f"cannot read {path} ({error.strerror})"
    try:
        with tempfile.TemporaryFile(dir=folder):
            return ""
    except OSError as error:
        return f"cannot write into {Path(folder).parent} ({error.strerror})"


def idle() -> None:
    """Return when this process makes no item."""
    with _turn:
        pass


def on_worker(packed: bytes, *handles: bytes) -> tuple[Any, str, dict[str, float]]:
    """A call's result, the worker's address and what it used.

    ``packed``: run, where it was started, function, arguments, and which of these come as ``handles``, pickled. Raises
    what the function raises.
    """
    from distributed import get_worker

    with _turn:
        if not _wanted():
            raise _Unwanted
        run, folder, fn, args, shared = pickle.loads(packed)
        for k, data in zip(shared, handles):
            args[k] = pickle.loads(data)
        worker = get_worker().address
        if run not in _runs:  # started again under its address
            limit_threads(get_worker().state.nthreads)
            _runs.add(run)
        meter = Meter()
        try:
            with _working_in(folder):
                result = fn(*args)
        finally:
            used = meter.stop()
        return result, worker, used


def while_wanted(function: Callable[..., Any], item: Any, *args: Any) -> Any:
    """``function(item, *args)``, unless the run has gone."""
    if not _wanted():
        raise _Unwanted
    return function(item, *args)


def _wanted() -> bool:
    """Whether the scheduler still wants the task of this thread: it drops those of a client that cancelled or ended."""
    from distributed import get_worker

    worker = get_worker()
    task = worker.state.tasks.get(worker.get_current_task())
    return task is not None and task.state not in ("cancelled", "released", "forgotten")


@contextmanager
def _working_in(folder: str) -> Iterator[None]:
    """Paths of settings may be relative to where the run was started. A machine without that folder stays as it is."""
    before = os.getcwd()
    with suppress(OSError):
        os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
