"""A worker of a Dask cluster: it is prepared for a run, makes items one at a time, and stops when the run has ended."""

import os
import pickle
import socket
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from tiegraph.project.pool import limit_threads
from tiegraph.project.progress import Meter

_turn = threading.Lock()  # one item at a time in a process: the libraries have the threads
_runs: set[str] = set()  # that this process was prepared for


class _Unwanted(Exception):
    """The run has ended; nobody reads this."""


def unpacked(packed: bytes) -> Any:
    """Call a pickled function: the scheduler, which inspects its tasks, sees bytes."""
    return pickle.loads(packed)()


def prepare(run: str, threads: int, probe: tuple[str, list[str]] | None) -> tuple[str, int, str]:
    """Prepare this process for a run, once its task for another has ended; its host and pid, and why it cannot use
    the folders. ``probe``: the folder to write into, the paths to read."""
    with _turn:
        limit_threads(threads)
        _runs.add(run)
        problem = doing = ""
        folder, reads = probe or ("", [])
        try:
            for path in reads:
                doing = f"read {path}"
                os.stat(path)
            if folder:
                doing = f"write into {Path(folder).parent}"
                tempfile.TemporaryFile(dir=folder).close()
        except OSError as error:
            problem = f"cannot {doing} ({error.strerror})"
        return socket.gethostname(), os.getpid(), problem


def idle() -> None:
    """Return when this process makes no item."""
    with _turn:
        pass


def on_worker(packed: bytes, *handles: bytes) -> tuple[Any, str, dict[str, float]]:
    """A call's result, the worker's address and its resource use.

    ``packed``: run, its working folder, function, arguments, and which of these come as ``handles``, pickled. Raises
    as the function.
    """
    from distributed import get_worker

    with _turn:
        if not _wanted():
            raise _Unwanted
        run, folder, fn, args, shared = pickle.loads(packed)
        for k, data in zip(shared, handles):
            args[k] = pickle.loads(data)
        worker = get_worker()
        if run not in _runs:  # restarted under its address
            limit_threads(worker.state.nthreads)
            _runs.add(run)
        before, meter = os.getcwd(), Meter()
        with suppress(OSError):  # paths of settings may be relative to it; a machine without it stays where it is
            os.chdir(folder)
        try:
            result = fn(*args)
        finally:
            used = meter.stop()
            os.chdir(before)
        return result, worker.address, used


def while_wanted(function: Callable[..., Any], item: Any, *args: Any) -> Any:
    """``function(item, *args)``, unless the run has ended."""
    if not _wanted():
        raise _Unwanted
    return function(item, *args)


def _wanted() -> bool:
    """Whether the scheduler still wants the task of this thread: it drops those of a client that cancelled or ended."""
    from distributed import get_worker

    worker = get_worker()
    task = worker.state.tasks.get(worker.get_current_task())
    return task is not None and task.state not in ("cancelled", "released", "forgotten")
