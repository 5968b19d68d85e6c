"""Both ends of a Dask cluster for ``daskpool``. A worker is prepared, makes items one at a time, stops when the run has
gone; of the cluster the connection is made, what its processes have and see is judged, and its messages go to the log.
"""

import asyncio
import logging
import os
import pickle
import shutil
import socket
import tempfile
import threading
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tiegraph.errors import InputError
from tiegraph.project.pool import Place, limit_threads
from tiegraph.project.progress import Meter
from tiegraph.project.receipts import software

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


# --- the cluster before it works for a run -------------------------------------------------------------------------


FREE_S = 60.0  # for a worker to become free of what it does and to load tiegraph

_CONNECT_S = 8.0
_LOGGERS = ("distributed", "distributed.client", "distributed.gc", "tornado", "tornado.application", "asyncio")


def connect(address: str) -> Any:
    """The client of a scheduler. Raises InputError if none answers within ``_CONNECT_S``.

    A client that is of no use is closed where it was made: left to the garbage collector it is closed by whatever
    thread that runs in, and Dask waits for itself without end if this is the one that starts another client's loop
    (``LoopRunner`` of distributed holds one lock for all).
    """
    from distributed import Client

    found: list[Any] = []
    given_up, deciding = threading.Event(), threading.Lock()

    def connect() -> None:
        client: Any = Client.__new__(Client)
        result: Any = client
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of versions: those that matter are compared in ``begin``
                client.__init__(address, timeout=_CONNECT_S, set_as_default=False)
        except Exception as error:
            result = error
        with deciding:
            found.append(result)
            wanted = result is client and not given_up.is_set()
        if not wanted:
            with suppress(Exception):
                client.close(timeout=5)

    # Dask waits without end for something that takes the connection and says nothing.
    thread = threading.Thread(target=connect, daemon=True, name="dask-connect")
    thread.start()
    thread.join(_CONNECT_S + 1)
    with deciding:
        given_up.set()
    if found and isinstance(found[0], Client):
        return found[0]
    why = f"{type(found[0]).__name__}: {found[0]}" if found else "silent"
    raise InputError(
        f"pool dask:{address}: no Dask scheduler answers there ({why}); "
        "give the address that `dask scheduler` prints, such as tcp://127.0.0.1:8786"
    )


@contextmanager
def visible(place: Place | None) -> Iterator[tuple[str, list[str]] | None]:
    """A folder that workers must be able to write into, new so that no other of the same name serves, and what they
    must be able to read."""
    if place is None:
        yield None
        return
    probe = place.folder / f".dask-{uuid.uuid4().hex}"
    probe.mkdir(parents=True)
    try:
        yield str(probe), [str(p.absolute()) for p in place.reads]
    finally:
        shutil.rmtree(probe, ignore_errors=True)


def other_versions(versions: Any) -> str | None:
    """What a process of the cluster lacks, None if nothing. ``versions``: its ``software`` or the error it answered."""
    if not isinstance(versions, dict):
        return (
            f"cannot run tiegraph ({type(versions).__name__}: {versions}): "
            f"install tiegraph {software()['tiegraph']} in its environment and start it again"
        )
    for name, own in software().items():
        theirs = versions.get(name, "none")
        if _series(name, own) != _series(name, theirs):
            return f"has {name} {theirs}, this process {own}: install the same there and start it again"
    return None


def unfit(seen: Any) -> str | None:
    """Why a worker cannot serve, None if it can. ``seen``: a ``Seen`` or the error it answered with."""
    if isinstance(seen, (TimeoutError, asyncio.TimeoutError)):
        return f"did not begin within {FREE_S:.0f} s: it is busy with something else or hangs; wait, or start it again"
    if not isinstance(seen, Seen):
        return f"could not begin ({type(seen).__name__}: {seen}): look at what it says, and start it again"
    if seen.problem:
        return f"{seen.problem}: workers need the run folder and the images under the same paths (a shared file system)"
    return None


def _series(name: str, version: str) -> Sequence[str]:
    return version.split(".")[:2] if name == "python" else version


class Quiet:
    """Dask's messages go to the run's log, not to the terminal, until ``end``."""

    def __init__(self) -> None:
        handlers: list[logging.Handler] = [_ToRunLog(logging.WARNING)]
        self._before = []
        for name in _LOGGERS:
            logger = logging.getLogger(name)
            self._before.append((logger, logger.handlers, logger.propagate))
            logger.handlers, logger.propagate = list(handlers), False

    def end(self) -> None:
        """Put the handlers back."""
        for logger, handlers, propagate in self._before:
            logger.handlers, logger.propagate = handlers, propagate
        self._before = []


class _ToRunLog(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        for handler in logging.getLogger("tiegraph").handlers:
            handler.handle(record)
